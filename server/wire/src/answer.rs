//! Answers of the service.

use std::collections::BTreeMap;

pub use isophote_capture::camera::{CameraInfo, CameraStatus, ControlInfo, ControlKind};
use isophote_symbolic::{Diagnostic, Method};
pub use isophote_tracker::{BodyCost, CheckReport as ModelReport, LoopCost, LoopSums, StageCost as StageReport};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{
    ControlView, EstimateView, ExposureControl, PlaybackView, RecordingView, SessionDocument, ShadowView,
    SourceDocument,
};

/// An error, RFC 9457: `application/problem+json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ProblemDocument {
    /// Path of the explanation of the error: `/docs/errors#<code>`.
    #[serde(rename = "type")]
    pub kind: String,
    /// Stable code, for programs.
    pub code: String,
    /// The HTTP status in words.
    pub title: String,
    /// The HTTP status.
    pub status: u16,
    /// Explanation of this occurrence, as a sentence.
    pub detail: String,
    /// Faults of the document; present in every 422.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub diagnostics: Vec<Diagnostic>,
    /// Measured values by name, with the unit in the name: `fit_ms`, `budget_ms`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub figures: BTreeMap<String, f64>,
}

/// A list, or a page of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Items<T> {
    /// Items in order of name.
    pub items: Vec<T>,
    /// Value of `after` for the next page, if there are more items.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub next: Option<String>,
}

/// Answer of `PUT /v1/models/{name}`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ModelAnswer {
    /// The name in the registry.
    pub name: String,
    /// Version; counts the documents put under this name, from 1.
    pub version: u64,
    /// Older versions that were deleted to limit their number.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub collected: Vec<u64>,
    /// The report, as printed by `model check`.
    #[serde(flatten)]
    pub report: ModelReport,
}

/// `GET /v1/models/{name}`: the document with its name in the registry, version and digest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ModelView {
    /// Version; counts the documents put under this name, from 1.
    pub version: u64,
    /// `sha256:…` of the canonical document.
    pub digest: String,
    /// The canonical document.
    #[serde(flatten)]
    pub document: serde_json::Map<String, serde_json::Value>,
}

/// One item of `GET /v1/models`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ModelItem {
    /// The name in the registry.
    pub name: String,
    /// Version; counts the documents put under this name, from 1.
    pub version: u64,
    /// `sha256:…` of the canonical document.
    pub digest: String,
    /// Description in the document.
    pub description: String,
    /// Names of the parameters, in document order.
    pub parameters: Vec<String>,
}

/// Stored versions of a model.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct VersionList {
    /// Versions, newest first.
    pub items: Vec<VersionItem>,
    /// Number of older versions that were deleted.
    pub collected: u64,
}

/// One version of a model.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct VersionItem {
    /// Version; counts the documents put under the name, from 1.
    pub version: u64,
    /// `sha256:…` of the canonical document.
    pub digest: String,
    /// Whether this is the active version.
    pub active: bool,
    /// Size of its text, bytes.
    pub bytes: u64,
    /// Time of its `PUT`, by the wall clock; absent if not recorded.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub created_at: Option<String>,
}

/// Output of `model explain --json`: the figures of one subset and the requested text.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Explanation {
    /// The document's name.
    pub model: String,
    /// `sha256:…` of the canonical document.
    pub digest: String,
    /// Kind of text: the value of `show`.
    pub show: String,
    /// Costs of the subset, including `compile_ms`.
    #[serde(flatten)]
    pub stage: StageReport,
    /// The text.
    pub text: String,
    /// For `program`, `clif` and `asm`: the value that each line of the text computes, which links the texts to each other and to
    /// the document.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lines: Vec<LinePlace>,
    /// For `table`: the cost per pixel, as differentiated and as compiled, of gradient, Hessian, and both jointly.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub loops: Vec<LoopCost>,
}

/// Origin of a line of an explanation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct LinePlace {
    /// Value of the program that the line computes: 12 for `v12`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub value: Option<u32>,
    /// Byte range of the formula behind it, in the document as sent.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub span: Option<[u32; 2]>,
}

/// Answer of `POST /v1/models:check`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CheckAnswer {
    /// The report, as printed by `model check`.
    #[serde(flatten)]
    pub report: ModelReport,
    /// The document's formulas in MathML, as `explain` shows them.
    pub formulas: String,
}

/// Output of `model export --json`.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Exported {
    /// The document's name.
    pub model: String,
    /// `sha256:…` of the canonical document.
    pub digest: String,
    /// The free parameters.
    pub parameters: Vec<String>,
    /// The method whose derivatives are summed.
    pub method: Method,
    /// `c` or `rust`.
    pub language: String,
    /// The source.
    pub text: String,
}

/// `GET /v1/sources/{name}`: the source's document and state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SourceView {
    /// Name.
    pub name: String,
    /// The document as put, with defaults.
    #[serde(flatten)]
    pub document: SourceDocument,
    /// State.
    pub state: SourceState,
    /// Reason for the state, if any.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub reason: Option<String>,
    /// Time of its `PUT`, by the wall clock.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub declared_at: Option<String>,
    /// Number of frames delivered.
    pub frames: u64,
    /// Recording: number of unreadable frames, which were skipped.
    #[serde(skip_serializing_if = "is_zero", default)]
    pub unread: u64,
    /// Number of sessions that use it.
    pub sessions: usize,
    /// Recording: position of the last frame shown, from 0; it goes back when the recording does.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub position: Option<u64>,
    /// Synthetic source and recording: state of the playback.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub playback: Option<PlaybackView>,
    /// Lease on its controls, if any.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub control: Option<ControlView>,
    /// Camera: settings and losses.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub camera: Option<CameraStatus>,
}

/// State of a source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SourceState {
    /// No session uses it; it waits.
    Idle,
    /// It delivers frames.
    Running,
    /// A camera streams without pictures, or a looping recording has no readable frame; see `reason`.
    Stalled,
    /// The camera is disconnected; see `reason`. The service keeps looking for it.
    Lost,
    /// There are no more frames.
    Ended,
    /// It cannot deliver frames; see `reason`.
    Failed,
}

/// State of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SessionState {
    /// No frame has been fitted yet.
    Starting,
    /// It fits frames.
    Running,
    /// No frames arrive from a source that should deliver them.
    Stalled,
    /// The source failed or its camera is disconnected; see `reason`.
    LostSource,
    /// The source has no more frames.
    Stopped,
    /// The session cannot go on; see `reason`.
    Failed,
}

/// `GET /v1/sessions/{name}`: the session's document and state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SessionView {
    /// Name.
    pub name: String,
    /// The document as put, with defaults; `model` is the active one.
    #[serde(flatten)]
    pub document: SessionDocument,
    /// State.
    pub state: SessionState,
    /// Reason for the state, if any.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub reason: Option<String>,
    /// Keys of the document without effect, each with a remedy.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub warnings: Vec<Diagnostic>,
    /// Model requested last.
    pub requested_model: String,
    /// Model that fits the frames.
    pub active_model: String,
    /// Digest of the active model.
    pub active_digest: String,
    /// First frame fitted with the active model.
    pub active_since_frame: u64,
    /// Vector width of its kernels, bits. It determines the order of the sums over pixels: fits with the same width agree bit for
    /// bit.
    pub vector_width: usize,
    /// Number of frames fitted.
    pub frames: u64,
    /// Number of frames of the source that were not fitted.
    pub dropped: u64,
    /// Recent estimates per second.
    pub rate_hz: f64,
    /// Node on which it runs: the id of the data folder or, without one, of the process.
    pub node: String,
    /// Number that grows with every start of a session on this node; with the frame number it identifies an estimate permanently.
    /// Absent if the session does not run.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub epoch: Option<u64>,
    /// Time of its `PUT`, by the wall clock; absent for the demo's session.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub declared_at: Option<String>,
    /// Time of its start, by the wall clock.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub started_at: Option<String>,
    /// Number of starts of the service since its `PUT`.
    #[serde(skip_serializing_if = "is_zero", default)]
    pub restarts: u64,
    /// Processor time that the fits of a frame may take, ms, if frames do not wait for them: the source's interval, at most 250.
    /// A longer fit ends with its best point so far.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub frame_budget_ms: Option<f64>,
    /// Processor time that a search of the whole frame may take, ms, if frames do not wait; it grows while searches take longer.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub search_budget_ms: Option<f64>,
    /// Number of frames that exceeded `frame_budget_ms` or `search_budget_ms`.
    #[serde(default)]
    pub over_budget: u64,
    /// Number of frames with a search of the whole frame, if frames do not wait for fits.
    #[serde(default)]
    pub searches: u64,
    /// Number of frames whose search was postponed because other sessions were searching.
    #[serde(default)]
    pub searches_postponed: u64,
    /// Total processor time of a frame without a search, ms: mean of recent frames.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub cost_ms: Option<f64>,
    /// State of the exposure control, if the session controls the exposure of its source.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub exposure_control: Option<ExposureControl>,
    /// Shadow: another model on the same frames.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub shadow: Option<ShadowView>,
    /// Its recording, in progress or ended by itself, since the session was started; absent after a client ended it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub recording: Option<RecordingView>,
    /// Session on a camera: settings and losses of the camera.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub source_camera: Option<CameraStatus>,
    /// The last estimate.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub last: Option<EstimateView>,
}

fn is_zero(count: &u64) -> bool {
    *count == 0
}

/// Answer of a hot swap.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SwapAnswer {
    /// Model requested.
    pub requested_model: String,
    /// Model that fits the frames now.
    pub active_model: String,
    /// Digest of the active model.
    pub active_digest: String,
    /// First frame fitted with the active model.
    pub active_since_frame: u64,
    /// Parameters that keep their values.
    pub carried: Vec<String>,
    /// Parameters that are reset to starting values.
    pub reset: Vec<String>,
    /// Time spent on compilation, ms; near 0 for a model whose kernels exist.
    pub compile_ms: f64,
}

/// Answer of `GET /v1/time`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Time {
    /// CLOCK_MONOTONIC, ns: the clock of the `*_ns` fields.
    pub monotonic_ns: u64,
    /// The wall clock at the same moment, ns since 1970; informative only.
    pub unix_ns: u64,
}

/// Answer of `GET /livez` and `GET /readyz`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Health {
    /// `ok`; otherwise the answer is a problem document.
    pub status: String,
}
