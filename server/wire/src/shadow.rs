//! A shadow: another model on the frames of a session, beside it.

use std::collections::BTreeMap;

use isophote_tracker::Disagreement;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::estimate::EstimateView;

/// `PUT /v1/sessions/{name}/shadow`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ShadowDocument {
    /// Name of a model of the registry.
    pub model: String,
    /// Constants of the model, by name, instead of the session's.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub constants: BTreeMap<String, f64>,
}

/// What a shadow does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ShadowState {
    /// It has fitted no frame yet.
    Starting,
    /// It fits frames.
    Running,
    /// It gives way: the session has lost frames; see `reason`.
    Shed,
    /// It cannot go on; see `reason`. The session does.
    Failed,
}

/// `GET /v1/sessions/{name}/shadow`, and `shadow` of a session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ShadowView {
    /// The model's name.
    pub model: String,
    /// Its digest, when it was put.
    pub digest: String,
    /// What it does.
    pub state: ShadowState,
    /// Why it does not run.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub reason: Option<String>,
    /// The first frame that it fitted.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub since_frame: Option<u64>,
    /// Frames fitted.
    pub frames: u64,
    /// Frames that the session has fitted, and the shadow has not.
    pub dropped: u64,
    /// Frames that took longer than frames of the source may.
    pub over_budget: u64,
    /// What a frame that is not searched costs of a processor, ms: a mean of the last ones.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub cost_ms: Option<f64>,
    /// Parameters that began with the session's values.
    pub carried: Vec<String>,
    /// Parameters that began anew.
    pub reset: Vec<String>,
    /// The last of its estimates, and how far it is from the session's of that frame.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub last: Option<ShadowEstimate>,
}

/// What a shadow says of a frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ShadowEstimate {
    /// Its own estimate.
    #[schema(no_recursion)]
    pub estimate: Box<EstimateView>,
    /// The shadow's less the session's.
    #[serde(flatten)]
    pub disagreement: Disagreement,
}
