//! `/v1/sessions`

use std::sync::Arc;

use axum::body::Body;
use axum::http::{HeaderMap, StatusCode};
use axum::response::IntoResponse;
use isophote_wire::{Items, SessionDocument, SessionView, SourceReference, SwapAnswer, SwapDocument};

use super::paging::{PageQuery, RawPage, page};
use super::parameters::{MatchHeaders, NameParam};
use super::{Answer, App, RawName, listed, new_name, old_name, opened_ahead, put_status, raw, stateful, tagged};
use crate::http::documents::{place, read_json};
use crate::http::preconditions::{EntityTag, Preconditions};
use crate::problem::Problem;
use crate::registry::ModelEntry;
use crate::service::compiler::Owner;
use crate::service::declared::Keeping;
use crate::service::turns::FairWorkers;
use crate::service::workshop::Lane;
use crate::session::{PreparedSwap, Session, SlowModels, Swapped};
use crate::source::Taker;

/// Starts or replaces a session.
#[utoipa::path(put, path = "/v1/sessions/{name}", tag = "sessions", operation_id = "put_session", params(NameParam, MatchHeaders),
    request_body = SessionDocument,
    responses((status = 201, description = "The session was started.", body = SessionView),
              (status = 200, description = "The session was replaced; the previous one has ended.", body = SessionView)))]
pub async fn put(app: App, name: RawName, preconditions: Preconditions, headers: HeaderMap, body: Body) -> Answer {
    let name = new_name(name)?;
    app.service.check_session(name.as_str(), &preconditions)?;
    let (mut document, text) = read_json::<SessionDocument>(&headers, body).await?;
    let opened = match &mut document.source {
        SourceReference::Own(source) => {
            let model = app.service.registry.get(&document.model)?.model.clone();
            let taker = Taker::Session(name.clone());
            place(opened_ahead(&app, source, &taker, Some(model)).await, &text).await?
        }
        SourceReference::Named(_) => None,
    };
    let service = app.service.clone();
    let in_order = service.workshop.in_order("session", name.as_str()).await;
    let (preparing, sent) = (service.clone(), document.clone());
    let prepare = move |workers: &FairWorkers| preparing.prepare_session(&sent, workers);
    let prepared = place(service.workshop.prepare(Lane::Sessions, prepare).await, &text).await?;
    let work = move |owner: &mut Owner| {
        service.check_session(name.as_str(), &preconditions)?;
        let (put, ended) = service.put_session(owner, &name, document, opened, Some(&prepared), Keeping::Declared)?;
        Ok((put, ended, service.session_tag(name.as_str())?, service.session_view(name.as_str())?))
    };
    let (put, ended, tag, view) = place(app.service.compiler.run(work).await, &text).await?;
    drop(in_order);
    if let Some(ended) = ended {
        drop(ended.await); // an error means that there is nothing left to wait for
    }
    tagged(put_status(put), &view, Some(&tag))
}

/// Returns a session and its state.
#[utoipa::path(get, path = "/v1/sessions/{name}", tag = "sessions", operation_id = "get_session", params(NameParam, MatchHeaders),
    responses((status = 200, description = "Document and state of the session.", body = SessionView)))]
pub async fn get(app: App, name: RawName, preconditions: Preconditions) -> Answer {
    let name = raw(name)?;
    // Read before the view: a change in between has a newer tag than the answer.
    let tag = app.service.session_tag(&name)?;
    let view = app.service.session_view(&name)?;
    stateful(&preconditions, &format!("the session `{name}`"), Some(&tag), &view)
}

/// Stops and removes a session.
#[utoipa::path(delete, path = "/v1/sessions/{name}", tag = "sessions", operation_id = "delete_session", params(NameParam, MatchHeaders),
    responses((status = 204, description = "The session has ended.")))]
pub async fn delete(app: App, name: RawName, preconditions: Preconditions) -> Answer {
    let name = old_name("session", name)?;
    let service = app.service.clone();
    let work = move |owner: &mut Owner| {
        service.session_tag(name.as_str())?; // 404 before 412
        service.check_session(name.as_str(), &preconditions)?;
        service.remove_session(owner, &name)
    };
    let ended = app.service.compiler.run(work).await?;
    drop(ended.await); // an error means that there is nothing left to wait for
    Ok(StatusCode::NO_CONTENT.into_response())
}

/// Lists all sessions by name.
#[utoipa::path(get, path = "/v1/sessions", tag = "sessions", operation_id = "list_sessions", params(PageQuery),
    responses((status = 200, description = "All sessions, or one page of them.", body = Items<SessionView>)))]
pub async fn list(app: App, query: RawPage, preconditions: Preconditions) -> Answer {
    listed(&preconditions, &page(query, app.service.session_views(), |view| view.name.as_str(), Clone::clone)?)
}

/// Swaps the model of a running session between two frames; answers when the new model is active.
#[utoipa::path(put, path = "/v1/sessions/{name}/model", tag = "sessions", operation_id = "swap_model", params(NameParam, MatchHeaders),
    request_body = SwapDocument,
    responses((status = 200, description = "First frame with the new model, and parameters carried over.", body = SwapAnswer)))]
pub async fn swap(app: App, name: RawName, preconditions: Preconditions, headers: HeaderMap, body: Body) -> Answer {
    let name = raw(name)?;
    app.service.session(&name)?;
    app.service.check_session(&name, &preconditions)?;
    let (SwapDocument { model, allow_slow }, _) = read_json(&headers, body).await?;
    let service = app.service.clone();
    let in_order = service.workshop.in_order("session", &name).await;
    let (session, entry) = (service.session(&name)?, service.registry.get(&model)?);
    let slow = if allow_slow { SlowModels::Allowed } else { SlowModels::Refused };
    let (tried, candidate) = (session.clone(), entry.clone());
    let prepare = move |workers: &FairWorkers| tried.prepare_swap(&candidate, slow, workers);
    let prepared = service.workshop.prepare(Lane::Sessions, prepare).await?;
    let checking = service.clone();
    let check = move || checking.check_session(&name, &preconditions);
    let (tag, answer) = taken(&app, session, &entry, prepared, check).await?;
    drop(in_order);
    tagged(StatusCode::OK, &answer, Some(&tag))
}

/// Commits a prepared swap if it passes `check`, and waits until the session has taken it. Also returns the session's new tag.
pub async fn taken(
    app: &App,
    session: Arc<Session>,
    entry: &Arc<ModelEntry>,
    prepared: PreparedSwap,
    check: impl FnOnce() -> Result<(), Problem> + Send + 'static,
) -> Result<(EntityTag, SwapAnswer), Problem> {
    let (service, compile_ms, theirs) = (app.service.clone(), prepared.compile_ms, entry.clone());
    let work = move |owner: &mut Owner| {
        check()?;
        let swapped = service.commit_swap(owner, session.name(), &session, &theirs, prepared)?;
        Ok((service.session_tag(session.name())?, swapped))
    };
    // Sessions end with the service.
    let unless_stopping = |problem| if app.service.is_draining() { Problem::stopping() } else { problem };
    let (tag, swapped) = app.service.compiler.run(work).await.map_err(unless_stopping)?;
    let ended = |_| Problem::conflict("not-applicable", "the session ended before it took the model");
    let Swapped { active_since_frame, carried, reset } = swapped.await.map_err(ended).map_err(unless_stopping)?;
    let (model, active_digest) = (entry.name.to_string(), entry.model.digest().to_string());
    let (requested_model, active_model) = (model.clone(), model);
    let answer =
        SwapAnswer { requested_model, active_model, active_digest, active_since_frame, carried, reset, compile_ms };
    Ok((tag, answer))
}
