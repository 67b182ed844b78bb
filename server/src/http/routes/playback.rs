//! `/v1/sources/{name}/scene` and `…/playback`: change the scene and the playback of a running source.

use std::sync::Arc;

use axum::body::Body;
use axum::http::{HeaderMap, StatusCode};
use isophote_wire::{PlaybackDocument, PlaybackView, SceneDocument, SceneView};

use super::parameters::{MatchHeaders, NameParam};
use super::{Answer, App, RawName, json, raw, representation, stateful, tagged};
use crate::http::documents::{place, read_json};
use crate::http::preconditions::Preconditions;
use crate::problem::Problem;
use crate::source::Source;

fn source(app: &App, name: RawName) -> Result<Arc<Source>, Problem> {
    app.service.source(&raw(name)?)
}

/// Returns the scene of a synthetic source.
#[utoipa::path(get, path = "/v1/sources/{name}/scene", tag = "sources", operation_id = "get_scene", params(NameParam, MatchHeaders),
    responses((status = 200, description = "The complete scene, and the first frame that shows it.", body = SceneView)))]
pub async fn scene(app: App, name: RawName, preconditions: Preconditions) -> Answer {
    let (tag, view) = source(&app, name)?.scene()?;
    representation(&preconditions, "the scene", &tag, json(StatusCode::OK, &view)?)
}

/// Changes the scene of a synthetic source between two frames; its time continues.
#[utoipa::path(put, path = "/v1/sources/{name}/scene", tag = "sources", operation_id = "put_scene", params(NameParam, MatchHeaders),
    request_body = SceneDocument,
    responses((status = 200, description = "The complete scene, and the first frame that shows it.", body = SceneView)))]
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
    // Parsing formulas may take long.
    let change = tokio::task::spawn_blocking(move || source.set_scene(document, &preconditions)).await;
    let changed = change.map_err(|_| Problem::bug("reading the scene panicked"))?;
    let (tag, view) = place(changed, &text).await?;
    tagged(StatusCode::OK, &view, Some(&tag))
}

/// Returns the state of the playback of a recording or a synthetic source.
#[utoipa::path(get, path = "/v1/sources/{name}/playback", tag = "sources", operation_id = "get_playback", params(NameParam, MatchHeaders),
    responses((status = 200, description = "State of the playback.", body = PlaybackView)))]
pub async fn playback(app: App, name: RawName, preconditions: Preconditions) -> Answer {
    let (tag, view) = source(&app, name)?.playback()?;
    stateful(&preconditions, "the playback", Some(&tag), &view)
}

/// Pauses a recording or a synthetic source, moves it to a frame, or changes its speed. Frame numbers only increase.
#[utoipa::path(put, path = "/v1/sources/{name}/playback", tag = "sources", operation_id = "put_playback", params(NameParam, MatchHeaders),
    request_body = PlaybackDocument,
    responses((status = 200, description = "New state of the playback.", body = PlaybackView)))]
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
