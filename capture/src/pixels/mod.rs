//! Converts the bytes of a camera buffer ([`Encoding`], size, stride) to a [`Frame`](isophote_frame::Frame) of raw planes.
//!
//! Planes hold the sensor's counts, never rescaled: grey and luma as stored, a colour mosaic interpolated or as a single
//! colour ([`Colour`]), and the luma of a JPEG before any conversion. The caller adds number and time.

mod colour;
mod convert;
mod encoding;
mod error;
pub(crate) mod jpeg;
mod layout;
mod mosaic;
mod segments;

pub use colour::Colour;
pub use encoding::Encoding;
pub use error::PixelsError;
