//! Is it alive, is it ready, what time is it.

use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use axum::extract::State;
use axum::http::StatusCode;
use isophote_machine::monotonic_ns;
use isophote_wire::{Health, Time};

use super::{Answer, json};
use crate::tenants::Tenants;

/// Whether the process lives.
#[utoipa::path(get, path = "/livez", tag = "operation", operation_id = "livez",
    responses((status = 200, description = "It does.", body = Health)))]
pub async fn livez() -> Answer {
    json(StatusCode::OK, &Health { status: "ok".into() })
}

/// Whether changes are taken: 503 while the service stops, and when a thread that owns all changes of a tenant does not answer.
#[utoipa::path(get, path = "/readyz", tag = "operation", operation_id = "readyz",
    responses((status = 200, description = "They are.", body = Health)))]
pub async fn readyz(tenants: State<Arc<Tenants>>) -> Answer {
    tenants.readiness()?;
    json(StatusCode::OK, &Health { status: "ok".into() })
}

/// The clock of all `_ns` fields.
#[utoipa::path(get, path = "/v1/time", tag = "operation", operation_id = "time",
    responses((status = 200, description = "Now.", body = Time)))]
#[allow(clippy::disallowed_methods)] // a label beside the monotonic clock: what time a person's watch shows
pub async fn time() -> Answer {
    let unix_ns = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64);
    json(StatusCode::OK, &Time { monotonic_ns: monotonic_ns(), unix_ns })
}
