//! TIFF reader and writer.
//!
//! Reads integers of 8, 16 and 32 bits and 16-, 32- and 64-bit float, gray or r, g, b (alpha is dropped), uncompressed or
//! with LZW, Deflate or PackBits. Reduced copies and masks are not pages; a stack with one directory has several pages.

mod pixels;
mod reader;
mod stack;

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{Cursor, Read, Seek};

use isophote_jit::PixelFormat;
use tiff::decoder::{Decoder, Limits};
use tiff::encoder::{TiffEncoder, colortype};
use tiff::tags::{ByteOrder, Tag};

use super::format::{Content, FolderPrecedence, Format, PageFault, Pages, Topics};
use crate::encode::EncodeError;
use crate::limits::LIMITS;
use crate::picture::{DecodeError, StoredPicture};

use pixels::fault;
use reader::TiffReader;
use stack::{OffsetBytes, StackOfOneDirectory};

pub(crate) const FORMAT: Format = Format {
    name: "TIFF",
    extensions: &["tif", "tiff"],
    // Little- and big-endian; classic TIFF and BigTIFF.
    signatures: &[b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"],
    content: Content::Pages {
        words: ["a TIFF", "pages"],
        open: |file, _| Ok(Box::new(Tiff::open(file)?)),
        topics: Topics::One,
    },
    precedence: FolderPrecedence::Pictures,
};

/// NewSubfileType bits for a reduced copy and for a mask; SubfileType of a copy; PhotometricInterpretation of a mask and of
/// white = 0.
const COPY_OR_MASK: u32 = 0b101;
const COPY: u32 = 2;
const MASK: u32 = 4;
const WHITE_IS_ZERO: u32 = 0;

/// An open TIFF file.
struct Tiff {
    file: File,
    offsets: OffsetBytes,
    /// Indices of the directories that are pictures.
    directories: Vec<usize>,
    /// Present if one directory describes several pictures.
    stack: Option<StackOfOneDirectory>,
    /// `None` after a failed seek: the decoder's position is then unknown.
    decoder: Option<Decoder<TiffReader>>,
}

impl From<tiff::TiffError> for PageFault {
    fn from(error: tiff::TiffError) -> PageFault {
        PageFault::Wrong(fault(error))
    }
}

impl Tiff {
    /// Reads the directories of a file.
    pub fn open(mut file: File) -> Result<Tiff, PageFault> {
        let file_bytes = file.metadata()?.len();
        let mut head = [0; 4];
        file.read_exact(&mut head)?;
        let offsets = if head.contains(&b'+') { OffsetBytes::Eight } else { OffsetBytes::Four };
        let mut decoder = decoder(&file)?;
        let directories = pictures(&mut decoder)?;
        if directories.is_empty() {
            let reason =
                "all its pages are smaller copies or masks of others (NewSubfileType); save the picture itself";
            return Err(DecodeError::Unsupported(reason.into()).into());
        }
        let mut tiff = Tiff { file, offsets, directories, stack: None, decoder: Some(decoder) };
        if let [only] = tiff.directories[..] {
            tiff.stack = stack::stack(tiff.at(only)?, offsets, file_bytes)?;
        }
        Ok(tiff)
    }

    /// Positions the decoder at a directory.
    fn at(&mut self, directory: usize) -> Result<&mut Decoder<TiffReader>, PageFault> {
        let mut decoder = self.decoder.take().map_or_else(|| decoder(&self.file), Ok)?;
        decoder.inner().one_at = None;
        decoder.seek_to_image(directory)?;
        // Values are read as stored: the decoder would invert them, so it is made to read BlackIsZero.
        if decoder.find_tag_unsigned(Tag::PhotometricInterpretation)? == Some(WHITE_IS_ZERO)
            && let Some(entry) = stack::entry(&mut decoder, self.offsets, Tag::PhotometricInterpretation)?
        {
            let bytes = match entry.kind {
                3 => 2, // SHORT
                4 => 4, // LONG
                _ => 1,
            };
            let low = if decoder.byte_order() == ByteOrder::BigEndian { bytes - 1 } else { 0 };
            decoder.inner().one_at = Some(entry.value + low);
            decoder.seek_to_image(directory)?;
        }
        Ok(self.decoder.insert(decoder))
    }

    /// Positions the decoder at a page's directory; also returns the offset of the page's pixels from those of the
    /// directory.
    fn at_page(&mut self, page: usize) -> Result<(&mut Decoder<TiffReader>, u64), PageFault> {
        let (directory, shift) = match &self.stack {
            Some(stack) => (self.directories.first(), stack.shift(page as u64)?),
            None => (self.directories.get(page), 0),
        };
        let directory = directory.ok_or_else(|| DecodeError::Damaged(format!("there is no page {page}")))?;
        Ok((self.at(*directory)?, shift))
    }
}

/// Only one decoder may exist at a time: cloned handles share the file position.
fn decoder(file: &File) -> Result<Decoder<TiffReader>, PageFault> {
    let mut file = file.try_clone()?;
    file.rewind()?;
    let mut limits = Limits::default();
    // One page: three channels of four bytes.
    limits.decoding_buffer_size = (LIMITS.frame_pixels * 12) as usize;
    limits.intermediate_buffer_size = limits.decoding_buffer_size;
    Ok(Decoder::new(TiffReader::new(file))?.with_limits(limits))
}

/// Indices of the directories that are neither copies nor masks. The decoder must be at the first.
fn pictures(decoder: &mut Decoder<TiffReader>) -> Result<Vec<usize>, PageFault> {
    let (mut pictures, mut seen, mut next) = (Vec::new(), BTreeSet::new(), decoder.ifd_pointer());
    while let Some(pointer) = next.filter(|_| pictures.len() <= LIMITS.files) {
        let number = seen.len();
        if !seen.insert(pointer.0) {
            return Err(DecodeError::Damaged("its chain of pages is a circle".into()).into());
        }
        let directory = decoder.read_directory(pointer)?;
        let mut tags = decoder.read_directory_tags(&directory);
        let new: Option<u32> = tags.find_tag_unsigned(Tag::NewSubfileType)?;
        let old: Option<u32> = tags.find_tag_unsigned(Tag::SubfileType)?;
        let photometric: Option<u32> = tags.find_tag_unsigned(Tag::PhotometricInterpretation)?;
        if new.unwrap_or(0) & COPY_OR_MASK == 0 && old != Some(COPY) && photometric != Some(MASK) {
            pictures.push(number);
        }
        next = directory.next();
    }
    Ok(pictures)
}

impl Pages for Tiff {
    fn count(&mut self, most: usize) -> Result<usize, PageFault> {
        let pictures = self.stack.as_ref().map_or(self.directories.len() as u64, |stack| stack.pictures);
        Ok(pictures.min(most as u64 + 1) as usize)
    }

    fn size(&mut self, page: usize) -> Result<[usize; 2], PageFault> {
        let (width, height) = self.at_page(page)?.0.dimensions()?;
        Ok([width as usize, height as usize])
    }

    fn picture(&mut self, page: usize) -> Result<StoredPicture, PageFault> {
        let (decoder, shift) = self.at_page(page)?;
        Ok(pixels::picture(decoder, shift)?)
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
