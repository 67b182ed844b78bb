//! Strict JPEG decoder: stored luma or one colour for cameras; grey or r, g, b for files.

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

/// Decodes a picture of `size` px to its luma, or one colour.
pub(super) fn frame(bytes: &[u8], size: [usize; 2], colour: Colour) -> Result<Frame, PixelsError> {
    let Headed { mut decoder, size: got } = headed(bytes, options()).map_err(PixelsError::Damaged)?;
    if got != size {
        return Err(PixelsError::OtherSize { expected: size, got });
    }
    let sampling = decoder.info().map(|picture| picture.sample_ratio);
    let (stored, wanted) = match (decoder.input_colorspace(), colour) {
        (Some(ColorSpace::Luma), Colour::All) => (ColorSpace::Luma, Colour::All),
        (Some(ColorSpace::YCbCr), Colour::All) => match sampling {
            Some(SampleRatios::None | SampleRatios::H | SampleRatios::HV) => (ColorSpace::Luma, Colour::All),
            // For rare subsamplings the decoder yields luma only together with chroma, as the first of three channels.
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
    // A JPEG stored as r, g, b has three planes here: its luma must be computed.
    Ok(frame.luma())
}

/// Decodes a file completely: size, channels (1 grey, 3 r, g, b) and bytes; or the damage found.
pub(crate) fn pixels(bytes: &[u8]) -> Result<([usize; 2], usize, Vec<u8>), String> {
    let pixels = decoded(bytes)?;
    // Files allow the time for a second check: data damaged in the middle may still decode, to a shifted picture. Padding is
    // removed first if the picture decodes without it.
    let unpadded = segments::unpadded(bytes).filter(|shorter| decoded(shorter).is_ok());
    match segments::shortened(unpadded.as_deref().unwrap_or(bytes)).is_some_and(|shorter| decoded(&shorter).is_ok()) {
        true => Err("its last pixels come before its end".into()),
        false => Ok(pixels),
    }
}

/// Width and height from the header, however large they are; or the damage found.
pub(crate) fn size(bytes: &[u8]) -> Result<[usize; 2], String> {
    let any = options().set_max_width(usize::MAX).set_max_height(usize::MAX);
    Ok(headed(bytes, any)?.size)
}

fn decoded(bytes: &[u8]) -> Result<([usize; 2], usize, Vec<u8>), String> {
    let Headed { mut decoder, size } = headed(bytes, options())?;
    let (stored, channels) = match decoder.input_colorspace() {
        Some(ColorSpace::Luma) => (ColorSpace::Luma, 1),
        _ => (ColorSpace::RGB, 3),
    };
    decoder.set_options(options().jpeg_set_out_colorspace(stored));
    let pixels = decoder.decode().map_err(|fault| fault.to_string())?;
    Ok((size, channels, pixels))
}

/// A decoder that has read the headers.
struct Headed {
    decoder: JpegDecoder<ZCursor<Vec<u8>>>,
    size: [usize; 2],
}

fn headed(bytes: &[u8], options: DecoderOptions) -> Result<Headed, String> {
    let bytes = segments::prepared(bytes)?;
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(|fault| fault.to_string())?;
    let size = decoder.dimensions().map_or([0, 0], |(width, height)| [width, height]);
    Ok(Headed { decoder, size })
}

/// Strict: otherwise undecodable parts would silently become grey.
fn options() -> DecoderOptions {
    let side_max = LIMITS.side_px as usize;
    DecoderOptions::default().set_strict_mode(true).set_max_width(side_max).set_max_height(side_max)
}
