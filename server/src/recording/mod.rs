//! Recordings of sessions: frames and results in MCAP files that suffice to repeat the fits.
//!
//! The source's thread sends frames and the fit thread their results through a [`Tap`], which never blocks: what does not fit
//! is dropped and counted. Files are in one folder of the operator's; clients give no path.
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
