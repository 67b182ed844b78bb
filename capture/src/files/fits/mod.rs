//! FITS reader: the first image with pixels, of two to four axes.
//!
//! Pixel values are `BZERO + BSCALE · stored`: unscaled bytes and unsigned 16 bit stay integers, all else becomes floating
//! point. The first row of the file is y = 0. Axis and unit keywords are ignored. If the header names a `BLANK`, blank
//! numbers become NaN. Gzip-compressed files are unpacked into memory.

mod header;

use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek, SeekFrom};

use flate2::read::MultiGzDecoder;
use isophote_jit::PixelFormat;

use super::format::{Content, FolderPrecedence, Format, PageFault, Pages, Topics};
use crate::limits::LIMITS;
use crate::picture::{DecodeError, StoredPicture, check_size};

use header::Header;

pub(crate) const FORMAT: Format = Format {
    name: "FITS",
    extensions: &["fits", "fit", "fts", "fits.gz", "fit.gz", "fts.gz"],
    signatures: &[header::FIRST, GZIP],
    content: Content::Pages {
        words: ["a FITS file", "pages"],
        open: |file, _| Ok(Box::new(Fits::open(file)?)),
        topics: Topics::One,
    },
    precedence: FolderPrecedence::Pictures,
};

/// `.fits.fz`: tile compression is rejected with a remedy; since it must be unpacked first, it does not count as a picture
/// in folders.
pub(crate) const PACKED: Format = Format { extensions: &["fz"], precedence: FolderPrecedence::Recordings, ..FORMAT };

/// Gzip signature.
const GZIP: &[u8] = b"\x1f\x8b";

/// A file, or its unpacked bytes.
trait Source: Read + Seek + Send {}

impl<T: Read + Seek + Send> Source for T {}

/// An open file.
struct Fits {
    file: Box<dyn Source>,
    file_bytes: u64,
    /// Offset of the pixels.
    start: u64,
    size: [usize; 2],
    pages: u64,
    /// Pages per volume, with four axes.
    volume: Option<u64>,
    numbers: Numbers,
}

impl Fits {
    /// Reads the headers up to the first image.
    pub fn open(mut file: File) -> Result<Fits, PageFault> {
        let mut first = Vec::new();
        (&mut file).take(GZIP.len() as u64).read_to_end(&mut first)?;
        file.rewind()?;
        let mut file: Box<dyn Source> =
            if first == GZIP { Box::new(Cursor::new(unpacked(file)?)) } else { Box::new(file) };
        let file_bytes = file.seek(SeekFrom::End(0))?;
        let (header, start) = header::first_image(&mut *file, file_bytes)?;
        let numbers = Numbers::of(&header)?;
        // Beyond the second, axes of length 1 are ignored.
        let counts = header.axes.iter().enumerate().filter(|(axis, length)| *axis < 2 || **length > 1);
        let axes: Vec<u64> = counts.map(|(_, length)| *length).collect();
        let (width, height, pages, volume) = match axes[..] {
            [width, height] => (width, height, 1, None),
            [width, height, pages] => (width, height, pages, None),
            [width, height, pages, volumes] => (width, height, pages.saturating_mul(volumes), Some(pages)),
            _ => return Err(unsupported(&axes).into()),
        };
        let [width, height] = [width, height].map(|side| u32::try_from(side).unwrap_or(u32::MAX));
        check_size(width, height)?;
        Ok(Fits { file, file_bytes, start, size: [width as usize, height as usize], pages, volume, numbers })
    }
}

/// Unpacks a gzip file.
fn unpacked(file: File) -> Result<Vec<u8>, DecodeError> {
    let (most, mut bytes) = (LIMITS.file_bytes, Vec::new());
    MultiGzDecoder::new(BufReader::new(file))
        .take(most + 1)
        .read_to_end(&mut bytes)
        .map_err(|error| DecodeError::Damaged(format!("gzip cannot unpack it: {error}")))?;
    match bytes.len() as u64 > most {
        true => {
            Err(DecodeError::TooLarge(format!("it unpacks to more than {most} bytes; unpack it first: gunzip FILE")))
        }
        false => Ok(bytes),
    }
}

fn unsupported(axes: &[u64]) -> DecodeError {
    let sides: Vec<String> = axes.iter().take(9).map(u64::to_string).collect();
    DecodeError::Unsupported(format!(
        "its image has {} axes ({}); FITS is read with two (a picture), three (pages) or four (volumes)",
        axes.len(),
        sides.join("×")
    ))
}

impl Pages for Fits {
    fn count(&mut self, most: usize) -> Result<usize, PageFault> {
        Ok(self.pages.min(most as u64 + 1) as usize)
    }

    fn volume(&self) -> Option<usize> {
        self.volume.map(|pages| pages as usize)
    }

    fn size(&mut self, _: usize) -> Result<[usize; 2], PageFault> {
        Ok(self.size)
    }

    fn picture(&mut self, page: usize) -> Result<StoredPicture, PageFault> {
        let page_bytes = self.size[0] * self.size[1] * self.numbers.bytes();
        let begin = (page_bytes as u64).checked_mul(page as u64).and_then(|before| before.checked_add(self.start));
        let left = begin.map_or(0, |begin| self.file_bytes.saturating_sub(begin));
        let Some(begin) = begin.filter(|_| left >= page_bytes as u64) else {
            let reason = format!("page {page} is cut off: {left} of its {page_bytes} bytes are there");
            return Err(DecodeError::Damaged(reason).into());
        };
        let mut bytes = vec![0; page_bytes];
        self.file.seek(SeekFrom::Start(begin))?;
        self.file.read_exact(&mut bytes)?;
        let (format, bytes) = self.numbers.pixels(bytes);
        Ok(StoredPicture { size: self.size, format, stored: 1, used: 1, bytes })
    }
}

/// Conversion of stored big-endian numbers to pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Numbers {
    /// Unsigned bytes, unchanged.
    U8,
    /// Signed 16 bit with an offset of 32768.
    U16,
    /// Integers, converted to the nearest f32.
    Integers {
        bytes: usize,
        zero: f64,
        scale: f64,
        blank: Option<i64>,
    },
    F32 {
        zero: f64,
        scale: f64,
    },
    F64 {
        zero: f64,
        scale: f64,
    },
}

impl Numbers {
    fn of(header: &Header) -> Result<Numbers, DecodeError> {
        let Header { bitpix, zero, scale, blank, .. } = *header;
        if scale == 0.0 {
            return Err(DecodeError::Damaged("its header says BSCALE = 0".into()));
        }
        Ok(match (bitpix, zero, scale, blank) {
            (8, 0.0, 1.0, None) => Numbers::U8,
            (16, 32768.0, 1.0, None) => Numbers::U16,
            (8 | 16 | 32, ..) => Numbers::Integers { bytes: bitpix as usize / 8, zero, scale, blank },
            (-32, ..) => Numbers::F32 { zero, scale },
            (-64, ..) => Numbers::F64 { zero, scale },
            _ => {
                let reason = format!("BITPIX is {bitpix}; FITS is read with 8, 16, 32, −32 or −64");
                return Err(DecodeError::Unsupported(reason));
            }
        })
    }

    /// Bytes per stored number.
    fn bytes(self) -> usize {
        match self {
            Numbers::U8 => 1,
            Numbers::U16 => 2,
            Numbers::Integers { bytes, .. } => bytes,
            Numbers::F32 { .. } => 4,
            Numbers::F64 { .. } => 8,
        }
    }

    fn pixels(self, stored: Vec<u8>) -> (PixelFormat, Vec<u8>) {
        match self {
            Numbers::U8 => (PixelFormat::U8, stored),
            Numbers::U16 => {
                let value = |v: &[u8]| (u16::from_be_bytes([v[0], v[1]]) ^ 0x8000).to_ne_bytes();
                (PixelFormat::U16, stored.chunks_exact(2).flat_map(value).collect())
            }
            Numbers::Integers { bytes, zero, scale, blank } => {
                let value = |v: &[u8]| match whole(v) {
                    whole if Some(whole) == blank => f32::NAN.to_ne_bytes(),
                    whole => ((zero + scale * whole as f64) as f32).to_ne_bytes(),
                };
                (PixelFormat::F32, stored.chunks_exact(bytes).flat_map(value).collect())
            }
            Numbers::F32 { zero, scale } => {
                let value = |v: &[u8]| {
                    let number = f32::from_be_bytes([v[0], v[1], v[2], v[3]]);
                    ((zero + scale * f64::from(number)) as f32).to_ne_bytes()
                };
                (PixelFormat::F32, stored.chunks_exact(4).flat_map(value).collect())
            }
            Numbers::F64 { zero, scale } => {
                let value = |v: &[u8]| {
                    let number = f64::from_be_bytes([v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7]]);
                    (zero + scale * number).to_ne_bytes()
                };
                (PixelFormat::F64, stored.chunks_exact(8).flat_map(value).collect())
            }
        }
    }
}

/// An integer of one byte (unsigned), two or four (signed).
fn whole(bytes: &[u8]) -> i64 {
    match *bytes {
        [a, b] => i16::from_be_bytes([a, b]).into(),
        [a, b, c, d] => i32::from_be_bytes([a, b, c, d]).into(),
        [a, ..] => a.into(),
        [] => 0,
    }
}
