//! Liveness, readiness and time.

use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use axum::extract::State;
use axum::http::StatusCode;
use isophote_machine::monotonic_ns;
use isophote_wire::{Health, Time};

use super::{Answer, json};
use crate::http::tenants::Tenants;

/// Reports that the process is running.
#[utoipa::path(get, path = "/livez", tag = "operation", operation_id = "livez",
    responses((status = 200, description = "The process is running.", body = Health)))]
pub async fn livez() -> Answer {
    json(StatusCode::OK, &Health { status: "ok".into() })
}

/// Reports whether the service accepts changes: 503 while it stops or a tenant's thread for changes does not answer.
#[utoipa::path(get, path = "/readyz", tag = "operation", operation_id = "readyz",
    responses((status = 200, description = "The service accepts changes.", body = Health)))]
pub async fn readyz(tenants: State<Arc<Tenants>>) -> Answer {
    tenants.readiness()?;
    json(StatusCode::OK, &Health { status: "ok".into() })
}

/// Returns the clock of all `_ns` fields.
#[utoipa::path(get, path = "/v1/time", tag = "operation", operation_id = "time",
    responses((status = 200, description = "Current time.", body = Time)))]
#[allow(clippy::disallowed_methods)] // a label for people beside the monotonic clock
pub async fn time() -> Answer {
    let unix_ns = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64);
    json(StatusCode::OK, &Time { monotonic_ns: monotonic_ns(), unix_ns })
}
