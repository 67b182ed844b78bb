//! Encodes pixel planes as PNG (8 or 16 bit; one plane as gray, three as colour) or JPEG. For stacks see
//! [`crate::encode_tiff`].

use isophote_jit::PixelFormat;
use jpeg_encoder::SamplingFactor;
use png::{BitDepth, ColorType, Compression, Filter};

/// Why planes cannot be encoded.
#[derive(Debug, thiserror::Error)]
pub enum EncodeError {
    /// Only 8 and 16 bit are supported.
    #[error("{0:?} pixels are not written; only u8 and u16 are")]
    Format(PixelFormat),
    /// A picture has one channel or three.
    #[error("pictures have 1 channel or 3 (r, g, b), not {0}")]
    Planes(usize),
    /// The pixels are not those of a picture of this size.
    #[error("{bytes} bytes are not the pixels of a picture of {width}×{height} px")]
    Length {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Bytes that were given.
        bytes: usize,
    },
    /// Error of the PNG encoder.
    #[error("{0}")]
    Png(#[from] png::EncodingError),
    /// Error of the JPEG encoder.
    #[error("{0}")]
    Jpeg(#[from] jpeg_encoder::EncodingError),
    /// Error of the TIFF encoder.
    #[error("{0}")]
    Stack(#[from] tiff::TiffError),
}

/// Encodes `width` × `height` tightly packed pixels (u16 in native order, little-endian on every machine that the JIT
/// supports).
pub fn encode_png(width: usize, height: usize, format: PixelFormat, pixels: &[u8]) -> Result<Vec<u8>, EncodeError> {
    encode([width, height], ColorType::Grayscale, format, Compression::Fast, pixels)
}

/// Encodes planes of `width` × `height` tightly packed pixels each: one as gray, three as red, green and blue.
pub fn encode_png_planes(
    width: usize,
    height: usize,
    format: PixelFormat,
    planes: &[&[u8]],
) -> Result<Vec<u8>, EncodeError> {
    match planes {
        [gray] => return encode_png(width, height, format, gray),
        [_, _, _] => {}
        _ => return Err(EncodeError::Planes(planes.len())),
    }
    let bytes = format.bytes_per_pixel();
    let pixel = |i: usize| planes.iter().flat_map(move |plane| plane.iter().skip(i * bytes).take(bytes).copied());
    let pixels: Vec<u8> = (0..width * height).flat_map(pixel).collect();
    encode([width, height], ColorType::Rgb, format, Compression::Fast, &pixels)
}

/// Encodes `width` × `height` tightly packed r, g, b bytes (overlays) at a slower, smaller compression.
pub fn encode_png_rgb(width: usize, height: usize, pixels: &[u8]) -> Result<Vec<u8>, EncodeError> {
    encode([width, height], ColorType::Rgb, PixelFormat::U8, Compression::Balanced, pixels)
}

/// Encodes `width` × `height` tightly packed bytes as JPEG: gray with one channel, r, g, b with three. `quality` from 1 to
/// 100.
pub fn encode_jpeg(
    width: usize,
    height: usize,
    channels: usize,
    pixels: &[u8],
    quality: u8,
) -> Result<Vec<u8>, EncodeError> {
    let colour = match channels {
        1 => jpeg_encoder::ColorType::Luma,
        3 => jpeg_encoder::ColorType::Rgb,
        _ => return Err(EncodeError::Planes(channels)),
    };
    check_length([width, height], channels, pixels)?;
    let mut bytes = Vec::new();
    let mut encoder = jpeg_encoder::Encoder::new(&mut bytes, quality);
    encoder.set_sampling_factor(SamplingFactor::F_1_1);
    let side = |side: usize| u16::try_from(side).unwrap_or(0); // the encoder refuses 0
    encoder.encode(pixels, side(width), side(height), colour)?;
    Ok(bytes)
}

fn encode(
    [width, height]: [usize; 2],
    colour: ColorType,
    format: PixelFormat,
    compression: Compression,
    pixels: &[u8],
) -> Result<Vec<u8>, EncodeError> {
    let depth = match format {
        PixelFormat::U8 => BitDepth::Eight,
        PixelFormat::U16 => BitDepth::Sixteen,
        other => return Err(EncodeError::Format(other)),
    };
    check_length([width, height], colour.samples() * format.bytes_per_pixel(), pixels)?;
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, height as u32);
    encoder.set_color(colour);
    encoder.set_depth(depth);
    encoder.set_compression(compression);
    encoder.set_filter(Filter::Adaptive);
    let mut writer = encoder.write_header()?;
    match depth {
        BitDepth::Sixteen => writer.write_image_data(&swapped(pixels))?,
        _ => writer.write_image_data(pixels)?,
    }
    writer.finish()?;
    Ok(bytes)
}

/// Exchanges the bytes of 16-bit pixels: PNG stores them in big-endian order.
pub(crate) fn swapped(pixels: &[u8]) -> Vec<u8> {
    pixels.chunks_exact(2).flat_map(|pair| [pair[1], pair[0]]).collect()
}

fn check_length([width, height]: [usize; 2], bytes_per_pixel: usize, pixels: &[u8]) -> Result<(), EncodeError> {
    let bytes = pixels.len();
    match bytes == width * height * bytes_per_pixel && bytes > 0 {
        true => Ok(()),
        false => Err(EncodeError::Length { width, height, bytes }),
    }
}
