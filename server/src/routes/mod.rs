//! HTTP: what the contract's routes do, in terms of [`Service`].

mod cameras;
mod estimates;
mod frames;
mod health;
mod models;
mod page;
mod sessions;
mod sources;

use std::sync::Arc;

use axum::Router;
use axum::extract::Path;
use axum::extract::rejection::PathRejection;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post, put};
use serde::Serialize;
use tokio::sync::mpsc;

use crate::name::Name;
use crate::problem::Problem;
use crate::service::{Put, Service};

/// The name of the WebSockets' subprotocol.
const PROTOCOL: &str = "isophote.v1";

/// What every handler gets.
#[derive(Clone)]
pub struct App {
    /// Everything that runs.
    pub service: Arc<Service>,
    /// Held by every stream: the service has stopped when all are dropped.
    pub stream: mpsc::Sender<()>,
}

/// All routes.
pub fn router(app: App) -> Router {
    Router::new()
        .route("/", get(page::html))
        .route("/page.js", get(page::script))
        .route("/livez", get(health::livez))
        .route("/readyz", get(health::readyz))
        .route("/v1/time", get(health::time))
        .route("/metrics", get(|| absent("metrics")))
        .route("/openapi.json", get(|| absent("the API's description")))
        .route("/v1/models", get(models::list))
        .route("/v1/models:check", post(models::check))
        .route("/v1/models/{name}", put(models::put).get(models::get).delete(models::delete))
        .route("/v1/models/{name}/explain", get(models::explain))
        .route("/v1/cameras", get(cameras::list))
        .route("/v1/cameras/{device}", get(cameras::get))
        .route("/v1/cameras/{device}/controls", put(cameras::set))
        .route("/v1/sources", get(sources::list))
        .route("/v1/sources/{name}", put(sources::put).get(sources::get).delete(sources::delete))
        .route("/v1/sessions", get(sessions::list))
        .route("/v1/sessions/{name}", put(sessions::put).get(sessions::get).delete(sessions::delete))
        .route("/v1/sessions/{name}/model", put(sessions::swap))
        .route("/v1/sessions/{name}/frames", post(frames::post).get(frames::get))
        .route("/v1/sessions/{name}/estimates", get(estimates::get))
        .route("/v1/sessions/{name}/preview", get(|| absent("preview")))
        .route("/v1/sessions/{name}/shadow", put(|| absent("shadow models")).delete(|| absent("shadow models")))
        .fallback(async |uri: Uri| Problem::unknown("route", uri.path()))
        .method_not_allowed_fallback(async || {
            Problem::new(StatusCode::METHOD_NOT_ALLOWED, "wrong-method", "this route does not have that method")
        })
        .with_state(app)
}

async fn absent(what: &'static str) -> Problem {
    Problem::not_in_this_build(what)
}

/// What a handler answers.
pub type Answer = Result<Response, Problem>;

/// A JSON body.
pub fn json(status: StatusCode, value: &impl Serialize) -> Answer {
    let body = serde_json::to_vec(value).map_err(|error| Problem::bug(error.to_string()))?;
    let mut response = (status, body).into_response();
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static("application/json"));
    Ok(response)
}

/// The name in the path as it was sent; whether there is such a thing is looked up later.
pub type RawName = Result<Path<String>, PathRejection>;

/// The text of a name in the path; a path that is no text names nothing.
pub fn raw(name: RawName) -> Result<String, Problem> {
    name.map(|Path(name)| name).map_err(|_| Problem::unknown("name", "(not UTF-8)"))
}

/// The name that something new is to have: 422 when it is none.
pub fn new_name(name: RawName) -> Result<Name, Problem> {
    let name = raw(name)?;
    let message = "a name is made of 1 to 64 of a-z, 0-9 and -, and does not begin with -";
    Name::parse(&name).ok_or_else(|| Problem::wrong_key("wrong-name", "name", message))
}

/// The name of something that should exist: 404 when it cannot.
pub fn old_name(what: &str, name: RawName) -> Result<Name, Problem> {
    let name = raw(name)?;
    Name::parse(&name).ok_or_else(|| Problem::unknown(what, &name))
}

/// An upgrade to our subprotocol, for messages of at most so many bytes from the client.
fn upgraded(
    headers: &HeaderMap,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
    message_bytes: usize,
) -> Result<WebSocketUpgrade, Problem> {
    let upgrade = upgrade.map_err(|error| Problem::bad_request(error.body_text()))?;
    let is_offered = headers.contains_key(header::SEC_WEBSOCKET_PROTOCOL);
    let upgrade = upgrade.protocols([PROTOCOL]).max_message_size(message_bytes).max_frame_size(message_bytes);
    if is_offered && upgrade.selected_protocol().is_none() {
        return Err(Problem::bad_request(format!("the subprotocol is {PROTOCOL}")));
    }
    Ok(upgrade)
}

fn put_status(put: Put) -> StatusCode {
    match put {
        Put::Created => StatusCode::CREATED,
        Put::Replaced => StatusCode::OK,
    }
}
