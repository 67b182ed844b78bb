//! Bytes of a PNG or JPEG image in, a [`Frame`] of raw planes out.
//!
//! Gray, gray with alpha, RGB, RGBA and palette images, 8 and 16 bit. Colour becomes the planes r, g, b over one buffer;
//! alpha is left out. Pixel values are as stored, never rescaled to 0…1 (only 1-, 2- and 4-bit gray PNG is stretched to
//! 8 bit, as the PNG standard asks for). Which kind it is, the bytes say, not the name.

use isophote_frame::{Buffer, Frame, Plane};

use crate::files::{image, misnamed};
pub use crate::picture::DecodeError;
use crate::picture::StoredPicture;

/// Whether bytes begin as a PNG file does.
pub fn is_png(bytes: &[u8]) -> bool {
    image::PNG.begins(bytes)
}

/// Whether bytes begin as a JPEG file does.
pub fn is_jpeg(bytes: &[u8]) -> bool {
    image::JPEG.begins(bytes)
}

/// Decodes one PNG or JPEG image. Its size is checked before memory is taken.
///
/// ```
/// let png = isophote_capture::encode_png(2, 1, isophote_jit::PixelFormat::U16, &[1, 2, 3, 4])?;
/// let frame = isophote_capture::decode(&png)?;
/// assert_eq!(frame.size(), [2, 1]);
/// assert_eq!(frame.plane_view(0).pixel(1, 0), f64::from(0x0403));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn decode(bytes: &[u8]) -> Result<Frame, DecodeError> {
    let StoredPicture { size, format, stored, used, bytes } =
        image::picture(bytes).map_err(|error| misnamed(error, bytes))?;
    let buffer = Buffer::Owned(bytes.into());
    let planes = (0..used).map(|channel| Plane::interleaved(format, &buffer, size[0], stored, channel)).collect();
    Frame::new(&size, planes).map_err(|error| DecodeError::Damaged(error.to_string()))
}

/// Width and height that the header of a PNG or JPEG image names; no pixel is decoded.
pub fn size(bytes: &[u8]) -> Result<[usize; 2], DecodeError> {
    image::size(bytes)
}
