//! JPEG pictures, decoded strictly: of cameras their luma as it is stored, or one colour; of files grey, or r, g, b.

use isophote_frame::{Buffer, Frame, Plane};
use isophote_jit::PixelFormat;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;
use zune_jpeg::{JpegDecoder, SampleRatios};

use super::colour::Colour;
use super::error::PixelsError;
use super::{convert, segments};
use crate::limits::LIMITS;

/// A picture of `size` px; its luma, or one colour.
pub(super) fn frame(bytes: &[u8], size: [usize; 2], colour: Colour) -> Result<Frame, PixelsError> {
    let Headed { mut decoder, size: got } = headed(bytes).map_err(PixelsError::Damaged)?;
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
    decoder.set_options(options().jpeg_set_out_colorspace(stored));
    let pixels = decoder.decode().map_err(|fault| PixelsError::Damaged(fault.to_string()))?;
    if stored == ColorSpace::Luma {
        return Ok(Frame::new(&size, vec![Plane::owned(PixelFormat::U8, pixels, size[0])])?);
    }
    let frame = Frame::new(&size, convert::rgb(&Buffer::Owned(pixels.into()), 3 * size[0], 0, wanted))?;
    // One that is stored as r, g, b comes out with three planes here: its luma has to be made.
    Ok(frame.luma())
}

/// Every pixel of a file's picture: its size, its channels (1 grey, 3 r, g, b) and its bytes; or what is damaged.
pub(crate) fn pixels(bytes: &[u8]) -> Result<([usize; 2], usize, Vec<u8>), String> {
    let pixels = decoded(bytes)?;
    // A file may take the time of a second look: what is damaged in the middle may still give a picture, a shifted one.
    // Filling is none of the pixels, where these are whole without it.
    let unpadded = segments::unpadded(bytes).filter(|shorter| decoded(shorter).is_ok());
    match segments::shortened(unpadded.as_deref().unwrap_or(bytes)).is_some_and(|shorter| decoded(&shorter).is_ok()) {
        true => Err("its last pixels come before its end".into()),
        false => Ok(pixels),
    }
}

fn decoded(bytes: &[u8]) -> Result<([usize; 2], usize, Vec<u8>), String> {
    let Headed { mut decoder, size } = headed(bytes)?;
    let (stored, channels) = match decoder.input_colorspace() {
        Some(ColorSpace::Luma) => (ColorSpace::Luma, 1),
        _ => (ColorSpace::RGB, 3),
    };
    decoder.set_options(options().jpeg_set_out_colorspace(stored));
    let pixels = decoder.decode().map_err(|fault| fault.to_string())?;
    Ok((size, channels, pixels))
}

/// A picture whose headers have been read.
struct Headed {
    decoder: JpegDecoder<ZCursor<Vec<u8>>>,
    size: [usize; 2],
}

fn headed(bytes: &[u8]) -> Result<Headed, String> {
    let bytes = segments::prepared(bytes)?;
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options());
    decoder.decode_headers().map_err(|fault| fault.to_string())?;
    let size = decoder.dimensions().map_or([0, 0], |(width, height)| [width, height]);
    Ok(Headed { decoder, size })
}

/// Strict: what cannot be decoded would become grey without a word.
fn options() -> DecoderOptions {
    let side_max = LIMITS.side_px as usize;
    DecoderOptions::default().set_strict_mode(true).set_max_width(side_max).set_max_height(side_max)
}
