//! `/v1/sessions/{name}/shadow`: another model on the same frames, until it is dropped or takes over.

use axum::body::Body;
use axum::http::{HeaderMap, StatusCode};
use axum::response::IntoResponse;
use isophote_wire::{ShadowDocument, ShadowView, SwapAnswer};

use super::parameters::{MatchHeaders, NameParam};
use super::sessions::taken;
use super::{Answer, App, RawName, put_status, raw, stateful, tagged};
use crate::compiler::Owner;
use crate::documents::{place, read_json};
use crate::preconditions::Preconditions;
use crate::turns::FairWorkers;
use crate::workshop::Lane;

/// Puts another model beside that of a session, on the same frames.
#[utoipa::path(put, path = "/v1/sessions/{name}/shadow", tag = "sessions", operation_id = "put_shadow", params(NameParam, MatchHeaders),
    request_body = ShadowDocument,
    responses((status = 201, description = "It begins with the next frame.", body = ShadowView),
              (status = 200, description = "It took the place of another.", body = ShadowView)))]
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

/// What the shadow of a session does, and what it found last.
#[utoipa::path(get, path = "/v1/sessions/{name}/shadow", tag = "sessions", operation_id = "get_shadow", params(NameParam, MatchHeaders),
    responses((status = 200, description = "Its model with its state.", body = ShadowView)))]
pub async fn get(app: App, name: RawName, preconditions: Preconditions) -> Answer {
    let shadow = app.service.session(&raw(name)?)?.shadow()?;
    stateful(&preconditions, "the shadow", Some(shadow.tag()), &shadow.view())
}

/// Drops the shadow of a session.
#[utoipa::path(delete, path = "/v1/sessions/{name}/shadow", tag = "sessions", operation_id = "delete_shadow", params(NameParam, MatchHeaders),
    responses((status = 204, description = "It is gone; the session goes on as it was.")))]
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

/// Gives a session the model of its shadow between two frames, with what the shadow knows of the target; the shadow is gone then.
#[utoipa::path(post, path = "/v1/sessions/{name}/shadow:promote", tag = "sessions", operation_id = "promote_shadow",
    params(NameParam, MatchHeaders),
    responses((status = 200, description = "From which frame on, and what was carried over.", body = SwapAnswer)))]
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
    // It may have been dropped meanwhile, with its session.
    let work = move |owner: &mut Owner| Ok(service.drop_shadow(owner, &session, "the shadow has taken over").is_ok());
    app.service.compiler.run(work).await?;
    drop(in_order);
    tagged(StatusCode::OK, &answer, Some(&tag))
}
