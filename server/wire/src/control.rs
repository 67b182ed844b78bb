//! Leases on the controls of a source.

use isophote_capture::camera::ControlValues;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Body of `PUT /v1/sources/{name}/control`: takes or renews a lease on the controls of a source, and sets them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ControlDocument {
    /// Name of the holder, shown to other clients.
    pub owner: String,
    /// Id of the lease to renew, from the answer that granted it; when absent, a new lease is taken.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lease: Option<String>,
    /// Time after which the lease expires unless renewed, s.
    #[serde(default = "default_timeout_s")]
    pub timeout_s: f64,
    /// Light as a multiple of the initial light.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure: Option<f64>,
    /// Camera: controls by name.
    #[serde(default, skip_serializing_if = "ControlValues::is_empty")]
    pub controls: ControlValues,
}

fn default_timeout_s() -> f64 {
    5.0
}

/// Values that were set.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ControlCommand {
    /// Light as a multiple of the initial light.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure: Option<f64>,
    /// Camera: controls by name, as the driver applied them.
    #[serde(default, skip_serializing_if = "ControlValues::is_empty")]
    pub controls: ControlValues,
}

/// Lease on the controls of a source, and the values set last.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ControlView {
    /// Holder of the lease; absent if there is none.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub owner: Option<String>,
    /// Id of the lease, sent to its holder only.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub lease: Option<String>,
    /// Time until the lease expires, s; absent for a session's lease, which ends with the session.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub expires_in_s: Option<f64>,
    /// Last values set, by any holder.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub last_command: Option<ControlCommand>,
    /// First frame that shows these values.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub since_frame: Option<u64>,
}

/// State of a session's exposure control.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ExposureControl {
    /// Whether the session holds the lease on the source's controls.
    pub held: bool,
    /// Current holder of the lease, if another. The session continues and takes the lease as soon as it is free.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub reason: Option<String>,
}
