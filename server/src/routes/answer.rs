//! What the handlers share: what they get, what they answer, and names in paths.

use std::sync::Arc;

use axum::extract::Path;
use axum::extract::rejection::PathRejection;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use isophote_symbolic::Model;
use isophote_wire::SourceDocument;
use serde::Serialize;
use tokio::sync::{Semaphore, mpsc};

use crate::access::Recordings;
use crate::limits::LIMITS;
use crate::name::Name;
use crate::problem::Problem;
use crate::recording::RecordingFolder;
use crate::service::{Put, Service};
use crate::source::{self, Opened};
use crate::streams::pushed::FrameRoom;

/// The name of the WebSockets' subprotocol.
const PROTOCOL: &str = "isophote.v1";

/// What every handler gets.
#[derive(Clone)]
pub struct App {
    /// Everything that runs.
    pub service: Arc<Service>,
    /// Held by every stream: the service has stopped when all are dropped.
    pub stream: mpsc::Sender<()>,
    /// Places for those whose recordings are being opened.
    pub openings: Arc<Semaphore>,
    /// For pushed frames.
    pub frames: Arc<FrameRoom>,
    /// For single images.
    pub images: Arc<ImagePlaces>,
    /// Places for connections.
    pub sockets: Arc<Semaphore>,
    /// Which may be named.
    pub recordings: Recordings,
    /// Where sessions are recorded.
    pub folder: RecordingFolder,
    /// Places for those who read recordings.
    pub downloads: Arc<Semaphore>,
    /// Room for pictures that viewers have not taken yet, bytes.
    pub pictures: Arc<Semaphore>,
}

/// Places for single images.
pub struct ImagePlaces {
    /// Fitted, or waiting for it.
    pub admitted: Arc<Semaphore>,
    /// Fitted.
    pub fitting: Arc<Semaphore>,
}

impl Default for ImagePlaces {
    fn default() -> ImagePlaces {
        let places = |count| Arc::new(Semaphore::new(count));
        ImagePlaces { admitted: places(LIMITS.images), fitting: places(LIMITS.image_fits) }
    }
}

/// What a handler answers.
pub type Answer = Result<Response, Problem>;

/// A JSON body.
pub fn json(status: StatusCode, value: &impl Serialize) -> Answer {
    let body = serde_json::to_vec(value).map_err(|error| Problem::bug(error.to_string()))?;
    let mut response = (status, body).into_response();
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static("application/json"));
    Ok(response)
}

/// The name in the path as it was sent; whether there is such a thing is looked up later.
pub type RawName = Result<Path<String>, PathRejection>;

/// The text of a name in the path; a path that is no text names nothing.
pub fn raw(name: RawName) -> Result<String, Problem> {
    name.map(|Path(name)| name).map_err(|_| Problem::unknown("name", "(not UTF-8)"))
}

/// The name that something new is to have: 422 when it is none.
pub fn new_name(name: RawName) -> Result<Name, Problem> {
    let name = raw(name)?;
    let message = "a name is made of 1 to 64 of a-z, 0-9 and -, and does not begin with -";
    Name::parse(&name).ok_or_else(|| Problem::wrong_key("wrong-name", "name", message))
}

/// The name of something that should exist: 404 when it cannot.
pub fn old_name(what: &str, name: RawName) -> Result<Name, Problem> {
    let name = raw(name)?;
    Name::parse(&name).ok_or_else(|| Problem::unknown(what, &name))
}

/// An upgrade to our subprotocol, for messages of at most so many bytes from the client.
pub(super) fn upgraded(
    headers: &HeaderMap,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
    message_bytes: usize,
) -> Result<WebSocketUpgrade, Problem> {
    let upgrade = upgrade.map_err(|error| Problem::bad_request(error.body_text()))?;
    let is_offered = headers.contains_key(header::SEC_WEBSOCKET_PROTOCOL);
    let upgrade = upgrade.protocols([PROTOCOL]).max_message_size(message_bytes).max_frame_size(message_bytes);
    if is_offered && upgrade.selected_protocol().is_none() {
        return Err(Problem::bad_request(format!("the subprotocol is {PROTOCOL}")));
    }
    Ok(upgrade)
}

/// Opens a recording where its disk may take its time, and nobody else waits for it; its document then has the path by which it
/// is found again. Other sources open at once, by whoever puts them.
pub async fn opened_ahead(
    app: &App,
    document: &mut SourceDocument,
    prefix: &'static str,
    reader: Option<Arc<Model>>,
) -> Result<Option<Opened>, Problem> {
    let SourceDocument::Recording(recording) = document else { return Ok(None) };
    let reach = app.recordings.reach(prefix)?;
    let (sent, openings) = (recording.clone(), app.openings.clone());
    let seconds = LIMITS.open_time.as_secs();
    let busy = |_| Problem::late(format!("the recordings before this one were not opened within {seconds} s"));
    let place = tokio::time::timeout(LIMITS.open_time, openings.acquire_owned()).await.map_err(busy)?;
    let place = place.map_err(|_| Problem::stopping())?;
    let open = move || {
        let _place = place;
        source::open_recording(&sent, prefix, reader.as_deref(), &reach)
    };
    let late = |_| Problem::late(format!("the recording was not opened within {seconds} s"));
    let opening = tokio::time::timeout(LIMITS.open_time, tokio::task::spawn_blocking(open));
    let opened = opening.await.map_err(late)?.map_err(|_| Problem::bug("opening the recording panicked"))?;
    let (address, opened) = opened?;
    recording.path = address;
    Ok(Some(opened))
}

/// 201 or 200.
pub(super) fn put_status(put: Put) -> StatusCode {
    match put {
        Put::Created => StatusCode::CREATED,
        Put::Replaced => StatusCode::OK,
    }
}
