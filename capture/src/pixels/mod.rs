//! Pictures as cameras deliver them: bytes of a driver's buffer in, a [`Frame`] of raw planes out.
//!
//! What comes in: bytes, a four-character code ([`Encoding`]), the picture's size and the bytes of a row. What goes out:
//! planes of what the sensor counted, never rescaled: grey and luma as they lie in the buffer, a colour mosaic either
//! filled in or as one of its colours ([`Colour`]), and the luma of a JPEG before any conversion.
//! It must never know a device, a driver or a clock: whoever streams hands over bytes and adds number and time.

mod convert;
mod encoding;
pub(crate) mod jpeg;
mod layout;
mod mosaic;
mod segments;

pub use encoding::Encoding;

use isophote_frame::FrameError;

/// What becomes of a colour mosaic or colour picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Colour {
    /// The planes r, g, b of a colour picture and of a mosaic, whose gaps are filled in; luma where the format has it.
    #[default]
    All,
    /// Red alone.
    Red,
    /// Green alone; of a mosaic the greens in red's rows, half of them.
    Green,
    /// Blue alone.
    Blue,
}

impl Colour {
    /// Its place among r, g, b; `None` for all of them.
    fn channel(self) -> Option<usize> {
        match self {
            Colour::All => None,
            Colour::Red => Some(0),
            Colour::Green => Some(1),
            Colour::Blue => Some(2),
        }
    }
}

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
