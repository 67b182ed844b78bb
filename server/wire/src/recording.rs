//! Recordings: the request, the state, and the messages of Isophote's own schemas.

use std::collections::BTreeMap;

use isophote_tracker::FrameReadiness;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::document::SessionDocument;

/// Body of `PUT /v1/sessions/{name}/recording`. All fields have defaults.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RecordDocument {
    /// Name of the files, before their numbers: `[a-z0-9][a-z0-9-]{0,63}`; when absent, the session's name, its epoch and the time.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Pixels to record.
    pub frames: RecordedFrames,
    /// Maximum size of all files, in units of 10⁶ bytes. At this size the recording ends or, with rotation, deletes its oldest file.
    pub disk_budget_mb: u64,
    /// Size after which a new file begins, in units of 10⁶ bytes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotate_mb: Option<u64>,
    /// Duration after which a new file begins, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotate_s: Option<u64>,
    /// Whether to write estimates to a CSV file beside each file as well.
    pub csv: bool,
}

impl Default for RecordDocument {
    fn default() -> RecordDocument {
        let (name, frames, disk_budget_mb) = (None, RecordedFrames::Raw, 4000);
        RecordDocument { name, frames, disk_budget_mb, rotate_mb: None, rotate_s: None, csv: false }
    }
}

/// Pixels in a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum RecordedFrames {
    /// All pixels, unchanged: fits can be repeated bit for bit.
    #[default]
    Raw,
    /// 8-bit JPEG, lossy.
    Jpeg,
    /// No pixels.
    None,
}

/// State of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum RecordingState {
    /// In progress.
    Recording,
    /// Ended by itself; see `reason`.
    Ended,
    /// Failed; see `reason`. Data written before is kept.
    Failed,
}

/// The recording of a session.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct RecordingView {
    /// Name of the session.
    pub session: String,
    /// The document as put, with defaults.
    #[serde(flatten)]
    pub document: RecordDocument,
    /// State.
    pub state: RecordingState,
    /// Why it ended or failed.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub reason: Option<String>,
    /// Names of the files, oldest first; while in progress, the last one is being written.
    pub files: Vec<String>,
    /// Number of frames whose pixels were written.
    pub recorded_frames: u64,
    /// Number of frames fitted during the recording.
    pub fits: u64,
    /// Total size of the files, bytes.
    pub bytes: u64,
    /// Number of frames, and of messages about frames, lost because the disk was too slow.
    pub dropped: u64,
    /// Start, by the wall clock.
    pub started_at: String,
}

/// A file in the folder of recordings.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct RecordedFile {
    /// Name in that folder; `GET /v1/recordings/{file}` downloads it.
    pub file: String,
    /// Size, bytes.
    pub bytes: u64,
    /// CSV file of estimates beside it, if any; `GET /v1/recordings/{file}` downloads it too.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub csv: Option<RecordedTable>,
}

/// The CSV file beside a recording.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
pub struct RecordedTable {
    /// Name in the folder of recordings.
    pub file: String,
    /// Size, bytes.
    pub bytes: u64,
}

/// `isophote.Session`: the session recorded, at the beginning of each file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LoggedSession {
    /// Version of these messages.
    pub version: u32,
    /// The session.
    pub session: String,
    /// Node on which it ran.
    pub node: String,
    /// Epoch of the session.
    pub epoch: u64,
    /// Its document, as put.
    pub document: SessionDocument,
    /// Which pixels are recorded.
    pub frames: RecordedFrames,
    /// The build that fitted: another one may round differently.
    pub build: LoggedBuild,
}

/// Version of Isophote's own messages.
pub const LOG_VERSION: u32 = 1;

/// A build of the program, and the machine that it ran on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LoggedBuild {
    /// `0.1.0`
    pub version: String,
    /// Checksum of the executable; absent if unreadable.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub checksum: Option<String>,
    /// `x86_64`
    pub processor: String,
}

/// `isophote.Swap`: the model from a frame on; also at the beginning of each file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LoggedSwap {
    /// The first frame that it fits.
    pub frame: u64,
    /// Name of the model.
    pub name: String,
    /// `name@sha256:…`
    pub model: String,
    /// Media type of the document as sent: `application/toml` or `application/json`.
    pub media: String,
    /// The document as sent: snapshots rely on the order of its parameters.
    pub text: String,
    /// Vector width of its kernels, bits.
    pub vector_width: usize,
    /// Values that override the document's constants; a shadow may have had others than the session.
    #[serde(skip_serializing_if = "BTreeMap::is_empty", default)]
    pub constants: BTreeMap<String, f64>,
    /// Whether it tracked the target before, as a shadow: it resumes from the snapshot that follows.
    #[serde(skip_serializing_if = "is_not", default)]
    pub is_warm: bool,
}

/// `isophote.Snapshot`: the tracker's complete state before a frame.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LoggedSnapshot {
    /// Fits of the recording so far.
    pub fits: u64,
    /// The state.
    pub snapshot: serde_json::Value,
}

/// `isophote.Fit`: the circumstances of a fit beyond the frame's pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LoggedFit {
    /// The frame.
    pub frame: u64,
    /// Number of the fit in the recording; a gap means that fits were lost.
    pub fit: u64,
    /// Whether the frame's pixels were recorded.
    pub has_pixels: bool,
    /// Whether the source jumped before this frame, so that the tracker forgot the target's position.
    #[serde(skip_serializing_if = "is_not", default)]
    pub has_jumped: bool,
    /// Capture time, CLOCK_MONOTONIC.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub capture_ns: Option<u64>,
    /// Time on the source's own clock, s.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub time_s: Option<f64>,
    /// Largest value that a pixel can hold, if known.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub largest: Option<f64>,
    /// Kernels that were ready beside the model's own.
    pub ready: FrameReadiness,
    /// Early stop, if any: why, and before which pass.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub stopped: Option<LoggedStop>,
    /// Number of postponed searches of the whole frame.
    #[serde(skip_serializing_if = "is_zero", default)]
    pub postponed: u32,
}

/// An early stop of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LoggedStop {
    /// The pass, from 0, before which it stopped.
    pub pass: u64,
    /// Reason.
    pub why: StopReason,
}

/// Why a frame was stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum StopReason {
    /// It exceeded its budget.
    Budget,
    /// A swap was waiting.
    Cancelled,
}

#[allow(clippy::trivially_copy_pass_by_ref)] // signature required by serde
fn is_not(what: &bool) -> bool {
    !what
}

#[allow(clippy::trivially_copy_pass_by_ref)] // as above
fn is_zero(number: &u32) -> bool {
    *number == 0
}
