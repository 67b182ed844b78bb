//! `POST /v1/sessions/{name}/frames`: one frame in, its estimate out.

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use isophote_capture::Captured;
use isophote_tracker::{Frame, Plane};
use tokio::sync::oneshot;

use super::{Answer, App, RawName, json, raw};
use crate::documents::{media_type, read_body};
use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::session::inbox::Reply;
use crate::source::pixel_format;
use crate::wire::{PushedDocument, SourceDocument};

/// Waits for the fit of this very frame.
pub async fn post(State(app): State<App>, name: RawName, headers: HeaderMap, body: Body) -> Answer {
    let session = app.service.session(&raw(name)?)?;
    let SourceDocument::Pushed(document) = session.source().source.document().clone() else {
        let kind = session.source().source.document().kind();
        let message = format!("the session's frames come from a source of kind {kind}; only kind pushed takes frames");
        return Err(Problem::conflict("not-applicable", message));
    };
    let media = media_type(&headers);
    if !["application/octet-stream", "image/png", "image/jpeg"].contains(&media.as_str()) {
        return Err(Problem::wrong_type("image/png, image/jpeg or application/octet-stream"));
    }
    let bytes = read_body(body, LIMITS.frame_bytes).await?;
    let decoding = tokio::task::spawn_blocking(move || decode(&document, &media, bytes));
    let frame = decoding.await.map_err(|_| Problem::bug("decoding panicked"))??;
    let (sender, answer) = oneshot::channel();
    let reply = Reply { session: session.inbox().clone(), sender };
    session.source().source.push(Captured { frame, file: None, truth: None }, reply)?;
    let late = |_| Problem::conflict("not-applicable", "the frame was not fitted in time");
    let gone = |_| Problem::conflict("not-applicable", "the session ended before the frame was fitted");
    let estimate = tokio::time::timeout(LIMITS.push_time, answer).await.map_err(late)?.map_err(gone)?;
    json(StatusCode::OK, &*estimate)
}

fn decode(document: &PushedDocument, media: &str, bytes: Vec<u8>) -> Result<Frame, Problem> {
    let size = [document.width, document.height];
    let wrong = |message: String| Problem::wrong_key("wrong-frame", "", message);
    if media != "application/octet-stream" {
        let frame = isophote_capture::decode(&bytes).map_err(|error| wrong(error.to_string()))?;
        if frame.size() != size {
            return Err(wrong(format!("the frame has {:?} px, the source {size:?}", frame.size())));
        }
        return Ok(frame);
    }
    let format = pixel_format(document.format);
    let expected = document.width * document.height * format.bytes_per_pixel();
    if bytes.len() != expected {
        return Err(wrong(format!("the frame has {} bytes, {expected} are expected", bytes.len())));
    }
    Frame::new(&size, vec![Plane::owned(format, bytes, document.width)]).map_err(|error| wrong(error.to_string()))
}
