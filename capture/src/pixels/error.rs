//! Errors of converting camera bytes to pictures.

use isophote_frame::FrameError;

/// Why camera bytes cannot be converted to a picture.
#[derive(Debug, thiserror::Error)]
pub enum PixelsError {
    /// A side that is too small, or a size beyond the limits; nothing was read.
    #[error("{}×{} px: {reason}", size[0], size[1])]
    Size {
        /// Requested width and height.
        size: [usize; 2],
        /// Allowed size.
        reason: String,
    },
    /// Rows would overlap.
    #[error("a row of {name} takes {least} bytes; the camera says that rows are {given} bytes apart")]
    Stride {
        /// Format code.
        name: String,
        /// Bytes of a row.
        least: usize,
        /// Row stride.
        given: usize,
    },
    /// A truncated picture.
    #[error("a whole picture has {expected} bytes; this one has {got}")]
    Short {
        /// Bytes of a complete picture.
        expected: usize,
        /// Bytes received.
        got: usize,
    },
    /// A single colour of a luma format.
    #[error("{name} pictures are taken as brightness; ask for all colours, or for a format with red, green and blue")]
    NoColour {
        /// Format code.
        name: String,
    },
    /// A JPEG of another size than the camera was set to.
    #[error("the JPEG has {}×{} px; the camera was set to {}×{} px", got[0], got[1], expected[0], expected[1])]
    OtherSize {
        /// Requested width and height.
        expected: [usize; 2],
        /// Width and height in the JPEG.
        got: [usize; 2],
    },
    /// A JPEG that cannot be decoded completely.
    #[error("the JPEG is damaged: {0}")]
    Damaged(String),
    /// Planes that exceed their buffer: a bug.
    #[error(transparent)]
    Frame(#[from] FrameError),
}
