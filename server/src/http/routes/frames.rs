//! `POST /v1/sessions/{name}/frames`: fits one pushed frame and answers its estimate. `GET`: a WebSocket for many frames.

use std::sync::Arc;

use axum::body::Body;
use axum::extract::rejection::QueryRejection;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::{Extension, Query};
use axum::http::{HeaderMap, StatusCode, header};
use isophote_wire::{EstimateView, FrameTime};

use super::parameters::NameParam;
use super::{Answer, App, RawName, json, raw, upgraded};
use crate::access::Visitor;
use crate::http::documents::read_body;
use crate::http::streams::frames;
use crate::http::streams::pushed::{FrameMedia, Pushed};
use crate::hub::Mode;
use crate::net::gate::MessageGate;
use crate::problem::Problem;

/// Fits one frame and answers with its estimate.
#[utoipa::path(post, path = "/v1/sessions/{name}/frames", tag = "sessions", operation_id = "push_frame",
    params(NameParam, FrameTime),
    request_body(content((Vec<u8> = "image/png"), (Vec<u8> = "image/jpeg"), (Vec<u8> = "application/octet-stream"))),
    responses((status = 200, description = "Estimate of the frame; of several targets, the first.", body = EstimateView)))]
pub async fn post(
    app: App,
    name: RawName,
    headers: HeaderMap,
    query: Result<Query<FrameTime>, QueryRejection>,
    body: Body,
) -> Answer {
    let Query(FrameTime { time_s }) = query.map_err(|error| Problem::bad_request(error.body_text()))?;
    let pushed = Pushed::of(&*app.service.session(&raw(name)?)?, app.frames.clone())?;
    let media = FrameMedia::of(&headers)?;
    let room = match pushed.room_now(media) {
        Ok(room) => room,
        Err(problem) => {
            drop(read_body(body, 0).await); // discarded, so that the sender can read the answer
            return Err(problem);
        }
    };
    let bytes = read_body(body, pushed.bytes_of(media)).await?;
    let frame = pushed.decode(media, bytes, time_s, room).await?;
    let estimate = pushed.push(frame)?.estimate().await?;
    json(StatusCode::OK, &*estimate)
}

/// Opens a WebSocket (subprotocol `isophote.v1`) for frames.
///
/// Each binary message is a frame: raw in the source's format, PNG or JPEG. The service answers the frames in order with text
/// messages: an `EstimateView` or a `ProblemDocument`. A text message of the client, a `FrameTime`, gives the time of the next frame.
#[utoipa::path(get, path = "/v1/sessions/{name}/frames", tag = "sessions", operation_id = "frames_socket", params(NameParam),
    responses((status = 101, description = "The socket is open.")))]
pub async fn get(
    app: App,
    Extension(visitor): Extension<Visitor>,
    Extension(gate): Extension<Arc<MessageGate>>,
    name: RawName,
    headers: HeaderMap,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Answer {
    let session = app.service.session(&raw(name)?)?;
    let pushed = Pushed::of(&session, app.frames.clone())?;
    if !headers.contains_key(header::UPGRADE) {
        return Err(Problem::bad_request("frames come with POST, or over a WebSocket"));
    }
    let upgrade = upgraded(&headers, upgrade, pushed.frame_bytes())?;
    let subscription = session.hub().subscribe(Mode::End)?.of(visitor);
    let held = app.stream.clone();
    Ok(upgrade.on_upgrade(async move |socket| {
        pushed.close(&gate);
        frames::serve(socket, pushed, subscription, &gate).await;
        drop(held);
    }))
}
