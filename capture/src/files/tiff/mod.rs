//! TIFF: pages in, pictures out, and the other way round.
//!
//! Integers of 8, 16 and 32 bits and 16, 32 and 64 bit float, gray or r, g, b (alpha is left out), uncompressed, LZW, Deflate or
//! PackBits. Smaller copies of pictures and masks are no pages; neither is a stack of one directory one page.

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

use super::format::{Beside, Content, Format, PageFault, Pages, Topics};
use crate::encode::EncodeError;
use crate::limits::LIMITS;
use crate::picture::{DecodeError, StoredPicture};

use pixels::fault;
use reader::TiffReader;
use stack::{OffsetBytes, StackOfOneDirectory};

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

/// Bits of NewSubfileType for a smaller copy of another picture and for a mask; SubfileType and PhotometricInterpretation for the same.
const COPY_OR_MASK: u32 = 0b101;
const COPY: u32 = 2;
const MASK: u32 = 4;
const WHITE_IS_ZERO: u32 = 0;

/// An open TIFF file.
struct Tiff {
    file: File,
    offsets: OffsetBytes,
    /// The numbers of the directories that are pictures.
    directories: Vec<usize>,
    /// Where there is one directory for several pictures.
    stack: Option<StackOfOneDirectory>,
    /// `None` after a page that could not be found: the decoder is at no known place then.
    decoder: Option<Decoder<TiffReader>>,
}

impl From<tiff::TiffError> for PageFault {
    fn from(error: tiff::TiffError) -> PageFault {
        PageFault::Wrong(fault(error))
    }
}

impl Tiff {
    /// Reads a file's directories.
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

    /// The decoder at a directory, by its number.
    fn at(&mut self, directory: usize) -> Result<&mut Decoder<TiffReader>, PageFault> {
        let mut decoder = self.decoder.take().map_or_else(|| decoder(&self.file), Ok)?;
        decoder.inner().one_at = None;
        decoder.seek_to_image(directory)?;
        // Values are taken as they are stored: the decoder, which would invert them, reads that 0 is black.
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

    /// The decoder at a page's directory, and how far behind the pixels of that those of the page lie.
    fn at_page(&mut self, page: usize) -> Result<(&mut Decoder<TiffReader>, u64), PageFault> {
        let (directory, shift) = match &self.stack {
            Some(stack) => (self.directories.first(), stack.shift(page as u64)?),
            None => (self.directories.get(page), 0),
        };
        let directory = directory.ok_or_else(|| DecodeError::Damaged(format!("there is no page {page}")))?;
        Ok((self.at(*directory)?, shift))
    }
}

/// One at a time: its place in the file is that of all.
fn decoder(file: &File) -> Result<Decoder<TiffReader>, PageFault> {
    let mut file = file.try_clone()?;
    file.rewind()?;
    let mut limits = Limits::default();
    // Of one page: three channels of four bytes.
    limits.decoding_buffer_size = (LIMITS.frame_pixels * 12) as usize;
    limits.intermediate_buffer_size = limits.decoding_buffer_size;
    Ok(Decoder::new(TiffReader::new(file))?.with_limits(limits))
}

/// The numbers of the directories that are neither copies of others nor masks. The decoder stands at the first.
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
