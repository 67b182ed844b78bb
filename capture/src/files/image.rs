//! PNG and JPEG reader.

use std::io::Cursor;

use isophote_jit::PixelFormat;
use png::{BitDepth, DecodingError, Limits, Reader, Transformations};

use super::format::{Content, FolderPrecedence, Format};
use crate::encode::swapped;
use crate::limits::LIMITS;
use crate::picture::{DecodeError, StoredPicture, check_size};
use crate::pixels::jpeg;

/// The signature decides the format: many PNG files are named .jpg.
const CONTENT: Content = Content::Picture { picture, size };

const PNG_SIGNATURE: &[u8] = b"\x89PNG\r\n\x1a\n";

pub(crate) const PNG: Format = Format {
    name: "PNG",
    extensions: &["png"],
    signatures: &[PNG_SIGNATURE],
    content: CONTENT,
    precedence: FolderPrecedence::Pictures,
};

pub(crate) const JPEG: Format = Format {
    name: "JPEG",
    extensions: &["jpg", "jpeg"],
    signatures: &[b"\xff\xd8"],
    content: CONTENT,
    precedence: FolderPrecedence::Pictures,
};

/// Decodes one PNG or JPEG image. Its size is checked before memory is allocated.
pub(crate) fn picture(bytes: &[u8]) -> Result<StoredPicture, DecodeError> {
    let [width, height] = size(bytes)?;
    check_size(width as u32, height as u32)?;
    if JPEG.matches_signature(bytes) {
        return jpeg_picture(bytes);
    }
    let mut reader = png_reader(bytes)?;
    let frames = reader.info().animation_control().map_or(1, |animation| animation.num_frames);
    if frames > 1 {
        return Err(DecodeError::Unsupported(format!(
            "it is an animated PNG of {frames} frames; convert it to Y4M (ffmpeg -i FILE OUT.y4m), or to a PNG of each frame \
             (ffmpeg -i FILE %06d.png)"
        )));
    }
    let (colour, depth) = reader.output_color_type();
    let stored = colour.samples();
    let length = reader.output_buffer_size().ok_or_else(|| DecodeError::TooLarge(format!("{width}×{height} px")))?;
    let mut pixels = vec![0; length];
    reader.next_frame(&mut pixels).map_err(fault)?;
    let (format, bytes) = match depth {
        BitDepth::Sixteen => (PixelFormat::U16, swapped(&pixels)),
        _ => (PixelFormat::U8, pixels),
    };
    // Gray, gray and alpha, r g b, r g b and alpha.
    Ok(StoredPicture { size: [width, height], format, stored, used: if stored < 3 { 1 } else { 3 }, bytes })
}

/// Width and height from the header; decodes no pixel.
pub(crate) fn size(bytes: &[u8]) -> Result<[usize; 2], DecodeError> {
    match () {
        () if PNG.matches_signature(bytes) => {
            let (width, height) = png_reader(bytes)?.info().size();
            Ok([width as usize, height as usize])
        }
        () if JPEG.matches_signature(bytes) => jpeg::size(bytes).map_err(damaged_jpeg),
        () => Err(DecodeError::UnknownKind),
    }
}

/// A reader of pixels of 8 or 16 bits that has read the header.
fn png_reader(bytes: &[u8]) -> Result<Reader<Cursor<&[u8]>>, DecodeError> {
    let bytes_max = usize::try_from(LIMITS.frame_pixels * 8).unwrap_or(usize::MAX);
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), Limits { bytes: bytes_max });
    decoder.set_transformations(Transformations::EXPAND);
    decoder.read_info().map_err(fault)
}

/// Decoded strictly, as for cameras: most decoders silently fill damaged parts with grey.
fn jpeg_picture(bytes: &[u8]) -> Result<StoredPicture, DecodeError> {
    let (size, channels, bytes) = jpeg::pixels(bytes).map_err(damaged_jpeg)?;
    Ok(StoredPicture { size, format: PixelFormat::U8, stored: channels, used: channels, bytes })
}

fn damaged_jpeg(reason: String) -> DecodeError {
    DecodeError::Damaged(format!("the JPEG cannot be decoded: {reason}"))
}

fn fault(error: DecodingError) -> DecodeError {
    match error {
        DecodingError::LimitsExceeded => DecodeError::TooLarge(error.to_string()),
        other => DecodeError::Damaged(other.to_string()),
    }
}
