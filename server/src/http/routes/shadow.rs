//! `/v1/sessions/{name}/shadow`: another model on the same frames, until it is dropped or promoted.

use axum::body::Body;
use axum::http::{HeaderMap, StatusCode};
use axum::response::IntoResponse;
use isophote_wire::{ShadowDocument, ShadowView, SwapAnswer};

use super::parameters::{MatchHeaders, NameParam};
use super::sessions::taken;
use super::{Answer, App, RawName, put_status, raw, stateful, tagged};
use crate::http::documents::{place, read_json};
use crate::http::preconditions::Preconditions;
use crate::service::compiler::Owner;
use crate::service::turns::FairWorkers;
use crate::service::workshop::Lane;

/// Creates or replaces the shadow of a session: another model that is fitted to the same frames.
#[utoipa::path(put, path = "/v1/sessions/{name}/shadow", tag = "sessions", operation_id = "put_shadow", params(NameParam, MatchHeaders),
    request_body = ShadowDocument,
    responses((status = 201, description = "The shadow was created; it begins with the next frame.", body = ShadowView),
              (status = 200, description = "The shadow was replaced.", body = ShadowView)))]
pub async fn put(app: App, name: RawName, preconditions: Preconditions, headers: HeaderMap, body: Body) -> Answer {
    let name = raw(name)?;
    app.service.session(&name)?.check_shadow_tag(&preconditions)?;
    let (document, text) = read_json::<ShadowDocument>(&headers, body).await?;
    let service = app.service.clone();
    let in_order = service.workshop.in_order("session", &name).await;
    let (session, entry) = (service.session(&name)?, service.registry.get(&document.model)?);
    let beside = session.clone();
    let prepare = move |workers: &FairWorkers| beside.prepare_shadow(entry, &document, workers);
    let prepared = place(service.workshop.prepare(Lane::Uploads, prepare).await, &text).await?;
    let work = move |owner: &mut Owner| {
        session.check_shadow_tag(&preconditions)?;
        let (put, view) = service.put_shadow(owner, &name, &session, prepared)?;
        Ok((put, session.shadow_tag(), view))
    };
    let (put, tag, view) = app.service.compiler.run(work).await?;
    drop(in_order);
    tagged(put_status(put), &view, tag.as_ref())
}

/// Returns the shadow of a session with its state and last estimate.
#[utoipa::path(get, path = "/v1/sessions/{name}/shadow", tag = "sessions", operation_id = "get_shadow", params(NameParam, MatchHeaders),
    responses((status = 200, description = "Model and state of the shadow.", body = ShadowView)))]
pub async fn get(app: App, name: RawName, preconditions: Preconditions) -> Answer {
    let shadow = app.service.session(&raw(name)?)?.shadow()?;
    stateful(&preconditions, "the shadow", Some(shadow.tag()), &shadow.view())
}

/// Removes the shadow of a session.
#[utoipa::path(delete, path = "/v1/sessions/{name}/shadow", tag = "sessions", operation_id = "delete_shadow", params(NameParam, MatchHeaders),
    responses((status = 204, description = "The shadow was removed; the session continues unchanged.")))]
pub async fn delete(app: App, name: RawName, preconditions: Preconditions) -> Answer {
    let session = app.service.session(&raw(name)?)?;
    let in_order = app.service.workshop.in_order("session", session.name()).await;
    let service = app.service.clone();
    let work = move |owner: &mut Owner| {
        session.shadow()?; // 404 before 412
        session.check_shadow_tag(&preconditions)?;
        service.drop_shadow(owner, &session, "the shadow was dropped")
    };
    app.service.compiler.run(work).await?;
    drop(in_order);
    Ok(StatusCode::NO_CONTENT.into_response())
}

/// Makes the shadow the model of the session between two frames, with its tracking state, and removes the shadow.
#[utoipa::path(post, path = "/v1/sessions/{name}/shadow:promote", tag = "sessions", operation_id = "promote_shadow",
    params(NameParam, MatchHeaders),
    responses((status = 200, description = "First frame with the new model, and parameters carried over.", body = SwapAnswer)))]
pub async fn promote(app: App, name: RawName, preconditions: Preconditions) -> Answer {
    let name = raw(name)?;
    let service = app.service.clone();
    let in_order = service.workshop.in_order("session", &name).await;
    let session = service.session(&name)?;
    let entry = session.shadow()?.entry().clone();
    session.check_shadow_tag(&preconditions)?;
    let (tried, candidate) = (session.clone(), entry.clone());
    let prepare = move |workers: &FairWorkers| tried.prepare_promotion(&candidate, workers);
    let prepared = service.workshop.prepare(Lane::Sessions, prepare).await?;
    let checked = session.clone();
    let check = move || checked.check_shadow_tag(&preconditions);
    let (tag, answer) = taken(&app, session.clone(), &entry, prepared, check).await?;
    // The shadow may have been dropped meanwhile, with its session.
    let work = move |owner: &mut Owner| Ok(service.drop_shadow(owner, &session, "the shadow has taken over").is_ok());
    app.service.compiler.run(work).await?;
    drop(in_order);
    tagged(StatusCode::OK, &answer, Some(&tag))
}
