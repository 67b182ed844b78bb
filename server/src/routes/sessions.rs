//! `/v1/sessions`

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::IntoResponse;
use isophote_wire::{Items, SessionDocument, SourceReference, SwapDocument};

use super::{Answer, App, RawName, json, new_name, old_name, opened_ahead, put_status, raw};
use crate::documents::{place, read_json};
use crate::problem::Problem;

/// `PUT /v1/sessions/{name}`
pub async fn put(State(app): State<App>, name: RawName, headers: HeaderMap, body: Body) -> Answer {
    let name = new_name(name)?;
    let (mut document, text) = read_json::<SessionDocument>(&headers, body).await?;
    let opened = match &mut document.source {
        SourceReference::Own(source) => {
            let model = app.service.registry.get(&document.model)?.model.clone();
            opened_ahead(&app, source, "source.", Some(model)).await.map_err(|problem| place(problem, &text))?
        }
        SourceReference::Named(_) => None,
    };
    let service = app.service.clone();
    let work = move || {
        let (put, ended) = service.put_session(&name, document, opened)?;
        Ok((put, ended, service.session(name.as_str())?.view()))
    };
    let (put, ended, view) = app.service.compiler.run(work).await.map_err(|problem| place(problem, &text))?;
    if let Some(ended) = ended {
        drop(ended.await); // where nobody could wait for it, it ends alone
    }
    json(put_status(put), &view)
}

/// `GET /v1/sessions/{name}`
pub async fn get(State(app): State<App>, name: RawName) -> Answer {
    json(StatusCode::OK, &app.service.session(&raw(name)?)?.view())
}

/// `DELETE /v1/sessions/{name}`
pub async fn delete(State(app): State<App>, name: RawName) -> Answer {
    let name = old_name("session", name)?;
    let service = app.service.clone();
    let ended = app.service.compiler.run(move || service.remove_session(&name)).await?;
    drop(ended.await); // where nobody could wait for it, it ends alone
    Ok(StatusCode::NO_CONTENT.into_response())
}

/// `GET /v1/sessions`
pub async fn list(State(app): State<App>) -> Answer {
    let items = app.service.sessions().iter().map(|(_, session)| session.view()).collect();
    json(StatusCode::OK, &Items { items })
}

/// `PUT /v1/sessions/{name}/model`: answers when the model is active.
pub async fn swap(State(app): State<App>, name: RawName, headers: HeaderMap, body: Body) -> Answer {
    let name = raw(name)?;
    app.service.session(&name)?;
    let (document, _) = read_json::<SwapDocument>(&headers, body).await?;
    let service = app.service.clone();
    let work = move || service.begin_swap(&name, &document.model);
    let (mut answer, swapped) = app.service.compiler.run(work).await?;
    let ended = |_| Problem::conflict("not-applicable", "the session ended before it took the model");
    let swapped = swapped.await.map_err(ended)?;
    answer.active_since_frame = swapped.active_since_frame;
    answer.carried = swapped.carried;
    answer.reset = swapped.reset;
    json(StatusCode::OK, &answer)
}
