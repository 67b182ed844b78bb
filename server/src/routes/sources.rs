//! `/v1/sources`

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::IntoResponse;
use isophote_wire::{Items, SourceDocument};

use super::{Answer, App, RawName, json, new_name, old_name, opened_ahead, put_status, raw};
use crate::documents::{place, read_json};

/// `PUT /v1/sources/{name}`
pub async fn put(State(app): State<App>, name: RawName, headers: HeaderMap, body: Body) -> Answer {
    let name = new_name(name)?;
    let (mut document, text) = read_json::<SourceDocument>(&headers, body).await?;
    let opened = opened_ahead(&app, &mut document, "", None).await.map_err(|problem| place(problem, &text))?;
    let service = app.service.clone();
    let work = move || {
        let put = service.put_source(&name, document, opened)?;
        Ok((put, service.source(name.as_str())?.view(name.as_str())))
    };
    let (put, view) = app.service.compiler.run(work).await.map_err(|problem| place(problem, &text))?;
    json(put_status(put), &view)
}

/// `GET /v1/sources/{name}`
pub async fn get(State(app): State<App>, name: RawName) -> Answer {
    let name = raw(name)?;
    json(StatusCode::OK, &app.service.source(&name)?.view(&name))
}

/// `DELETE /v1/sources/{name}`
pub async fn delete(State(app): State<App>, name: RawName) -> Answer {
    let name = old_name("source", name)?;
    let service = app.service.clone();
    app.service.compiler.run(move || service.remove_source(&name)).await?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

/// `GET /v1/sources`
pub async fn list(State(app): State<App>) -> Answer {
    let items = app.service.sources().iter().map(|(name, source)| source.view(name.as_str())).collect();
    json(StatusCode::OK, &Items { items })
}
