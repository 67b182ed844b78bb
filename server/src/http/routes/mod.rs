//! HTTP routes and their handlers, in terms of [`Service`](crate::service::Service).

mod answer;
mod cameras;
mod control;
mod docs;
mod download;
mod estimates;
mod fit;
mod frames;
mod health;
mod metrics;
mod models;
mod openapi;
mod packed;
mod page;
mod paging;
mod parameters;
mod playback;
mod preview;
mod recordings;
mod schemas;
mod sessions;
mod shadow;
mod sources;

use std::sync::Arc;

use axum::Router;
use axum::body::Body;
use axum::http::{StatusCode, header};
use axum::middleware::from_fn;
use axum::routing::{get, post, put};

use crate::http::app::App;
use crate::http::documents::read_body;
use crate::http::openings::opened_ahead;
use crate::http::preconditions;
use crate::http::tenants::Tenants;
use crate::limits::LIMITS;
use crate::problem::Problem;

pub use page::is_navigation;

use answer::{
    Answer, RawName, json, listed, new_name, old_name, put_status, raw, representation, stateful, tagged, upgraded,
};

/// All routes.
pub fn router(tenants: Arc<Tenants>) -> Router {
    tagged_routes()
        .merge(untagged_routes().route_layer(from_fn(preconditions::refused)))
        .fallback(page::unknown_route)
        .method_not_allowed_fallback(async || Problem::wrong_method())
        .with_state(tenants)
}

/// Routes with ETags: their handlers check preconditions.
fn tagged_routes() -> Router<Arc<Tenants>> {
    Router::new()
        .route("/", get(page::html))
        .route("/page.js", get(page::script))
        .route("/page.css", get(page::style))
        .route("/page/{file}", get(page::part))
        .route("/docs/", get(docs::index))
        .route("/docs/{*path}", get(docs::page))
        .route("/v1/models", get(models::list))
        .route(
            "/v1/models/{name}",
            put(models::put)
                .get(models::get)
                .delete(models::delete)
                .post(models::act)
                .fallback(async || Problem::wrong_method()) // without it, methods that no model has go round the layer
                .layer(from_fn(models::methods)),
        )
        .route("/v1/models/{name}/explain", get(models::explain))
        .route("/v1/models/{name}/versions", get(models::versions))
        .route("/v1/sources", get(sources::list))
        .route("/v1/sources/{name}", put(sources::put).get(sources::get).delete(sources::delete))
        .route("/v1/sources/{name}/scene", put(playback::set_scene).get(playback::scene))
        .route("/v1/sources/{name}/playback", put(playback::set_playback).get(playback::playback))
        .route("/v1/sources/{name}/control", put(control::put).get(control::get).delete(control::delete))
        .route("/v1/sessions", get(sessions::list))
        .route("/v1/sessions/{name}", put(sessions::put).get(sessions::get).delete(sessions::delete))
        .route("/v1/sessions/{name}/model", put(sessions::swap))
        .route("/v1/sessions/{name}/recording", put(recordings::put).get(recordings::get).delete(recordings::delete))
        .route("/v1/sessions/{name}/shadow", put(shadow::put).get(shadow::get).delete(shadow::delete))
        .route("/v1/sessions/{name}/shadow:promote", post(shadow::promote))
        .route("/v1/recordings", get(recordings::list))
        .route("/v1/recordings/{file}", get(recordings::read).delete(recordings::remove))
}

/// Routes without ETags.
fn untagged_routes() -> Router<Arc<Tenants>> {
    Router::new()
        .route("/docs", get(docs::start))
        .route("/livez", get(health::livez))
        .route("/readyz", get(health::readyz))
        .route("/v1/time", get(health::time))
        .route("/metrics", get(metrics::get))
        .route("/openapi.json", get(openapi::get))
        .route("/v1/models:check", post(models::check))
        .route("/v1/cameras", get(cameras::list))
        .route("/v1/cameras/{device}", get(cameras::get))
        .route("/v1/cameras/{device}/controls", put(cameras::set))
        .route("/v1/sessions/{name}/frames", post(frames::post).get(frames::get))
        .route("/v1/sessions/{name}/estimates", get(estimates::get))
        .route("/v1/sessions/{name}/preview", get(preview::get))
}

/// Router used at the connection limit: answers `/livez` and refuses all else, then closes the connection.
pub fn full() -> Router {
    let refuse = async |body: Body| {
        drop(read_body(body, 0).await); // discarded, so that the sender can read the answer
        let detail = format!("all {} connections are taken; try again", LIMITS.sockets);
        ([(header::CONNECTION, "close")], Problem::new(StatusCode::SERVICE_UNAVAILABLE, "full", detail))
    };
    let alive = async || ([(header::CONNECTION, "close")], health::livez().await);
    Router::new().route("/livez", get(alive)).fallback(refuse)
}
