//! `FrameSource`: the interface of all frame sources.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use isophote_frame::Frame;

use crate::exposure::Exposure;
use crate::files::remedy;
use crate::limits::LIMITS;
use crate::regular::ReadableFolder;
use crate::scene::SceneKnob;

/// One frame with its metadata.
#[derive(Clone, Debug)]
pub struct Captured {
    /// The pixels; its `sequence` counts from 0.
    pub frame: Frame,
    /// The file it came from (name without folder), if any.
    pub file: Option<String>,
    /// The parameters it was rendered from, if known: synthetic frames and recordings of them.
    pub truth: Option<BTreeMap<String, f64>>,
}

/// A sequence of frames, paced by its owner: a source never waits (except a camera, for its driver) and never drops frames.
pub trait FrameSource: Send {
    /// The next frame; `None` at the end. After an error, the next call continues with the frame after the failed one.
    fn next(&mut self) -> Result<Option<Captured>, SourceError>;

    /// One-line description for display.
    fn description(&self) -> String;

    /// Size of the first frame, inner coordinate first, if known beforehand.
    fn size(&self) -> Option<Vec<usize>>;

    /// Exposure control, if supported.
    fn exposure(&self) -> Option<Exposure> {
        None
    }

    /// Scene control, if supported.
    fn scene(&self) -> Option<SceneKnob> {
        None
    }

    /// Random access to its frames, if supported.
    fn reel(&mut self) -> Option<&mut dyn Reel> {
        None
    }

    /// Returns the last frame to the source, which then delivers it again, as rendered at that time; false if it is lost.
    fn take_back(&mut self) -> bool {
        false
    }
}

/// Random access to the frames of a recording, by index from 0.
pub trait Reel {
    /// Number of frames; never 0.
    fn count(&self) -> usize;

    /// Index of the next frame; `count` after the last.
    fn place(&self) -> usize;

    /// Sets the next frame. Sequence numbers and time continue.
    fn seek(&mut self, place: usize);
}

/// Why a source cannot deliver. Every message names the file and a remedy.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// No such file or folder.
    #[error("{}: no such file or folder", path.display())]
    Missing {
        /// Requested path.
        path: PathBuf,
    },
    /// An I/O error.
    #[error("{}: cannot be read: {reason}", path.display())]
    Unreadable {
        /// Requested path.
        path: PathBuf,
        /// Error of the operating system.
        reason: std::io::Error,
    },
    /// A folder without frames.
    #[error("{}: holds no frames; a recording is a folder of PNG, JPEG, TIFF or FITS files, one such file, a Y4M video, an MCAP file, or one CSV file (folders in it count for documents of three and four coordinates)", path.display())]
    Empty {
        /// The folder.
        path: PathBuf,
    },
    /// An unsupported file format.
    #[error("{}: not a PNG, JPEG, TIFF, FITS, Y4M, MCAP or CSV file; {}", path.display(), remedy(path))]
    UnknownKind {
        /// The file.
        path: PathBuf,
    },
    /// A damaged file.
    #[error("{}: damaged: {reason}; write it again or take it out of the recording", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Reason from the decoder.
        reason: String,
    },
    /// A valid file of an unsupported kind.
    #[error("{}: {reason}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// Its kind, and supported ones.
        reason: String,
    },
    /// A picture of a stack differs from the others.
    #[error("{}: {reason}; all pictures of a stack must be alike", path.display())]
    Odd {
        /// The one that differs.
        path: PathBuf,
        /// The difference, and from which picture.
        reason: String,
    },
    /// The number of dimensions differs from the document's.
    #[error("{}: {reason}", path.display())]
    Dimensions {
        /// Requested path.
        path: PathBuf,
        /// Found and expected content.
        reason: String,
    },
    /// Exceeds the limits.
    #[error("{}: {reason}", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// The limit and its value.
        reason: String,
    },
    /// A faulty line of a CSV or truth file.
    #[error("{}:{line}: {reason}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// From 1.
        line: u64,
        /// The fault and its remedy.
        reason: String,
    },
    /// A frame's planes do not match the model's channels.
    #[error("{}: {reason}", path.display())]
    Channels {
        /// The file.
        path: PathBuf,
        /// Found and expected channels.
        reason: String,
    },
    /// A synthetic frame cannot be rendered.
    #[error("frame {frame}: {reason}")]
    Synthetic {
        /// From 0.
        frame: u64,
        /// Cause.
        reason: String,
    },
}

impl SourceError {
    /// Makes the error's path relative to the readable folder, if there is one.
    pub(crate) fn within(mut self, reach: &ReadableFolder) -> SourceError {
        match &mut self {
            SourceError::Missing { path }
            | SourceError::Unreadable { path, .. }
            | SourceError::Empty { path }
            | SourceError::UnknownKind { path }
            | SourceError::Damaged { path, .. }
            | SourceError::Unsupported { path, .. }
            | SourceError::Odd { path, .. }
            | SourceError::Dimensions { path, .. }
            | SourceError::TooLarge { path, .. }
            | SourceError::Line { path, .. }
            | SourceError::Channels { path, .. } => {
                let relative = reach.relative(path);
                *path = if relative.as_os_str().is_empty() { PathBuf::from(".") } else { relative.to_path_buf() };
            }
            SourceError::Synthetic { .. } => {}
        }
        self
    }

    pub(crate) fn too_many(path: &Path) -> SourceError {
        let reason = format!("more than {} pictures; split the recording", LIMITS.files);
        SourceError::TooLarge { path: path.into(), reason }
    }
}
