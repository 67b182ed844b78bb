//! Decodes PNG and JPEG bytes into a [`Frame`] of raw planes.
//!
//! Supports gray, gray with alpha, RGB, RGBA and palette images, 8 and 16 bit. Colour becomes the planes r, g, b over one
//! buffer; alpha is dropped. Pixel values are as stored, never rescaled to 0…1 (only 1-, 2- and 4-bit gray PNG is stretched
//! to 8 bit, as the PNG standard requires). The signature decides the format, not the file name.

use isophote_frame::{Buffer, Frame, Plane};

use crate::files::{image, misnamed};
pub use crate::picture::DecodeError;
use crate::picture::StoredPicture;

/// Whether `bytes` begin with the PNG signature.
pub fn is_png(bytes: &[u8]) -> bool {
    image::PNG.matches_signature(bytes)
}

/// Whether `bytes` begin with the JPEG signature.
pub fn is_jpeg(bytes: &[u8]) -> bool {
    image::JPEG.matches_signature(bytes)
}

/// Decodes one PNG or JPEG image. Its size is checked before memory is allocated.
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

/// Width and height from the header of a PNG or JPEG image; decodes no pixel.
pub fn size(bytes: &[u8]) -> Result<[usize; 2], DecodeError> {
    image::size(bytes)
}
