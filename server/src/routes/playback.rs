//! `/v1/sources/{name}/scene` and `…/playback`: what a source shows, and how it goes on, while it runs.

use std::sync::Arc;

use axum::body::Body;
use axum::http::{HeaderMap, StatusCode};
use isophote_wire::{PlaybackDocument, PlaybackView, SceneDocument, SceneView};

use super::parameters::NameParam;
use super::{Answer, App, RawName, json, raw};
use crate::documents::{place, read_json};
use crate::problem::Problem;
use crate::source::Source;

fn source(app: &App, name: RawName) -> Result<Arc<Source>, Problem> {
    app.service.source(&raw(name)?)
}

/// What a synthetic source shows.
#[utoipa::path(get, path = "/v1/sources/{name}/scene", tag = "sources", operation_id = "get_scene", params(NameParam),
    responses((status = 200, description = "All of it, and since which frame.", body = SceneView)))]
pub async fn scene(app: App, name: RawName) -> Answer {
    json(StatusCode::OK, &source(&app, name)?.scene()?)
}

/// Changes what a synthetic source shows, between two frames; time goes on.
#[utoipa::path(put, path = "/v1/sources/{name}/scene", tag = "sources", operation_id = "put_scene", params(NameParam),
    request_body = SceneDocument,
    responses((status = 200, description = "All of it, and from which frame on.", body = SceneView)))]
pub async fn set_scene(app: App, name: RawName, headers: HeaderMap, body: Body) -> Answer {
    let source = source(&app, name)?;
    source.scene()?;
    let (document, text) = read_json::<SceneDocument>(&headers, body).await?;
    // Formulas may be long.
    let change = tokio::task::spawn_blocking(move || source.set_scene(document)).await;
    let changed = change.map_err(|_| Problem::bug("reading the scene panicked"))?;
    json(StatusCode::OK, &changed.map_err(|problem| place(problem, &text))?)
}

/// How a recording or a synthetic source goes on.
#[utoipa::path(get, path = "/v1/sources/{name}/playback", tag = "sources", operation_id = "get_playback", params(NameParam),
    responses((status = 200, description = "Whether it stands still, how fast it goes, and where it is.", body = PlaybackView)))]
pub async fn playback(app: App, name: RawName) -> Answer {
    json(StatusCode::OK, &source(&app, name)?.playback()?)
}

/// Pauses a recording or a synthetic source, steps, seeks, or changes its speed. Frame numbers only grow.
#[utoipa::path(put, path = "/v1/sources/{name}/playback", tag = "sources", operation_id = "put_playback", params(NameParam),
    request_body = PlaybackDocument,
    responses((status = 200, description = "How it goes on from now on.", body = PlaybackView)))]
pub async fn set_playback(app: App, name: RawName, headers: HeaderMap, body: Body) -> Answer {
    let source = source(&app, name)?;
    source.playback()?;
    let (document, text) = read_json::<PlaybackDocument>(&headers, body).await?;
    app.service.admit_speed(&source, document.speed)?;
    json(StatusCode::OK, &source.set_playback(&document).map_err(|problem| place(problem, &text))?)
}
