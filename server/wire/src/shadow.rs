//! A shadow: another model on the frames of a session, beside it.

use std::collections::BTreeMap;

use isophote_tracker::Disagreement;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::estimate::EstimateView;

/// Body of `PUT /v1/sessions/{name}/shadow`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ShadowDocument {
    /// Name of a model in the registry.
    pub model: String,
    /// Constants of the model, by name, replacing the session's.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub constants: BTreeMap<String, f64>,
}

/// State of a shadow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ShadowState {
    /// It has fitted no frame yet.
    Starting,
    /// It fits frames.
    Running,
    /// It gets no frames, because the session has lost some; see `reason`.
    Shed,
    /// It has failed; see `reason`. The session continues.
    Failed,
}

/// The shadow of a session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ShadowView {
    /// Name of the model.
    pub model: String,
    /// Digest of the model when the shadow was put.
    pub digest: String,
    /// State.
    pub state: ShadowState,
    /// Reason for the state, if it does not run.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub reason: Option<String>,
    /// First frame that it fitted.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub since_frame: Option<u64>,
    /// Number of frames fitted.
    pub frames: u64,
    /// Number of frames that the session has fitted and the shadow has not.
    pub dropped: u64,
    /// Number of frames that exceeded the time limit of a frame.
    pub over_budget: u64,
    /// Processor time of a frame without a search, ms: mean of recent frames.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub cost_ms: Option<f64>,
    /// Parameters that started with the session's values.
    pub carried: Vec<String>,
    /// Parameters that started with starting values of their own.
    pub reset: Vec<String>,
    /// Its last estimate, and the difference from the session's estimate of that frame.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub last: Option<ShadowEstimate>,
}

/// A shadow's estimate of a frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ShadowEstimate {
    /// The estimate.
    #[schema(no_recursion)]
    pub estimate: Box<EstimateView>,
    /// The shadow's values less the session's.
    #[serde(flatten)]
    pub disagreement: Disagreement,
}
