//! TIFF: pages in, pictures out, and the other way round.
//!
//! 8 and 16 bit unsigned and 32 bit float, gray or r, g, b (alpha is left out), uncompressed, LZW or Deflate.

use std::fs::File;
use std::io::{BufReader, Cursor, Seek};

use isophote_jit::PixelFormat;
use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::encoder::{TiffEncoder, colortype};
use tiff::tags::Tag;

use super::format::{Beside, Content, Format, PageFault, Pages, Topics};
use crate::encode::EncodeError;
use crate::limits::LIMITS;
use crate::picture::{DecodeError, StoredPicture, check_size};

pub(crate) const FORMAT: Format = Format {
    name: "TIFF",
    extensions: &["tif", "tiff"],
    // Of either byte order; with offsets of four bytes, or of eight.
    signatures: &[b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"],
    content: Content::Pages {
        words: ["a TIFF", "pages"],
        open: |file, _| Ok(Box::new(Tiff::open(file)?)),
        topics: Topics::One,
    },
    beside: Beside::Pictures,
};

/// An open TIFF file.
struct Tiff {
    file: File,
    /// `None` after a page that could not be found: the decoder is at no known place then.
    decoder: Option<Decoder<BufReader<File>>>,
}

impl From<tiff::TiffError> for PageFault {
    fn from(error: tiff::TiffError) -> PageFault {
        PageFault::Wrong(fault(error))
    }
}

impl Tiff {
    /// Reads a file as far as its first page.
    pub fn open(file: File) -> Result<Tiff, PageFault> {
        Ok(Tiff { decoder: Some(decoder(&file)?), file })
    }

    /// The decoder at a page.
    fn at(&mut self, page: usize) -> Result<&mut Decoder<BufReader<File>>, PageFault> {
        let mut decoder = self.decoder.take().map_or_else(|| decoder(&self.file), Ok)?;
        decoder.seek_to_image(page)?;
        Ok(self.decoder.insert(decoder))
    }
}

/// One at a time: its place in the file is that of all.
fn decoder(file: &File) -> Result<Decoder<BufReader<File>>, PageFault> {
    let mut file = file.try_clone()?;
    file.rewind()?;
    let mut limits = Limits::default();
    // Of one page: three channels of four bytes.
    limits.decoding_buffer_size = (LIMITS.frame_pixels * 12) as usize;
    limits.intermediate_buffer_size = limits.decoding_buffer_size;
    Ok(Decoder::new(BufReader::new(file))?.with_limits(limits))
}

impl Pages for Tiff {
    fn count(&mut self, most: usize) -> Result<usize, PageFault> {
        let decoder = self.at(0)?;
        let mut last = 0;
        while decoder.more_images() && last < most {
            decoder.next_image()?;
            last += 1;
        }
        Ok(last + 1)
    }

    fn size(&mut self, page: usize) -> Result<[usize; 2], PageFault> {
        let (width, height) = self.at(page)?.dimensions()?;
        Ok([width as usize, height as usize])
    }

    fn picture(&mut self, page: usize) -> Result<StoredPicture, PageFault> {
        Ok(picture(self.at(page)?)?)
    }
}

/// The pixels of the page that the decoder stands at.
fn picture(decoder: &mut Decoder<BufReader<File>>) -> Result<StoredPicture, DecodeError> {
    let (width, height) = decoder.dimensions().map_err(fault)?;
    check_size(width, height)?;
    let (width, height) = (width as usize, height as usize);
    let colour = decoder.colortype().map_err(fault)?;
    let (stored, used) = match colour {
        ColorType::Gray(_) => (1, 1),
        ColorType::GrayA(_) => (2, 1),
        ColorType::RGB(_) => (3, 3),
        ColorType::RGBA(_) => (4, 3),
        other => return Err(unsupported(&format!("its colours are {other:?}"))),
    };
    let planar: Option<u16> = decoder.find_tag_unsigned(Tag::PlanarConfiguration).map_err(fault)?;
    if stored > 1 && planar == Some(2) {
        return Err(unsupported("its colours are stored plane by plane"));
    }
    let mut pixels = DecodingResult::U8(Vec::new());
    decoder.read_image_to_buffer(&mut pixels).map_err(fault)?;
    let (format, bytes): (PixelFormat, Vec<u8>) = match pixels {
        DecodingResult::U8(values) if colour.bit_depth() == 8 => (PixelFormat::U8, values),
        DecodingResult::U16(values) => (PixelFormat::U16, values.iter().flat_map(|v| v.to_ne_bytes()).collect()),
        DecodingResult::F32(values) => (PixelFormat::F32, values.iter().flat_map(|v| v.to_ne_bytes()).collect()),
        _ => return Err(unsupported(&format!("its pixels have {} bits", colour.bit_depth()))),
    };
    if bytes.len() != width * height * stored * format.bytes_per_pixel() {
        return Err(unsupported("its rows are not stored pixel by pixel"));
    }
    Ok(StoredPicture { size: [width, height], format, stored, used, bytes })
}

fn unsupported(what: &str) -> DecodeError {
    DecodeError::Unsupported(format!(
        "{what}; TIFF is read with 8 or 16 bit unsigned or 32 bit float pixels, gray or r, g, b side by side"
    ))
}

fn fault(error: tiff::TiffError) -> DecodeError {
    match error {
        tiff::TiffError::UnsupportedError(what) => {
            DecodeError::Unsupported(format!("{what}; save it uncompressed, or with LZW or Deflate"))
        }
        tiff::TiffError::LimitsExceeded => DecodeError::TooLarge("the page is larger than a frame may be".into()),
        other => DecodeError::Damaged(other.to_string()),
    }
}

/// Encodes tightly packed gray slices of `width` × `height` pixels (u16 in native order), one page each.
pub fn encode_tiff(width: usize, height: usize, format: PixelFormat, slices: &[u8]) -> Result<Vec<u8>, EncodeError> {
    let mut file = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut file)?;
    let (columns, rows) = (width as u32, height as u32);
    for slice in slices.chunks(width * height * format.bytes_per_pixel()) {
        match format {
            PixelFormat::U8 => encoder.write_image::<colortype::Gray8>(columns, rows, slice)?,
            PixelFormat::U16 => {
                let values: Vec<u16> = slice.chunks_exact(2).map(|v| u16::from_ne_bytes([v[0], v[1]])).collect();
                encoder.write_image::<colortype::Gray16>(columns, rows, &values)?;
            }
            other => return Err(EncodeError::Format(other)),
        }
    }
    Ok(file.into_inner())
}
