//! Why the bytes of a camera are not a picture.

use isophote_frame::FrameError;

/// Why the bytes of a camera are not a picture.
#[derive(Debug, thiserror::Error)]
pub enum PixelsError {
    /// No pixels, or more than the limits allow; nothing was read.
    #[error("{}×{} px: {reason}", size[0], size[1])]
    Size {
        /// Width and height that were asked for.
        size: [usize; 2],
        /// What would be right.
        reason: String,
    },
    /// Rows that would overlap.
    #[error("a row of {name} takes {least} bytes; the camera says that rows are {given} bytes apart")]
    Stride {
        /// The format.
        name: String,
        /// Bytes of a row.
        least: usize,
        /// Bytes from a row to the next.
        given: usize,
    },
    /// A picture that was cut short.
    #[error("a whole picture has {expected} bytes; this one has {got}")]
    Short {
        /// Bytes of a whole picture.
        expected: usize,
        /// Bytes that came.
        got: usize,
    },
    /// One colour of a format that is taken as luma.
    #[error("{name} pictures are taken as brightness; ask for all colours, or for a format with red, green and blue")]
    NoColour {
        /// The format.
        name: String,
    },
    /// A JPEG of another size than the camera was set to.
    #[error("the JPEG has {}×{} px; the camera was set to {}×{} px", got[0], got[1], expected[0], expected[1])]
    OtherSize {
        /// Width and height that were asked for.
        expected: [usize; 2],
        /// Width and height in the JPEG.
        got: [usize; 2],
    },
    /// A JPEG that cannot be decoded to its end.
    #[error("the JPEG is damaged: {0}")]
    Damaged(String),
    /// Planes that are not all inside their buffer: a bug.
    #[error(transparent)]
    Frame(#[from] FrameError),
}
