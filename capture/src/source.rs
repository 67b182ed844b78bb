//! The door: what every source of frames offers.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use isophote_frame::Frame;

use crate::exposure::Exposure;
use crate::files::remedy;
use crate::limits::LIMITS;
use crate::regular::ReadableFolder;
use crate::scene::SceneKnob;

/// One frame and what is known about it besides its pixels.
#[derive(Clone, Debug)]
pub struct Captured {
    /// The pixels; its `sequence` counts from 0.
    pub frame: Frame,
    /// The file it came from (name without folder); `None` where there is none.
    pub file: Option<String>,
    /// The parameters it was made from, where they are known: synthetic frames and recordings of them.
    pub truth: Option<BTreeMap<String, f64>>,
}

/// Frames one after the other. The owner decides when: a source never waits (a camera, which waits for its driver,
/// excepted) and never drops.
pub trait FrameSource: Send {
    /// The next frame; `None` when there are no more. After an error the source may be asked again: it goes on with
    /// the frame after the one that failed.
    fn next(&mut self) -> Result<Option<Captured>, SourceError>;

    /// One line for people: what it is and where.
    fn description(&self) -> String;

    /// Size of the first frame, inner coordinate first, where it is known beforehand.
    fn size(&self) -> Option<Vec<usize>>;

    /// The knob of a source whose exposure can be set.
    fn exposure(&self) -> Option<Exposure> {
        None
    }

    /// The knob of a source whose scene can be changed.
    fn scene(&self) -> Option<SceneKnob> {
        None
    }

    /// Where its frames have places.
    fn reel(&mut self) -> Option<&mut dyn Reel> {
        None
    }

    /// Nobody has seen the last frame: it is the next once more, as it is then. False where it is lost.
    fn take_back(&mut self) -> bool {
        false
    }
}

/// Frames with places, counted from 0, any of which may be the next: a recording.
pub trait Reel {
    /// How many frames there are; never 0.
    fn count(&self) -> usize;

    /// The place of the next frame; behind the last one `count`.
    fn place(&self) -> usize;

    /// The next frame is the one at that place. Frames go on being counted, and so does the time.
    fn seek(&mut self, place: usize);
}

/// Why a source cannot deliver. Every message names the file and says what would help.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// Nothing is there.
    #[error("{}: no such file or folder", path.display())]
    Missing {
        /// What was asked for.
        path: PathBuf,
    },
    /// The operating system refused.
    #[error("{}: cannot be read: {reason}", path.display())]
    Unreadable {
        /// What was asked for.
        path: PathBuf,
        /// The system's words.
        reason: std::io::Error,
    },
    /// A folder without frames.
    #[error("{}: holds no frames; a recording is a folder of PNG, JPEG, TIFF or FITS files, one such file, a Y4M video, an MCAP file, or one CSV file (folders in it count for documents of three and four coordinates)", path.display())]
    Empty {
        /// The folder.
        path: PathBuf,
    },
    /// A kind of file that this build does not read.
    #[error("{}: not a PNG, JPEG, TIFF, FITS, Y4M, MCAP or CSV file; {}", path.display(), remedy(path))]
    UnknownKind {
        /// The file.
        path: PathBuf,
    },
    /// A file that is not what it claims to be.
    #[error("{}: damaged: {reason}; write it again or take it out of the recording", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What the decoder says.
        reason: String,
    },
    /// A sound file of a kind that this build does not read.
    #[error("{}: {reason}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What it is and what would be read.
        reason: String,
    },
    /// One picture of a stack is not like the others.
    #[error("{}: {reason}; all pictures of a stack must be alike", path.display())]
    Odd {
        /// The one that differs.
        path: PathBuf,
        /// In what, and from which.
        reason: String,
    },
    /// Frames of another number of dimensions than the document's.
    #[error("{}: {reason}", path.display())]
    Dimensions {
        /// What was asked for.
        path: PathBuf,
        /// What there is, and what would be right.
        reason: String,
    },
    /// More than the limits allow.
    #[error("{}: {reason}", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Which limit, and its value.
        reason: String,
    },
    /// A CSV or truth file with a fault in a line.
    #[error("{}:{line}: {reason}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// From 1.
        line: u64,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// The planes of a frame do not fit the channels of the model.
    #[error("{}: {reason}", path.display())]
    Channels {
        /// The file.
        path: PathBuf,
        /// What there is and what was asked for.
        reason: String,
    },
    /// A synthetic frame cannot be made.
    #[error("frame {frame}: {reason}")]
    Synthetic {
        /// From 0.
        frame: u64,
        /// What went wrong.
        reason: String,
    },
}

impl SourceError {
    /// The same with its file said as it is named from where files are read, where that is one folder.
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
                let said = reach.relative(path);
                *path = if said.as_os_str().is_empty() { PathBuf::from(".") } else { said.to_path_buf() };
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
