//! `/v1/sources/{name}/control`: the lease on the controls of a source.

use axum::body::Body;
use axum::extract::Query;
use axum::extract::rejection::QueryRejection;
use axum::http::{HeaderMap, StatusCode};
use axum::response::IntoResponse;
use isophote_wire::{ControlDocument, ControlView};
use serde::Deserialize;
use utoipa::IntoParams;

use super::parameters::{MatchHeaders, NameParam};
use super::{Answer, App, RawName, raw, stateful, tagged};
use crate::http::documents::{place, read_json};
use crate::http::preconditions::Preconditions;
use crate::problem::Problem;

/// The lease to end.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct LeaseQuery {
    /// Id of the lease, from the answer that granted it.
    lease: Option<String>,
}

/// Returns the lease on the controls of a source, and the values set last.
#[utoipa::path(get, path = "/v1/sources/{name}/control", tag = "sources", operation_id = "get_control", params(NameParam, MatchHeaders),
    responses((status = 200, description = "The lease, if any, and the last values.", body = ControlView)))]
pub async fn get(app: App, name: RawName, preconditions: Preconditions) -> Answer {
    let (tag, view) = app.service.source(&raw(name)?)?.control()?;
    stateful(&preconditions, "the lease", tag.as_ref(), &view)
}

/// Takes or renews a lease on the controls of a source, and sets them.
#[utoipa::path(put, path = "/v1/sources/{name}/control", tag = "sources", operation_id = "put_control", params(NameParam, MatchHeaders),
    request_body = ControlDocument,
    responses((status = 201, description = "The lease was granted; its id renews and ends it.", body = ControlView),
              (status = 200, description = "The lease was renewed.", body = ControlView)))]
pub async fn put(app: App, name: RawName, preconditions: Preconditions, headers: HeaderMap, body: Body) -> Answer {
    let source = app.service.source(&raw(name)?)?;
    preconditions.check("the lease", source.control()?.0.as_slice())?;
    let (document, text) = read_json::<ControlDocument>(&headers, body).await?;
    // A camera's driver may be slow.
    let taken = tokio::task::spawn_blocking(move || source.take_control(&document, &preconditions)).await;
    let taken = taken.map_err(|_| Problem::bug("asking a camera panicked"))?;
    let (is_new, tag, view) = place(taken, &text).await?;
    tagged(if is_new { StatusCode::CREATED } else { StatusCode::OK }, &view, tag.as_ref())
}

/// Ends a lease; the values that were set remain.
#[utoipa::path(delete, path = "/v1/sources/{name}/control", tag = "sources", operation_id = "delete_control",
    params(NameParam, LeaseQuery, MatchHeaders), responses((status = 204, description = "The lease has ended.")))]
pub async fn delete(
    app: App,
    name: RawName,
    query: Result<Query<LeaseQuery>, QueryRejection>,
    preconditions: Preconditions,
) -> Answer {
    let Query(query) = query.map_err(|error| Problem::bad_request(error.body_text()))?;
    app.service.source(&raw(name)?)?.leave_control(query.lease.as_deref(), &preconditions)?;
    Ok(StatusCode::NO_CONTENT.into_response())
}
