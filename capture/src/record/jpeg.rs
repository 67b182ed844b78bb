//! A frame of 8 bits in, a JPEG out.

use isophote_frame::Frame;
use isophote_jit::PixelFormat;

use super::foxglove::append_pixels;
use crate::encode::encode_jpeg;

/// Of 100: no edge of a target shows blocks, and a picture is a tenth of its pixels.
const QUALITY: u8 = 90;

/// Why there is none.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoJpeg {
    /// See the text.
    #[error(
        "JPEG holds pictures of 8 bits in one plane or three, frames are otherwise; record them with \"frames\": \"raw\""
    )]
    Pixels,
    /// What the encoder says.
    #[error("a frame cannot be packed as JPEG: {0}")]
    Encoder(String),
}

/// Packs the pixels of a picture.
///
/// # Errors
/// When the frame is no picture of 8 bits.
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
