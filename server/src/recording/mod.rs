//! Recordings of sessions: what a session sees and says, in MCAP files that say all that is needed to fit their frames again.
//!
//! What comes in: frames from the source's thread, what became of them from the fit thread, both through a [`Tap`], which makes
//! neither wait: what finds no room is counted. What goes out: files in one folder of the operator's. A client names no path.
//!
//! ```text
//! source ─► Tap ─► writer thread ─► NAME-0001.part.mcap ─► NAME-0001.mcap
//! fit    ─►  │        a chunk every half second               its index
//! ```

mod csv;
mod folder;
mod log;
mod progress;
mod space;
mod tap;
mod writer;

pub use folder::{FileName, FolderFault, RecordingFolder, WantedFile};
pub use progress::SessionRecording;
pub use space::{RecordingQuota, RecordingSpace};
pub use tap::{FitNote, ModelNote, Note, Tap};
