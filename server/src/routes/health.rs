//! Is it alive, is it ready, what time is it.

use std::time::{SystemTime, UNIX_EPOCH};

use axum::extract::State;
use axum::http::StatusCode;
use isophote_machine::monotonic_ns;
use isophote_wire::{Health, Time};

use super::{Answer, App, json};

/// `GET /livez`
pub async fn livez() -> Answer {
    json(StatusCode::OK, &Health { status: "ok".into() })
}

/// `GET /readyz`: 503 while it stops.
pub async fn readyz(State(app): State<App>) -> Answer {
    let (status, text) = match app.service.is_ready() {
        true => (StatusCode::OK, "ok"),
        false => (StatusCode::SERVICE_UNAVAILABLE, "draining"),
    };
    json(status, &Health { status: text.into() })
}

/// `GET /v1/time`
#[allow(clippy::disallowed_methods)] // a label beside the monotonic clock: what time a person's watch shows
pub async fn time() -> Answer {
    let unix_ns = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64);
    json(StatusCode::OK, &Time { monotonic_ns: monotonic_ns(), unix_ns })
}
