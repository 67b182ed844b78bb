//! `/v1/cameras`: the cameras of this machine, and their controls.

use axum::body::Body;
use axum::http::{HeaderMap, StatusCode};
use isophote_capture::CameraError;
use isophote_capture::camera::{self, ControlValue, ControlValues};
use isophote_wire::{CameraInfo, ControlsAnswer, Items};

use super::parameters::DeviceParam;
use super::{Answer, App, RawName, json, raw};
use crate::http::documents::{place, read_json};
use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::source::camera_problem;
use crate::source::control::CameraNames;

/// Lists the cameras of the service's machine.
#[utoipa::path(get, path = "/v1/cameras", tag = "cameras", operation_id = "list_cameras",
    responses((status = 200, description = "All usable cameras.", body = Items<CameraInfo>)))]
pub async fn list(app: App) -> Answer {
    json(StatusCode::OK, &Items { items: asked(&app, "a camera", camera::cameras).await?, next: None })
}

/// Returns a camera with its formats and controls.
#[utoipa::path(get, path = "/v1/cameras/{device}", tag = "cameras", operation_id = "get_camera", params(DeviceParam),
    responses((status = 200, description = "The camera.", body = CameraInfo)))]
pub async fn get(app: App, name: RawName) -> Answer {
    let device = raw(name)?;
    let asked_of = device.clone();
    let found = asked(&app, &asked_of, move || camera::camera(&device)).await?;
    json(StatusCode::OK, &found.map_err(|error| problem(&error))?)
}

/// Sets controls of a camera, also while it streams; refused (409) while a lease on them exists.
#[utoipa::path(put, path = "/v1/cameras/{device}/controls", tag = "cameras", operation_id = "set_controls",
    params(DeviceParam), request_body = BTreeMap<String, ControlValue>,
    responses((status = 200, description = "Controls as read back from the driver.", body = ControlsAnswer)))]
pub async fn set(app: App, name: RawName, headers: HeaderMap, body: Body) -> Answer {
    let device = raw(name)?;
    let (values, text) = read_json::<ControlValues>(&headers, body).await?;
    let (machine, asked_of) = (app.service.machine.clone(), device.clone());
    let set = move || {
        let found = camera::camera(&device).map_err(|error| problem(&error))?;
        let names = CameraNames::of(&found);
        let set = camera::set_controls(&found.device, &values, &|| machine.refuse_control(&names).is_ok());
        // Refuses if a lease was taken meanwhile: its owner now sets the controls.
        machine.refuse_control(&names)?;
        set.map_err(|error| problem(&error))
    };
    let controls = place(asked(&app, &asked_of, set).await?, &text).await?;
    json(StatusCode::OK, &ControlsAnswer { controls })
}

/// Asks a driver, with a timeout.
async fn asked<T: Send + 'static>(
    app: &App,
    device: &str,
    question: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    let (drivers, device) = (app.service.machine.drivers.clone(), device.to_string());
    let asking = move || drivers.ask(&device, LIMITS.camera_open_time, question);
    tokio::task::spawn_blocking(asking).await.map_err(|_| Problem::bug("asking a camera panicked"))?
}

fn problem(error: &CameraError) -> Problem {
    match error {
        CameraError::Missing { .. } | CameraError::NotACamera { .. } => {
            Problem::new(StatusCode::NOT_FOUND, "unknown-name", error.to_string())
        }
        CameraError::Control { name, .. } => Problem::wrong_key("wrong-value", name, error.to_string()),
        _ => camera_problem(error, ""),
    }
}
