//! Reads the pixels of a TIFF page with their stored values, or reports why it is not supported and what would be.

use isophote_jit::PixelFormat;
use tiff::ColorType;
use tiff::decoder::{ChunkType, Decoder, DecodingResult};
use tiff::tags::Tag;

use super::reader::TiffReader;
use crate::picture::{DecodeError, StoredPicture, check_size};

/// Supported compressions: none, LZW, Deflate under both its numbers, PackBits.
const COMPRESSIONS: [u32; 5] = [1, 5, 8, 32946, 32773];
/// Names of unsupported compressions.
const OTHER_COMPRESSIONS: [(u32, &str); 11] = [
    (2, "CCITT"),
    (3, "CCITT fax"),
    (4, "CCITT fax"),
    (6, "JPEG"),
    (7, "JPEG"),
    (33003, "JPEG 2000"),
    (34712, "JPEG 2000"),
    (34887, "LERC"),
    (34925, "LZMA"),
    (50000, "Zstandard"),
    (50001, "WebP"),
];
/// Names of photometric interpretations other than gray (0 and 1) and r, g, b (2).
const OTHER_COLOURS: [(u32, &str); 6] =
    [(3, "those of a palette"), (5, "CMYK"), (6, "YCbCr"), (8, "L*a*b*"), (9, "L*a*b*"), (10, "L*a*b*")];
/// ExtraSamples values of alpha, premultiplied or not.
const ALPHA: [u32; 2] = [1, 2];
/// PlanarConfiguration of separate planes.
const PLANAR: u32 = 2;

/// The tiff crate's error as a [`DecodeError`].
pub(super) fn fault(error: tiff::TiffError) -> DecodeError {
    match error {
        tiff::TiffError::UnsupportedError(what) => unsupported(&what.to_string()),
        tiff::TiffError::LimitsExceeded => DecodeError::TooLarge("the page is larger than a frame may be".into()),
        other => DecodeError::Damaged(other.to_string()),
    }
}

/// Reads the pixels of the current page, or of one `shift` bytes after it.
pub(super) fn picture(decoder: &mut Decoder<TiffReader>, shift: u64) -> Result<StoredPicture, DecodeError> {
    let (width, height) = decoder.dimensions().map_err(fault)?;
    check_size(width, height)?;
    let size = [width as usize, height as usize];
    check_compression(number(decoder, Tag::Compression, 1)?)?;
    check_numbers(number(decoder, Tag::SampleFormat, 1)?, number(decoder, Tag::BitsPerSample, 1)?)?;
    let [stored, used] = channels(decoder)?;
    let is_planar = stored > 1 && number(decoder, Tag::PlanarConfiguration, 1)? == PLANAR;
    // The decoder mislocates the tiles from the second plane on.
    if is_planar && decoder.get_chunk_type() == ChunkType::Tile {
        return Err(unsupported(
            "its colours are stored plane by plane, in tiles; save it in strips, or pixel by pixel",
        ));
    }
    let is_reversed = number(decoder, Tag::FillOrder, 1)? == 2;
    let mut pixels = DecodingResult::U8(Vec::new());
    // The shift and the bit order apply to pixels only, not to tags.
    (decoder.inner().shift, decoder.inner().is_reversed) = (shift, is_reversed);
    let read = decoder.read_image_to_buffer(&mut pixels);
    (decoder.inner().shift, decoder.inner().is_reversed) = (0, false);
    read.map_err(fault)?;
    let (format, mut bytes) = bytes_of(pixels)?;
    if bytes.len() != size[0] * size[1] * stored * format.bytes_per_pixel() {
        return Err(unsupported("its rows are not stored pixel by pixel"));
    }
    if is_planar {
        bytes = interleaved(&bytes, stored, format.bytes_per_pixel());
    }
    Ok(StoredPicture { size, format, stored, used, bytes })
}

/// First value of a tag, or `absent`.
fn number(decoder: &mut Decoder<TiffReader>, tag: Tag, absent: u32) -> Result<u32, DecodeError> {
    let numbers = decoder.find_tag_unsigned_vec::<u32>(tag).map_err(fault)?;
    Ok(numbers.and_then(|numbers| numbers.first().copied()).unwrap_or(absent))
}

fn check_compression(compression: u32) -> Result<(), DecodeError> {
    if COMPRESSIONS.contains(&compression) {
        return Ok(());
    }
    let name = named(&OTHER_COMPRESSIONS, compression).unwrap_or("a compression that is not known");
    Err(DecodeError::Unsupported(format!(
        "it is compressed with {name} ({compression}); save it uncompressed, or with LZW, Deflate or PackBits"
    )))
}

fn check_numbers(format: u32, bits: u32) -> Result<(), DecodeError> {
    let reason = match (format, bits) {
        (1 | 2, 8 | 16 | 32) | (3, 16 | 32 | 64) => return Ok(()),
        (1 | 2, 64) => "its pixels are 64-bit integers; save it as 64-bit float, or with 32 bits".into(),
        (1 | 2, ..8) => format!("its pixels have {bits} bits, packed; save it with 8 bits"),
        (1 | 2, 9..16) => format!("its pixels have {bits} bits, packed; save it with 16 bits"),
        (1 | 2, _) => format!("its pixels have {bits} bits; save it with 32 bits"),
        (3, _) => format!("its pixels are {bits}-bit float; save it as 32-bit float"),
        (5 | 6, _) => "its pixels are complex numbers; save their real part or magnitude".into(),
        _ => format!("SampleFormat {format} does not say what kind of numbers its pixels are; save it again"),
    };
    Err(unsupported(&reason))
}

/// Channels per pixel: as stored, and used.
fn channels(decoder: &mut Decoder<TiffReader>) -> Result<[usize; 2], DecodeError> {
    let photometric = number(decoder, Tag::PhotometricInterpretation, 1)?;
    let samples = number(decoder, Tag::SamplesPerPixel, 1)?;
    let other = |reason: String| Err(unsupported(&format!("{reason}; save it as gray or as r, g, b")));
    if photometric > 2 {
        let name = named(&OTHER_COLOURS, photometric).unwrap_or("of a kind that is not known");
        return other(format!("its colours are {name}"));
    }
    let [stored, used] = match decoder.colortype().map_err(fault)? {
        ColorType::Gray(_) => [1, 1],
        ColorType::Multiband { num_samples: 2, .. } if ALPHA.contains(&number(decoder, Tag::ExtraSamples, 0)?) => {
            [2, 1]
        }
        ColorType::RGB(_) => [3, 3],
        ColorType::RGBA(_) => [4, 3],
        _ => return other(format!("its pixels have {samples} samples, and it does not say which of them are colours")),
    };
    // The decoder drops samples after the colours but undoes the predictor as if they were present.
    if samples as usize != stored && number(decoder, Tag::Predictor, 1)? != 1 {
        return other(format!("its pixels have {samples} samples, of which {stored} are colours, and a predictor"));
    }
    Ok([stored, used])
}

/// Converts values losslessly; integers that f32 cannot hold exactly become f64.
fn bytes_of(pixels: DecodingResult) -> Result<(PixelFormat, Vec<u8>), DecodeError> {
    let single =
        |values: &mut dyn Iterator<Item = f32>| (PixelFormat::F32, values.flat_map(f32::to_ne_bytes).collect());
    let double =
        |values: &mut dyn Iterator<Item = f64>| (PixelFormat::F64, values.flat_map(f64::to_ne_bytes).collect());
    Ok(match pixels {
        DecodingResult::U8(values) => (PixelFormat::U8, values),
        DecodingResult::U16(values) => (PixelFormat::U16, values.into_iter().flat_map(u16::to_ne_bytes).collect()),
        DecodingResult::I8(values) => single(&mut values.into_iter().map(f32::from)),
        DecodingResult::I16(values) => single(&mut values.into_iter().map(f32::from)),
        DecodingResult::F16(values) => single(&mut values.into_iter().map(f32::from)),
        DecodingResult::F32(values) => single(&mut values.into_iter()),
        DecodingResult::U32(values) => double(&mut values.into_iter().map(f64::from)),
        DecodingResult::I32(values) => double(&mut values.into_iter().map(f64::from)),
        DecodingResult::F64(values) => double(&mut values.into_iter()),
        DecodingResult::U64(_) | DecodingResult::I64(_) => return Err(unsupported("its pixels are 64-bit integers")),
    })
}

/// Interleaves planes into pixels of `channels` numbers of `bytes` bytes each.
fn interleaved(planes: &[u8], channels: usize, bytes: usize) -> Vec<u8> {
    let plane = planes.len() / channels;
    let mut pixels = Vec::with_capacity(planes.len());
    for at in (0..plane).step_by(bytes) {
        (0..channels).for_each(|channel| pixels.extend_from_slice(&planes[channel * plane + at..][..bytes]));
    }
    pixels
}

fn named(table: &[(u32, &'static str)], wanted: u32) -> Option<&'static str> {
    table.iter().find(|(number, _)| *number == wanted).map(|(_, name)| *name)
}

pub(super) fn unsupported(what: &str) -> DecodeError {
    DecodeError::Unsupported(format!(
        "{what}; TIFF is read with integers of 8, 16 or 32 bits or 16, 32 or 64 bit float, gray or r, g, b"
    ))
}
