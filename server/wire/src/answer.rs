//! What the service answers.

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
    /// Where the book explains it, at the service: `/docs/errors#<code>`.
    #[serde(rename = "type")]
    pub kind: String,
    /// Stable, to branch on.
    pub code: String,
    /// The status in words.
    pub title: String,
    /// The HTTP status.
    pub status: u16,
    /// A sentence to read.
    pub detail: String,
    /// Faults of the document; every 422 carries them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub diagnostics: Vec<Diagnostic>,
    /// What was measured, by name, with the unit in it: `fit_ms`, `budget_ms`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub figures: BTreeMap<String, f64>,
}

/// A list.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Items<T> {
    /// In the order of their names.
    pub items: Vec<T>,
    /// Where there are more: the name after which they begin, for `after`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub next: Option<String>,
}

/// Answer of `PUT /v1/models/{name}`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ModelAnswer {
    /// The name in the registry.
    pub name: String,
    /// Counts the documents put under this name, from 1.
    pub version: u64,
    /// Older versions that are not kept any more, because there would be too many.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub collected: Vec<u64>,
    /// What `model check` prints.
    #[serde(flatten)]
    pub report: ModelReport,
}

/// `GET /v1/models/{name}`: the document with its name in the registry, version and digest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ModelView {
    /// Counts the documents put under this name, from 1.
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
    /// Counts the documents put under this name, from 1.
    pub version: u64,
    /// `sha256:…` of the canonical document.
    pub digest: String,
    /// The document's own words.
    pub description: String,
    /// Names, in document order.
    pub parameters: Vec<String>,
}

/// `GET /v1/models/{name}/versions`
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct VersionList {
    /// Newest first.
    pub items: Vec<VersionItem>,
    /// How many older ones are not kept any more.
    pub collected: u64,
}

/// One version of a name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct VersionItem {
    /// Counts the documents put under the name, from 1.
    pub version: u64,
    /// `sha256:…` of the canonical document.
    pub digest: String,
    /// Whether the name means it.
    pub active: bool,
    /// Of its text.
    pub bytes: u64,
    /// When it was put, by the wall clock; absent where that was not kept.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub created_at: Option<String>,
}

/// What `model explain --json` prints: the figures of one subset beside the text asked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Explanation {
    /// The document's name.
    pub model: String,
    /// `sha256:…` of the canonical document.
    pub digest: String,
    /// What the text shows.
    pub show: String,
    /// The figures, `compile_ms` included.
    #[serde(flatten)]
    pub stage: StageReport,
    /// The text.
    pub text: String,
    /// Of `program`, `clif` and `asm`: what each line of the text computes, so that they can point to each other and to the
    /// document.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lines: Vec<LinePlace>,
    /// Of `table`: what a pixel costs as the derivatives are written down and as they are compiled, apart and jointly.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub loops: Vec<LoopCost>,
}

/// What a line of an explanation belongs to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct LinePlace {
    /// The program's value that it computes: 12 for `v12`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub value: Option<u32>,
    /// The bytes of the document, as it was sent, that asked for it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub span: Option<[u32; 2]>,
}

/// Answer of `POST /v1/models:check`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CheckAnswer {
    /// What `model check` prints.
    #[serde(flatten)]
    pub report: ModelReport,
    /// The document's formulas, as `explain` shows them.
    pub formulas: String,
}

/// What `model export --json` prints.
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

/// `GET /v1/sources/{name}`: its document with its state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SourceView {
    /// The name.
    pub name: String,
    /// As put, defaults filled in.
    #[serde(flatten)]
    pub document: SourceDocument,
    /// What it does.
    pub state: SourceState,
    /// Why it stands still.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub reason: Option<String>,
    /// When it was put, by the wall clock.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub declared_at: Option<String>,
    /// Frames delivered.
    pub frames: u64,
    /// Of a recording: frames that could not be read, and were left out.
    #[serde(skip_serializing_if = "is_zero", default)]
    pub unread: u64,
    /// Sessions that listen.
    pub sessions: usize,
    /// Of a recording: the place of the frame that was shown last, from 0. It goes back where the recording does.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub position: Option<u64>,
    /// Of a source whose frames are made or read: whether it stands still, and how fast it goes.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub playback: Option<PlaybackView>,
    /// Who turns its knobs, where somebody does.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub control: Option<ControlView>,
    /// Of a camera: how it is set, and what was lost.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub camera: Option<CameraStatus>,
}

/// What a source does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SourceState {
    /// No session listens: it waits.
    Idle,
    /// Frames come.
    Running,
    /// A camera streams, but there is no picture, or of a recording that loops no frame can be read; see `reason`.
    Stalled,
    /// A camera is gone; see `reason`. It is looked for again.
    Lost,
    /// There are no more.
    Ended,
    /// It cannot deliver; see `reason`.
    Failed,
}

/// What a session does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SessionState {
    /// No frame was fitted yet.
    Starting,
    /// Frames are fitted.
    Running,
    /// The source should have delivered, but has not.
    Stalled,
    /// The source failed, or its camera is gone and looked for; see `reason`.
    LostSource,
    /// The source has no more frames.
    Stopped,
    /// The session cannot go on; see `reason`.
    Failed,
}

/// `GET /v1/sessions/{name}`: its document with its state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SessionView {
    /// The name.
    pub name: String,
    /// As put, defaults filled in, `model` as last swapped.
    #[serde(flatten)]
    pub document: SessionDocument,
    /// What it does.
    pub state: SessionState,
    /// Why it does not run.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub reason: Option<String>,
    /// Keys of its document that change nothing, each with what would be right.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub warnings: Vec<Diagnostic>,
    /// The model asked for last.
    pub requested_model: String,
    /// The model that fits.
    pub active_model: String,
    /// Its digest.
    pub active_digest: String,
    /// Frames from this number on are fitted with it.
    pub active_since_frame: u64,
    /// Bits of the vectors that its kernels are made for: which pixels are summed together, so that a fit with the same adds up
    /// bit for bit.
    pub vector_width: usize,
    /// Frames fitted.
    pub frames: u64,
    /// Frames of the source that were not fitted.
    pub dropped: u64,
    /// Estimates a second, measured over the last ones.
    pub rate_hz: f64,
    /// Where it runs: the id of the data folder, or of the process where there is none.
    pub node: String,
    /// Grows with every start of a session on this node: with the number of a frame it names an estimate for good. Absent of one
    /// that does not run.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub epoch: Option<u64>,
    /// When it was put, by the wall clock; absent of the demo's.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub declared_at: Option<String>,
    /// When it began to run, by the wall clock.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub started_at: Option<String>,
    /// How often the service was started since it was put.
    #[serde(skip_serializing_if = "is_zero", default)]
    pub restarts: u64,
    /// What the fits of a frame may cost of a processor, ms, where frames do not wait for them: the source's interval, at most
    /// 250. A fit that takes longer ends with its best so far.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub frame_budget_ms: Option<f64>,
    /// The same of a frame that is searched all over, ms. It grows as long as searches take longer.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub search_budget_ms: Option<f64>,
    /// Frames that took longer.
    #[serde(default)]
    pub over_budget: u64,
    /// Frames that were searched all over, where frames do not wait.
    #[serde(default)]
    pub searches: u64,
    /// Frames whose search was put off, since others were at theirs.
    #[serde(default)]
    pub searches_postponed: u64,
    /// What a frame that is not searched costs of a processor, ms, all in all: a mean of the last ones.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub cost_ms: Option<f64>,
    /// Of a session that controls the exposure of its source: whether it may.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub exposure_control: Option<ExposureControl>,
    /// Another model on the same frames, beside it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub shadow: Option<ShadowView>,
    /// What its recording does, or did, if there was one since it was started and nobody has ended it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub recording: Option<RecordingView>,
    /// Of a session on a camera: how that is set, and what was lost.
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
    /// The model asked for.
    pub requested_model: String,
    /// The model that fits now.
    pub active_model: String,
    /// Its digest.
    pub active_digest: String,
    /// Frames from this number on are fitted with it, earlier ones were not.
    pub active_since_frame: u64,
    /// Parameters that keep their values.
    pub carried: Vec<String>,
    /// Parameters that start anew.
    pub reset: Vec<String>,
    /// Time spent on compilation, ms; near 0 for a model whose kernels exist.
    pub compile_ms: f64,
}

/// `GET /v1/time`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Time {
    /// The clock of every `*_ns` field, CLOCK_MONOTONIC.
    pub monotonic_ns: u64,
    /// The wall clock at the same moment; a label, nothing is computed with it.
    pub unix_ns: u64,
}

/// `GET /livez` and `GET /readyz`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Health {
    /// `ok`; anything else is a problem.
    pub status: String,
}
