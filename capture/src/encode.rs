//! Planes of pixels in, the bytes of a PNG file out (8 or 16 bit): one plane as gray, three as colour. Stacks become TIFF, see [`crate::encode_tiff`].

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use isophote_jit::PixelFormat;

/// Why a plane is not a PNG.
#[derive(Debug, thiserror::Error)]
pub enum EncodeError {
    /// Files are written with 8 and 16 bit only.
    #[error("{0:?} pixels are not written; only u8 and u16 are")]
    Format(PixelFormat),
    /// A picture is gray or has three colours.
    #[error("pictures have 1 channel or 3 (r, g, b), not {0}")]
    Planes(usize),
    /// What the encoder says.
    #[error("{0}")]
    Encoder(#[from] image::ImageError),
    /// What the encoder of stacks says.
    #[error("{0}")]
    Stack(#[from] tiff::TiffError),
}

/// Encodes `width` × `height` tightly packed pixels (u16 in native order, which is little-endian on every machine that the JIT knows).
pub fn encode_png(width: usize, height: usize, format: PixelFormat, pixels: &[u8]) -> Result<Vec<u8>, EncodeError> {
    let colour = match format {
        PixelFormat::U8 => ExtendedColorType::L8,
        PixelFormat::U16 => ExtendedColorType::L16,
        other => return Err(EncodeError::Format(other)),
    };
    encode(width, height, colour, CompressionType::Fast, pixels)
}

/// Encodes planes of `width` × `height` tightly packed pixels each: one as gray, three as red, green and blue.
pub fn encode_png_planes(
    width: usize,
    height: usize,
    format: PixelFormat,
    planes: &[&[u8]],
) -> Result<Vec<u8>, EncodeError> {
    let colour = match (planes, format) {
        ([gray], _) => return encode_png(width, height, format, gray),
        ([_, _, _], PixelFormat::U8) => ExtendedColorType::Rgb8,
        ([_, _, _], PixelFormat::U16) => ExtendedColorType::Rgb16,
        ([_, _, _], other) => return Err(EncodeError::Format(other)),
        _ => return Err(EncodeError::Planes(planes.len())),
    };
    let bytes = format.bytes_per_pixel();
    let pixel = |i: usize| planes.iter().flat_map(move |plane| plane.iter().skip(i * bytes).take(bytes).copied());
    let pixels: Vec<u8> = (0..width * height).flat_map(pixel).collect();
    encode(width, height, colour, CompressionType::Fast, &pixels)
}

/// Encodes `width` × `height` tightly packed r, g, b bytes (overlays): slower and smaller.
pub fn encode_png_rgb(width: usize, height: usize, pixels: &[u8]) -> Result<Vec<u8>, EncodeError> {
    encode(width, height, ExtendedColorType::Rgb8, CompressionType::Default, pixels)
}

/// Encodes `width` × `height` tightly packed bytes as JPEG: one a pixel as gray, or r, g, b. `quality` from 1 to 100.
pub fn encode_jpeg(
    width: usize,
    height: usize,
    channels: usize,
    pixels: &[u8],
    quality: u8,
) -> Result<Vec<u8>, EncodeError> {
    let colour = match channels {
        1 => ExtendedColorType::L8,
        3 => ExtendedColorType::Rgb8,
        _ => return Err(EncodeError::Planes(channels)),
    };
    check_length(width, height, colour, pixels)?;
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality).write_image(pixels, width as u32, height as u32, colour)?;
    Ok(bytes)
}

fn encode(
    width: usize,
    height: usize,
    colour: ExtendedColorType,
    compression: CompressionType,
    pixels: &[u8],
) -> Result<Vec<u8>, EncodeError> {
    check_length(width, height, colour, pixels)?;
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, compression, FilterType::Adaptive).write_image(
        pixels,
        width as u32,
        height as u32,
        colour,
    )?;
    Ok(bytes)
}

/// The encoders panic on a wrong length: that becomes an error of the same kind as their own.
fn check_length(width: usize, height: usize, colour: ExtendedColorType, pixels: &[u8]) -> Result<(), EncodeError> {
    let expected = (width * height) as u64 * u64::from(colour.bits_per_pixel()) / 8;
    if pixels.len() as u64 != expected || width == 0 || height == 0 {
        let kind = image::error::ParameterErrorKind::DimensionMismatch;
        return Err(image::ImageError::Parameter(image::error::ParameterError::from_kind(kind)).into());
    }
    Ok(())
}
