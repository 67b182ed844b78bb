//! Who turns the knobs of a source.

use isophote_capture::camera::ControlValues;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// `PUT /v1/sources/{name}/control`: takes a lease on the knobs of a source, or renews it, and sets them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ControlDocument {
    /// Who wants them: what others are told.
    pub owner: String,
    /// The id that taking the lease answered, to renew it; absent: a new one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lease: Option<String>,
    /// It runs out after so long unless it is renewed, s.
    #[serde(default = "default_timeout_s")]
    pub timeout_s: f64,
    /// So many times as much light as in the beginning.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure: Option<f64>,
    /// Of a camera: controls by name.
    #[serde(default, skip_serializing_if = "ControlValues::is_empty")]
    pub controls: ControlValues,
}

fn default_timeout_s() -> f64 {
    5.0
}

/// What was set.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ControlCommand {
    /// So many times as much light as in the beginning.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure: Option<f64>,
    /// Of a camera: controls by name, as the driver took them.
    #[serde(default, skip_serializing_if = "ControlValues::is_empty")]
    pub controls: ControlValues,
}

/// `GET /v1/sources/{name}/control`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ControlView {
    /// Who has the lease; absent where nobody has.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub owner: Option<String>,
    /// Its id, told only to whom it is given.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub lease: Option<String>,
    /// Until it runs out, s; absent of a session's, which ends with the session.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub expires_in_s: Option<f64>,
    /// What was set last, by whomever.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub last_command: Option<ControlCommand>,
    /// Frames from this number on show it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub since_frame: Option<u64>,
}

/// Of a session that controls the exposure of its source.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ExposureControl {
    /// Whether it has the lease on the source's knobs.
    pub held: bool,
    /// Who has it instead. The session goes on, and takes it as soon as it is free.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub reason: Option<String>,
}
