//! JPEG pictures of cameras: their luma as it is stored, or one colour of them.

use isophote_jit::PixelFormat;
use isophote_tracker::{Buffer, Frame, Plane};
use zune_jpeg::errors::DecodeErrors;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;
use zune_jpeg::{JpegDecoder, SampleRatios};

use super::{Colour, PixelsError, convert, segments};
use crate::limits::LIMITS;

/// A picture of `size` px; its luma, or one colour.
pub(super) fn frame(bytes: &[u8], size: [usize; 2], colour: Colour) -> Result<Frame, PixelsError> {
    let bytes = segments::prepared(bytes).map_err(PixelsError::Damaged)?;
    // Strict: what cannot be decoded would become grey without a word.
    let side_max = LIMITS.side_px as usize;
    let options = DecoderOptions::default().set_strict_mode(true).set_max_width(side_max).set_max_height(side_max);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(&bytes), options);
    decoder.decode_headers().map_err(damaged)?;
    let got = decoder.dimensions().map_or([0, 0], |(width, height)| [width, height]);
    if got != size {
        return Err(PixelsError::OtherSize { expected: size, got });
    }
    let sampling = decoder.info().map(|picture| picture.sample_ratio);
    let (stored, wanted) = match (decoder.input_colorspace(), colour) {
        (Some(ColorSpace::Luma), Colour::All) => (ColorSpace::Luma, Colour::All),
        (Some(ColorSpace::YCbCr), Colour::All) => match sampling {
            Some(SampleRatios::None | SampleRatios::H | SampleRatios::HV) => (ColorSpace::Luma, Colour::All),
            // Of a sampling that is rare the decoder gives luma only with the chroma: it is the first of three.
            _ => (ColorSpace::YCbCr, Colour::Red),
        },
        (_, colour) => (ColorSpace::RGB, colour),
    };
    decoder.set_options(options.jpeg_set_out_colorspace(stored));
    let pixels = decoder.decode().map_err(damaged)?;
    if stored == ColorSpace::Luma {
        return Ok(Frame::new(&size, vec![Plane::owned(PixelFormat::U8, pixels, size[0])])?);
    }
    let frame = Frame::new(&size, convert::rgb(&Buffer::Owned(pixels.into()), 3 * size[0], 0, wanted))?;
    // One that is stored as r, g, b comes out with three planes here: its luma has to be made.
    Ok(frame.luma())
}

fn damaged(error: DecodeErrors) -> PixelsError {
    PixelsError::Damaged(error.to_string())
}
