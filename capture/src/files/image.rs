//! PNG and JPEG: the bytes of a file in, its picture out.

use std::io::Cursor;

use image::{DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader};
use isophote_jit::PixelFormat;

use super::format::{Beside, Content, Format};
use crate::limits::LIMITS;
use crate::picture::{DecodeError, StoredPicture, check_size};
use crate::pixels::jpeg;

/// Which kind it is, the bytes say: many a PNG is called .jpg.
const CONTENT: Content = Content::Picture { picture, size };

const PNG_SIGNATURE: &[u8] = b"\x89PNG\r\n\x1a\n";

pub(crate) const PNG: Format = Format {
    name: "PNG",
    extensions: &["png"],
    signatures: &[PNG_SIGNATURE],
    content: CONTENT,
    beside: Beside::Pictures,
};

pub(crate) const JPEG: Format = Format {
    name: "JPEG",
    extensions: &["jpg", "jpeg"],
    signatures: &[b"\xff\xd8"],
    content: CONTENT,
    beside: Beside::Pictures,
};

/// Decodes one PNG or JPEG image. Its size is checked before memory is taken.
pub(crate) fn picture(bytes: &[u8]) -> Result<StoredPicture, DecodeError> {
    let reader = reader(bytes)?;
    let format = reader.format();
    let decoder = reader.into_decoder().map_err(fault)?;
    let (width, height) = decoder.dimensions();
    check_size(width, height)?;
    if format == Some(ImageFormat::Jpeg) {
        return jpeg_picture(bytes);
    }
    let frames = frames_of_png(bytes);
    if frames > 1 {
        return Err(DecodeError::Unsupported(format!(
            "it is an animated PNG of {frames} frames; convert it to Y4M (ffmpeg -i FILE OUT.y4m), or to a PNG of each frame \
             (ffmpeg -i FILE %06d.png)"
        )));
    }
    from_image(DynamicImage::from_decoder(decoder).map_err(fault)?)
}

/// How many frames a PNG has: where there are several, the chunk acTL before the pixels says it.
fn frames_of_png(bytes: &[u8]) -> u32 {
    let number = |bytes: &[u8]| bytes.first_chunk().map(|bytes| u32::from_be_bytes(*bytes));
    let mut rest = bytes.get(PNG_SIGNATURE.len()..).unwrap_or_default();
    while let (Some(length), Some(kind)) = (number(rest), rest.get(4..8)) {
        match kind {
            b"acTL" => return rest.get(8..).and_then(number).unwrap_or(1),
            b"IDAT" => break,
            // Length, kind and checksum have four bytes each.
            _ => rest = rest.get(length as usize + 12..).unwrap_or_default(),
        }
    }
    1
}

/// Width and height that the header names; no pixel is decoded.
pub(crate) fn size(bytes: &[u8]) -> Result<[usize; 2], DecodeError> {
    let (width, height) = reader(bytes)?.into_decoder().map_err(fault)?.dimensions();
    Ok([width as usize, height as usize])
}

fn reader(bytes: &[u8]) -> Result<ImageReader<Cursor<&[u8]>>, DecodeError> {
    let kinds = [(PNG, ImageFormat::Png), (JPEG, ImageFormat::Jpeg)];
    let kind = kinds.into_iter().find(|(format, _)| format.begins(bytes));
    let (_, kind) = kind.ok_or(DecodeError::UnknownKind)?;
    let mut reader = ImageReader::with_format(Cursor::new(bytes), kind);
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(LIMITS.side_px);
    limits.max_image_height = Some(LIMITS.side_px);
    limits.max_alloc = Some(LIMITS.frame_pixels * 8);
    reader.limits(limits);
    Ok(reader)
}

/// Decoded strictly, as those of cameras are: most decoders make grey of what is damaged, without a word.
fn jpeg_picture(bytes: &[u8]) -> Result<StoredPicture, DecodeError> {
    let (size, channels, bytes) =
        jpeg::pixels(bytes).map_err(|reason| DecodeError::Damaged(format!("the JPEG cannot be decoded: {reason}")))?;
    Ok(StoredPicture { size, format: PixelFormat::U8, stored: channels, used: channels, bytes })
}

fn fault(error: ImageError) -> DecodeError {
    match error {
        ImageError::Limits(limit) => DecodeError::TooLarge(limit.to_string()),
        other => DecodeError::Damaged(other.to_string()),
    }
}

fn from_image(image: DynamicImage) -> Result<StoredPicture, DecodeError> {
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
    Ok(StoredPicture { size: [width, height], format, stored, used, bytes: image.into_bytes() })
}
