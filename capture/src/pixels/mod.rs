//! Pictures as cameras deliver them: bytes of a driver's buffer in, a [`Frame`] of raw planes out.
//!
//! What comes in: bytes, a four-character code ([`Encoding`]), the picture's size and the bytes of a row. What goes out:
//! planes of what the sensor counted, never rescaled: grey and luma as they lie in the buffer, a colour mosaic either
//! filled in or as one of its colours ([`Colour`]), and the luma of a JPEG before any conversion.
//! It must never know a device, a driver or a clock: whoever streams hands over bytes and adds number and time.

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
