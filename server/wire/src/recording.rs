//! Recordings: how one is asked for, what is said of it, and what stands in its messages of ours.

use std::collections::BTreeMap;

use isophote_tracker::FrameReadiness;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::document::SessionDocument;

/// `PUT /v1/sessions/{name}/recording`: everything has a default.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RecordDocument {
    /// What its files are called, before their numbers: `[a-z0-9][a-z0-9-]{0,63}`; the session's name, its epoch and the time when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// What is kept of the frames' pixels.
    pub frames: RecordedFrames,
    /// Bytes of all its files, in units of 10⁶: there it ends, or, where files are rotated, the oldest one is deleted.
    pub disk_budget_mb: u64,
    /// A file ends after so many bytes, in units of 10⁶, and another begins.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotate_mb: Option<u64>,
    /// A file ends after so many seconds, and another begins.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotate_s: Option<u64>,
    /// Estimates stand in a CSV file beside each as well.
    pub csv: bool,
}

impl Default for RecordDocument {
    fn default() -> RecordDocument {
        let (name, frames, disk_budget_mb) = (None, RecordedFrames::Raw, 4000);
        RecordDocument { name, frames, disk_budget_mb, rotate_mb: None, rotate_s: None, csv: false }
    }
}

/// What a recording keeps of pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum RecordedFrames {
    /// All of them, as they are: fits can be repeated bit for bit.
    #[default]
    Raw,
    /// Pictures of 8 bits, packed as JPEG, which changes them.
    Jpeg,
    /// None.
    None,
}

/// What a recording does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum RecordingState {
    /// It goes on.
    Recording,
    /// It has ended by itself; `reason` says why.
    Ended,
    /// It could not go on; `reason` says why. What it had written is there.
    Failed,
}

/// The recording of a session.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct RecordingView {
    /// The session.
    pub session: String,
    /// As put, defaults filled in.
    #[serde(flatten)]
    pub document: RecordDocument,
    /// What it does.
    pub state: RecordingState,
    /// Why it does no more.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub reason: Option<String>,
    /// Its files, the oldest first; the last one is being written while it goes on.
    pub files: Vec<String>,
    /// Frames whose pixels were written.
    pub recorded_frames: u64,
    /// Frames that were fitted while it went on.
    pub fits: u64,
    /// Bytes of all its files.
    pub bytes: u64,
    /// Frames, and what was said of frames, that the disk was too slow for.
    pub dropped: u64,
    /// When it began, by the wall clock.
    pub started_at: String,
}

/// A file in the folder of recordings.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct RecordedFile {
    /// Its name in that folder: `GET /v1/recordings/{file}` answers its bytes.
    pub file: String,
    /// How many those are.
    pub bytes: u64,
    /// The CSV file of estimates beside it, if there is one: `GET /v1/recordings/{file}` answers it as well.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub csv: Option<RecordedTable>,
}

/// The CSV file beside a recording.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
pub struct RecordedTable {
    /// Its name in the folder of recordings.
    pub file: String,
    /// How many bytes it has.
    pub bytes: u64,
}

/// `isophote.Session`: whose recording it is. One stands at the begin of each file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LoggedSession {
    /// Of these messages.
    pub version: u32,
    /// The session.
    pub session: String,
    /// Where it ran.
    pub node: String,
    /// Which start of it.
    pub epoch: u64,
    /// Its document, as put.
    pub document: SessionDocument,
    /// What is kept of pixels.
    pub frames: RecordedFrames,
    /// Who fitted: another build may round otherwise.
    pub build: LoggedBuild,
}

/// Of messages of ours.
pub const LOG_VERSION: u32 = 1;

/// A build of the program, and the machine that it ran on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LoggedBuild {
    /// `0.1.0`
    pub version: String,
    /// Of the program's file; absent where that cannot be read.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub checksum: Option<String>,
    /// `x86_64`
    pub processor: String,
}

/// `isophote.Swap`: what fits from a frame on, at the begin of each file as well.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LoggedSwap {
    /// The first frame that it fits.
    pub frame: u64,
    /// Its name.
    pub name: String,
    /// `name@sha256:…`
    pub model: String,
    /// How the document was sent: `application/toml` or `application/json`.
    pub media: String,
    /// The document, as it was sent: the order of its parameters is that of what the tracker remembers.
    pub text: String,
    /// Bits of the vectors of its kernels.
    pub vector_width: usize,
    /// Values of constants that take the place of the document's; a shadow may have had others than the session.
    #[serde(skip_serializing_if = "BTreeMap::is_empty", default)]
    pub constants: BTreeMap<String, f64>,
    /// It has followed the target before, beside the other: it goes on with what the snapshot behind this says.
    #[serde(skip_serializing_if = "is_not", default)]
    pub is_warm: bool,
}

/// `isophote.Snapshot`: all that the tracker remembers before a frame.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LoggedSnapshot {
    /// Fits of the recording so far.
    pub fits: u64,
    /// What it remembers.
    pub snapshot: serde_json::Value,
}

/// `isophote.Fit`: how a frame was fitted, as far as its pixels do not tell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LoggedFit {
    /// The frame.
    pub frame: u64,
    /// Counts the fits of the recording; a number that is missing was lost.
    pub fit: u64,
    /// Whether the frame's pixels were recorded.
    pub has_pixels: bool,
    /// The source was sent somewhere else before it: what was known of the target's place was forgotten.
    #[serde(skip_serializing_if = "is_not", default)]
    pub has_jumped: bool,
    /// When it was captured, CLOCK_MONOTONIC.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub capture_ns: Option<u64>,
    /// When it was taken, s on its source's own clock.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub time_s: Option<f64>,
    /// What a pixel can hold at most, where the source says so.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub largest: Option<f64>,
    /// What its fits had beside the model's kernels.
    pub ready: FrameReadiness,
    /// What ended it before it was done, and when: asked before so many passes.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub stopped: Option<LoggedStop>,
    /// So many searches of the whole frame were put off.
    #[serde(skip_serializing_if = "is_zero", default)]
    pub postponed: u32,
}

/// The end of a frame that was left before all was done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LoggedStop {
    /// The number of the pass, from 0, before which it ended.
    pub pass: u64,
    /// Why.
    pub why: StopReason,
}

/// Why a frame was left.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum StopReason {
    /// It took too much.
    Budget,
    /// A swap waited.
    Cancelled,
}

#[allow(clippy::trivially_copy_pass_by_ref)] // as serde calls it
fn is_not(what: &bool) -> bool {
    !what
}

#[allow(clippy::trivially_copy_pass_by_ref)] // as above
fn is_zero(number: &u32) -> bool {
    *number == 0
}
