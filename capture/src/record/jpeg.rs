//! Encodes an 8-bit frame as JPEG.

use isophote_frame::Frame;
use isophote_jit::PixelFormat;

use super::foxglove::append_pixels;
use crate::encode::encode_jpeg;

/// JPEG quality, of 100: no block artefacts at target edges, and a tenth of the raw size.
const QUALITY: u8 = 90;

/// Why a frame cannot become a JPEG.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoJpeg {
    /// Unsupported planes or pixel format.
    #[error(
        "JPEG holds pictures of 8 bits in one plane or three, frames are otherwise; record them with \"frames\": \"raw\""
    )]
    Pixels,
    /// Error of the encoder.
    #[error("a frame cannot be packed as JPEG: {0}")]
    Encoder(String),
}

/// Encodes a picture.
///
/// # Errors
/// The frame is not an 8-bit picture, or the encoder fails.
pub fn jpeg(frame: &Frame) -> Result<Vec<u8>, NoJpeg> {
    let has_8_bits = frame.planes().iter().all(|plane| plane.format == PixelFormat::U8);
    let channels = frame.planes().len();
    if !has_8_bits || !matches!(channels, 1 | 3) || frame.size().len() != 2 || frame.names().is_some() {
        return Err(NoJpeg::Pixels);
    }
    let mut pixels = Vec::new();
    append_pixels(&mut pixels, frame);
    let packed = encode_jpeg(frame.width(), frame.rows(), channels, &pixels, QUALITY);
    packed.map_err(|error| NoJpeg::Encoder(error.to_string()))
}
