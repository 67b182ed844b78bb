//! Bytes of a PNG or JPEG image in, a [`Frame`] of raw planes out.
//!
//! Gray, gray with alpha, RGB, RGBA and palette images, 8 and 16 bit. Colour becomes the planes r, g, b over one buffer;
//! alpha is left out. Pixel values are as stored, never rescaled to 0…1 (only 1-, 2- and 4-bit gray PNG is stretched to
//! 8 bit, as the PNG standard asks for). Which kind it is, the bytes say, not the name.

use std::io::Cursor;
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader};
use isophote_frame::{Buffer, Frame, Plane};
use isophote_jit::PixelFormat;

use crate::limits::LIMITS;
use crate::pixels::jpeg;
use crate::source::SourceError;

/// Why bytes are not a frame.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// Neither PNG nor JPEG.
    #[error("not a PNG or JPEG image")]
    UnknownKind,
    /// More pixels than the limits allow; nothing was decoded.
    #[error("{0}")]
    TooLarge(String),
    /// A sound file of a kind that is not read.
    #[error("{0}")]
    Unsupported(String),
    /// A file that cannot be decoded to its end.
    #[error("{0}")]
    Damaged(String),
}

impl DecodeError {
    /// The same of a file.
    pub(crate) fn about(self, path: &Path) -> SourceError {
        let path = path.to_path_buf();
        match self {
            DecodeError::UnknownKind => SourceError::UnknownKind { path },
            DecodeError::TooLarge(reason) => SourceError::TooLarge { path, reason },
            DecodeError::Damaged(reason) => SourceError::Damaged { path, reason },
            DecodeError::Unsupported(reason) => SourceError::Unsupported { path, reason },
        }
    }
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
    let Picture { size, format, stored, used, bytes } = picture(bytes)?;
    let buffer = Buffer::Owned(bytes.into());
    let planes = (0..used).map(|channel| Plane::interleaved(format, &buffer, size[0], stored, channel)).collect();
    Frame::new(&size, planes).map_err(|error| DecodeError::Damaged(error.to_string()))
}

/// Pixels side by side, row by row.
pub(crate) struct Picture {
    /// Width and height.
    pub size: [usize; 2],
    pub format: PixelFormat,
    /// Channels of a pixel as stored, …
    pub stored: usize,
    /// … and the first of them that are used: alpha is not.
    pub used: usize,
    pub bytes: Vec<u8>,
}

impl Picture {
    /// What pictures of one stack have in common.
    pub fn kind(&self) -> ([usize; 2], PixelFormat, usize, usize) {
        (self.size, self.format, self.stored, self.used)
    }

    /// For people.
    pub fn what(&self) -> String {
        let [width, height] = self.size;
        let colour = if self.used == 1 { "gray" } else { "colour" };
        let alpha = if self.stored > self.used { " with alpha" } else { "" };
        format!("{width}×{height} px of {}-bit {colour}{alpha}", 8 * self.format.bytes_per_pixel())
    }
}

/// Decodes one PNG or JPEG image. Its size is checked before memory is taken.
pub(crate) fn picture(bytes: &[u8]) -> Result<Picture, DecodeError> {
    let reader = reader(bytes)?;
    let format = reader.format();
    let decoder = reader.into_decoder().map_err(fault)?;
    let (width, height) = decoder.dimensions();
    check_size(width, height)?;
    if format == Some(ImageFormat::Jpeg) {
        return jpeg_picture(bytes);
    }
    from_image(DynamicImage::from_decoder(decoder).map_err(fault)?)
}

/// Width and height that the header of a PNG or JPEG image names; no pixel is decoded.
pub fn size(bytes: &[u8]) -> Result<[usize; 2], DecodeError> {
    let (width, height) = reader(bytes)?.into_decoder().map_err(fault)?.dimensions();
    Ok([width as usize, height as usize])
}

fn reader(bytes: &[u8]) -> Result<ImageReader<Cursor<&[u8]>>, DecodeError> {
    let mut reader = ImageReader::new(Cursor::new(bytes))
        .with_guessed_format()
        .map_err(|error| DecodeError::Damaged(error.to_string()))?;
    if !matches!(reader.format(), Some(ImageFormat::Png | ImageFormat::Jpeg)) {
        return Err(DecodeError::UnknownKind);
    }
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(LIMITS.side_px);
    limits.max_image_height = Some(LIMITS.side_px);
    limits.max_alloc = Some(LIMITS.frame_pixels * 8);
    reader.limits(limits);
    Ok(reader)
}

pub(crate) fn check_size(width: u32, height: u32) -> Result<(), DecodeError> {
    let pixels = u64::from(width) * u64::from(height);
    if width.max(height) > LIMITS.side_px {
        let limit = LIMITS.side_px;
        return Err(DecodeError::TooLarge(format!("{width}×{height} px; a side may have {limit} px")));
    }
    if pixels > LIMITS.frame_pixels {
        let limit = LIMITS.frame_pixels;
        return Err(DecodeError::TooLarge(format!(
            "{width}×{height} px is more than the {limit} px that a frame may have"
        )));
    }
    Ok(())
}

/// Decoded strictly, as those of cameras are: most decoders make grey of what is damaged, without a word.
fn jpeg_picture(bytes: &[u8]) -> Result<Picture, DecodeError> {
    let (size, channels, bytes) =
        jpeg::pixels(bytes).map_err(|reason| DecodeError::Damaged(format!("the JPEG cannot be decoded: {reason}")))?;
    Ok(Picture { size, format: PixelFormat::U8, stored: channels, used: channels, bytes })
}

fn fault(error: ImageError) -> DecodeError {
    match error {
        ImageError::Limits(limit) => DecodeError::TooLarge(limit.to_string()),
        other => DecodeError::Damaged(other.to_string()),
    }
}

fn from_image(image: DynamicImage) -> Result<Picture, DecodeError> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let (format, stored, used) = match &image {
        DynamicImage::ImageLuma8(_) => (PixelFormat::U8, 1, 1),
        DynamicImage::ImageLumaA8(_) => (PixelFormat::U8, 2, 1),
        DynamicImage::ImageRgb8(_) => (PixelFormat::U8, 3, 3),
        DynamicImage::ImageRgba8(_) => (PixelFormat::U8, 4, 3),
        DynamicImage::ImageLuma16(_) => (PixelFormat::U16, 1, 1),
        DynamicImage::ImageLumaA16(_) => (PixelFormat::U16, 2, 1),
        DynamicImage::ImageRgb16(_) => (PixelFormat::U16, 3, 3),
        DynamicImage::ImageRgba16(_) => (PixelFormat::U16, 4, 3),
        other => return Err(DecodeError::Damaged(format!("its pixels are {:?}, not 8 or 16 bit", other.color()))),
    };
    Ok(Picture { size: [width, height], format, stored, used, bytes: image.into_bytes() })
}
