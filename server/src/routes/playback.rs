//! `/v1/sources/{name}/scene` and `…/playback`: what a source shows, and how it goes on, while it runs.

use std::sync::Arc;

use axum::body::Body;
use axum::http::{HeaderMap, StatusCode};
use isophote_wire::{PlaybackDocument, PlaybackView, SceneDocument, SceneView};

use super::parameters::{MatchHeaders, NameParam};
use super::{Answer, App, RawName, json, raw, representation, stateful, tagged};
use crate::documents::{place, read_json};
use crate::preconditions::Preconditions;
use crate::problem::Problem;
use crate::source::Source;

fn source(app: &App, name: RawName) -> Result<Arc<Source>, Problem> {
    app.service.source(&raw(name)?)
}

/// What a synthetic source shows.
#[utoipa::path(get, path = "/v1/sources/{name}/scene", tag = "sources", operation_id = "get_scene", params(NameParam, MatchHeaders),
    responses((status = 200, description = "All of it, and since which frame.", body = SceneView)))]
pub async fn scene(app: App, name: RawName, preconditions: Preconditions) -> Answer {
    let (tag, view) = source(&app, name)?.scene()?;
    representation(&preconditions, "the scene", &tag, json(StatusCode::OK, &view)?)
}

/// Changes what a synthetic source shows, between two frames; time goes on.
#[utoipa::path(put, path = "/v1/sources/{name}/scene", tag = "sources", operation_id = "put_scene", params(NameParam, MatchHeaders),
    request_body = SceneDocument,
    responses((status = 200, description = "All of it, and from which frame on.", body = SceneView)))]
pub async fn set_scene(
    app: App,
    name: RawName,
    preconditions: Preconditions,
    headers: HeaderMap,
    body: Body,
) -> Answer {
    let source = source(&app, name)?;
    preconditions.check("the scene", &[source.scene()?.0])?;
    let (document, text) = read_json::<SceneDocument>(&headers, body).await?;
    // Formulas may be long.
    let change = tokio::task::spawn_blocking(move || source.set_scene(document, &preconditions)).await;
    let changed = change.map_err(|_| Problem::bug("reading the scene panicked"))?;
    let (tag, view) = place(changed, &text).await?;
    tagged(StatusCode::OK, &view, Some(&tag))
}

/// How a recording or a synthetic source goes on.
#[utoipa::path(get, path = "/v1/sources/{name}/playback", tag = "sources", operation_id = "get_playback", params(NameParam, MatchHeaders),
    responses((status = 200, description = "Whether it stands still, how fast it goes, and where it is.", body = PlaybackView)))]
pub async fn playback(app: App, name: RawName, preconditions: Preconditions) -> Answer {
    let (tag, view) = source(&app, name)?.playback()?;
    stateful(&preconditions, "the playback", Some(&tag), &view)
}

/// Pauses a recording or a synthetic source, sends it to a frame, or changes its speed. Frame numbers only grow.
#[utoipa::path(put, path = "/v1/sources/{name}/playback", tag = "sources", operation_id = "put_playback", params(NameParam, MatchHeaders),
    request_body = PlaybackDocument,
    responses((status = 200, description = "How it goes on from now on.", body = PlaybackView)))]
pub async fn set_playback(
    app: App,
    name: RawName,
    preconditions: Preconditions,
    headers: HeaderMap,
    body: Body,
) -> Answer {
    let source = source(&app, name)?;
    preconditions.check("the playback", &[source.playback()?.0])?;
    let (document, text) = read_json::<PlaybackDocument>(&headers, body).await?;
    app.service.admit_speed(&source, document.speed)?;
    let changed = source.set_playback(&document, &preconditions);
    let (tag, view) = place(changed, &text).await?;
    tagged(StatusCode::OK, &view, Some(&tag))
}
