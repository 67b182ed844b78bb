//! TIFF: pages in, pictures out, and the other way round.
//!
//! 8 and 16 bit unsigned and 32 bit float, gray or r, g, b (alpha is left out), uncompressed, LZW or Deflate. Pages are read
//! one at a time from the open file, so that a recording of many pages costs no more memory than one.

use std::fs::File;
use std::io::{BufReader, Cursor};
use std::path::Path;

use isophote_jit::PixelFormat;
use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::encoder::{TiffEncoder, colortype};
use tiff::tags::Tag;

use crate::decode::{DecodeError, Picture, check_size};
use crate::encode::EncodeError;
use crate::limits::LIMITS;

/// An open TIFF file.
pub(crate) struct Pages {
    decoder: Decoder<BufReader<File>>,
    /// The page that the decoder stands at.
    page: usize,
}

impl std::fmt::Debug for Pages {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Pages").field("page", &self.page).finish_non_exhaustive()
    }
}

/// Why a file gives no page.
pub(crate) enum PageFault {
    /// The operating system refused.
    Unreadable(std::io::Error),
    /// It is not what it should be.
    Wrong(DecodeError),
}

impl From<tiff::TiffError> for PageFault {
    fn from(error: tiff::TiffError) -> PageFault {
        PageFault::Wrong(fault(error))
    }
}

impl Pages {
    /// Opens a file at its first page.
    pub fn open(path: &Path) -> Result<Pages, PageFault> {
        let file = File::open(path).map_err(PageFault::Unreadable)?;
        let mut limits = Limits::default();
        // Of one page: three channels of four bytes.
        limits.decoding_buffer_size = (LIMITS.frame_pixels * 12) as usize;
        limits.intermediate_buffer_size = limits.decoding_buffer_size;
        Ok(Pages { decoder: Decoder::new(BufReader::new(file))?.with_limits(limits), page: 0 })
    }

    /// How many pages there are, counted no further than one beyond `most`. The decoder then stands at the last.
    pub fn count(mut self, most: usize) -> Result<usize, PageFault> {
        while self.decoder.more_images() && self.page < most {
            self.step()?;
        }
        Ok(self.page + 1)
    }

    fn step(&mut self) -> Result<(), PageFault> {
        self.decoder.next_image()?;
        self.page += 1;
        Ok(())
    }

    /// Goes on to page `page`; `None` when the decoder is beyond it.
    pub fn forward(mut self, page: usize) -> Result<Option<Pages>, PageFault> {
        while self.page < page {
            self.step()?;
        }
        Ok((self.page == page).then_some(self))
    }

    /// Width and height of the page.
    pub fn size(&mut self) -> Result<[usize; 2], DecodeError> {
        let (width, height) = self.decoder.dimensions().map_err(fault)?;
        Ok([width as usize, height as usize])
    }

    /// The pixels of the page. Its size is checked before memory is taken.
    pub fn picture(&mut self) -> Result<Picture, DecodeError> {
        let [width, height] = self.size()?;
        check_size(width as u32, height as u32)?;
        let colour = self.decoder.colortype().map_err(fault)?;
        let (stored, used) = match colour {
            ColorType::Gray(_) => (1, 1),
            ColorType::GrayA(_) => (2, 1),
            ColorType::RGB(_) => (3, 3),
            ColorType::RGBA(_) => (4, 3),
            other => return Err(unsupported(&format!("its colours are {other:?}"))),
        };
        let planar: Option<u16> = self.decoder.find_tag_unsigned(Tag::PlanarConfiguration).map_err(fault)?;
        if stored > 1 && planar == Some(2) {
            return Err(unsupported("its colours are stored plane by plane"));
        }
        let mut pixels = DecodingResult::U8(Vec::new());
        self.decoder.read_image_to_buffer(&mut pixels).map_err(fault)?;
        let (format, bytes): (PixelFormat, Vec<u8>) = match pixels {
            DecodingResult::U8(values) if colour.bit_depth() == 8 => (PixelFormat::U8, values),
            DecodingResult::U16(values) => (PixelFormat::U16, values.iter().flat_map(|v| v.to_ne_bytes()).collect()),
            DecodingResult::F32(values) => (PixelFormat::F32, values.iter().flat_map(|v| v.to_ne_bytes()).collect()),
            _ => return Err(unsupported(&format!("its pixels have {} bits", colour.bit_depth()))),
        };
        if bytes.len() != width * height * stored * format.bytes_per_pixel() {
            return Err(unsupported("its rows are not stored pixel by pixel"));
        }
        Ok(Picture { size: [width, height], format, stored, used, bytes })
    }
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
        tiff::TiffError::FormatError(tiff::TiffFormatError::TiffSignatureNotFound) => DecodeError::UnknownKind,
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
