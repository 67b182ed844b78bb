//! Y4M (YUV4MPEG2) reader: luma planes of a header line followed by equally sized frames, each with its own header line.
//!
//! Luma is read as stored, 8 bit, or 9 to 16 bit in two little-endian bytes; chroma is skipped. Frames are found by walking
//! the file, so a video may be larger than memory.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};

use isophote_jit::PixelFormat;

use super::format::{Content, FolderPrecedence, Format, PageFault, Pages, Topics};
use crate::clock::Stamp;
use crate::picture::{DecodeError, StoredPicture, check_size};

/// Most bytes of the header line, and of a frame's header line.
const LINE_BYTES: [usize; 2] = [4096, 256];

const MAGIC: &[u8] = b"YUV4MPEG2";

pub(crate) const FORMAT: Format = Format {
    name: "Y4M",
    extensions: &["y4m"],
    signatures: &[MAGIC],
    content: Content::Pages {
        words: ["a Y4M video", "frames"],
        open: |file, _| Ok(Box::new(Video::open(file)?)),
        topics: Topics::One,
    },
    precedence: FolderPrecedence::Recordings,
};

/// Colour spaces: name prefix, chroma subsampling of width and height, and number of planes besides luma (alpha counts).
const SPACES: [(&str, [usize; 2], usize); 6] = [
    ("420", [2, 2], 2),
    ("411", [4, 1], 2),
    ("422", [2, 1], 2),
    ("444alpha", [1, 1], 3),
    ("444", [1, 1], 2),
    ("mono", [1, 1], 0),
];

/// An open video.
struct Video {
    file: File,
    file_bytes: u64,
    header: Header,
    /// Offset of each frame's pixels, as far as the file was walked.
    starts: Vec<u64>,
    /// Offset of the next frame's header line; `None` after the last.
    next: Option<u64>,
}

impl Video {
    /// Reads the header line.
    pub fn open(mut file: File) -> Result<Video, PageFault> {
        let file_bytes = file.metadata()?.len();
        let line = line(&mut file, 0, LINE_BYTES[0])?;
        if !line.bytes.starts_with(MAGIC) {
            return Err(DecodeError::UnknownKind.into());
        }
        if !line.is_whole {
            return Err(damaged("its first line does not end"));
        }
        let text =
            std::str::from_utf8(&line.bytes[MAGIC.len()..]).map_err(|_| damaged("its first line is not text"))?;
        let header = Header::parse(text)?;
        let next = Some(line.bytes.len() as u64 + 1);
        Ok(Video { file, file_bytes, header, starts: Vec::new(), next })
    }

    /// Walks the file up to `page`; false if there is no such frame.
    fn walk_to(&mut self, page: usize) -> Result<bool, PageFault> {
        while self.starts.len() <= page {
            let Some(at) = self.next.filter(|at| *at < self.file_bytes) else { return Ok(false) };
            let line = line(&mut self.file, at, LINE_BYTES[1])?;
            let is_frame = line.is_whole && (line.bytes == b"FRAME" || line.bytes.starts_with(b"FRAME "));
            // A frame with an invalid header line counts as a frame: reading it gives the error.
            let start = if is_frame { at + line.bytes.len() as u64 + 1 } else { self.file_bytes };
            self.starts.push(start);
            self.next = is_frame.then_some(start + self.header.frame_bytes);
        }
        Ok(true)
    }
}

impl Pages for Video {
    fn count(&mut self, most: usize) -> Result<usize, PageFault> {
        self.walk_to(most)?;
        Ok(self.starts.len())
    }

    fn stamp(&self, number: usize) -> Option<Stamp> {
        self.header.period_s.map(|period_s| Stamp::Number { number, period_s })
    }

    fn size(&mut self, _: usize) -> Result<[usize; 2], PageFault> {
        Ok(self.header.size)
    }

    fn picture(&mut self, page: usize) -> Result<StoredPicture, PageFault> {
        if !self.walk_to(page)? {
            return Err(damaged(&format!("there is no frame {page}")));
        }
        let Header { size, format, frame_bytes, .. } = self.header;
        let start = self.starts[page];
        let left = self.file_bytes.saturating_sub(start);
        if left == 0 && self.next.is_none() && page + 1 == self.starts.len() {
            return Err(damaged(&format!("frame {page} does not begin with the line FRAME")));
        }
        if left < frame_bytes {
            return Err(damaged(&format!("frame {page} is cut off: {left} of its {frame_bytes} bytes are there")));
        }
        let mut bytes = vec![0; size[0] * size[1] * format.bytes_per_pixel()];
        self.file.seek(SeekFrom::Start(start))?;
        self.file.read_exact(&mut bytes)?;
        if format == PixelFormat::U16 {
            for value in bytes.chunks_exact_mut(2) {
                value.copy_from_slice(&u16::from_le_bytes([value[0], value[1]]).to_ne_bytes());
            }
        }
        Ok(StoredPicture { size, format, stored: 1, used: 1, bytes })
    }
}

/// Parsed header line.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Header {
    size: [usize; 2],
    format: PixelFormat,
    /// Bytes of all planes.
    frame_bytes: u64,
    /// Frame interval, s; `None` if the rate is missing or 0.
    period_s: Option<f64>,
}

impl Header {
    fn parse(text: &str) -> Result<Header, DecodeError> {
        let (mut sides, mut space, mut period_s) = ([0; 2], "420", None);
        for field in text.split_ascii_whitespace() {
            let (tag, value) = field.split_at_checked(1).unwrap_or(("", field));
            match tag {
                "W" | "H" => {
                    let side = value.parse::<u32>().ok().filter(|side| *side > 0);
                    let reason = || format!("its first line says {field}, which is no size");
                    sides[usize::from(tag == "H")] = side.ok_or_else(|| DecodeError::Damaged(reason()))?;
                }
                "C" => space = value,
                "F" => period_s = period_of(value),
                _ => {}
            }
        }
        let [width, height] = sides;
        if width == 0 || height == 0 {
            return Err(DecodeError::Damaged("its first line does not name width (W) and height (H)".into()));
        }
        check_size(width, height)?;
        let size = [width as usize, height as usize];
        let unknown = || {
            DecodeError::Unsupported(format!(
                "its colour space is C{}; Y4M is read with C420, C411, C422, C444, C444alpha or Cmono, of 8 to 16 bits",
                shortened(space)
            ))
        };
        let (chroma, format) = space_of(space).ok_or_else(unknown)?;
        let ([across, down], planes) = chroma;
        let samples = size[0] * size[1] + planes * size[0].div_ceil(across) * size[1].div_ceil(down);
        Ok(Header { size, format, frame_bytes: (samples * format.bytes_per_pixel()) as u64, period_s })
    }
}

/// Frame interval of a rate given as a fraction.
fn period_of(rate: &str) -> Option<f64> {
    let (frames, seconds) = rate.split_once(':')?;
    let (frames, seconds) = (frames.parse::<u32>().ok()?, seconds.parse::<u32>().ok()?);
    (frames > 0 && seconds > 0).then(|| f64::from(seconds) / f64::from(frames))
}

/// Chroma layout and pixel format; `None` for an unknown name.
fn space_of(name: &str) -> Option<(([usize; 2], usize), PixelFormat)> {
    let (head, parts, planes) = SPACES.iter().find(|(head, ..)| name.starts_with(head))?;
    let rest = &name[head.len()..];
    let format = match rest {
        // Chroma siting suffixes.
        "" => PixelFormat::U8,
        "jpeg" | "mpeg2" | "paldv" if *head == "420" => PixelFormat::U8,
        _ => {
            let bits = if *head == "mono" { rest } else { rest.strip_prefix('p')? };
            match bits.parse::<u32>().ok()? {
                8 => PixelFormat::U8,
                9..=16 => PixelFormat::U16,
                _ => return None,
            }
        }
    };
    Some(((*parts, *planes), format))
}

/// A line of at most `most` bytes.
struct Line {
    bytes: Vec<u8>,
    is_whole: bool,
}

fn line(file: &mut File, at: u64, most: usize) -> Result<Line, PageFault> {
    let mut bytes = Vec::new();
    file.seek(SeekFrom::Start(at))?;
    file.by_ref().take(most as u64).read_to_end(&mut bytes)?;
    let end = bytes.iter().position(|byte| *byte == b'\n');
    bytes.truncate(end.unwrap_or(bytes.len()));
    Ok(Line { bytes, is_whole: end.is_some() })
}

fn damaged(reason: &str) -> PageFault {
    PageFault::Wrong(DecodeError::Damaged(reason.into()))
}

/// At most 20 characters of the file's text, for an error message.
fn shortened(text: &str) -> String {
    text.chars().take(20).map(|c| if c.is_control() { ' ' } else { c }).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// Frames of 5 × 3 pixels.
    #[test]
    fn colour_spaces_determine_the_frame_size() {
        for (space, bytes, format) in [
            ("", 15 + 2 * 6, PixelFormat::U8),
            ("C420jpeg", 15 + 2 * 6, PixelFormat::U8),
            ("C420paldv", 15 + 2 * 6, PixelFormat::U8),
            ("C420p10", 2 * (15 + 2 * 6), PixelFormat::U16),
            ("C411", 15 + 2 * 6, PixelFormat::U8),
            ("C422", 15 + 2 * 9, PixelFormat::U8),
            ("C422p12", 2 * (15 + 2 * 9), PixelFormat::U16),
            ("C444", 45, PixelFormat::U8),
            ("C444p16", 90, PixelFormat::U16),
            ("C444alpha", 60, PixelFormat::U8),
            ("Cmono", 15, PixelFormat::U8),
            ("Cmono16", 30, PixelFormat::U16),
        ] {
            let header = Header::parse(&format!(" W5 H3 F25:1 Ip A1:1 {space} XCOLORRANGE=FULL")).unwrap();
            let period_s = Some(0.04);
            assert_eq!(header, Header { size: [5, 3], format, frame_bytes: bytes, period_s }, "{space}");
        }
        for (rate, period_s) in [("F30000:1001", Some(1001.0 / 30000.0)), ("F0:0", None), ("F25", None), ("", None)] {
            assert_eq!(Header::parse(&format!(" W5 H3 {rate}")).unwrap().period_s, period_s, "{rate}");
        }
        for (text, words) in [
            (" W5 F25:1", "does not name width (W) and height (H)"),
            (" W5 H-3", "H-3, which is no size"),
            (" W0 H3", "W0, which is no size"),
            (" W40000 H1", "a side may have 32768 px"),
            (" W30000 H30000", "is more than the 67108864 px"),
            (" W5 H3 C420p17", "its colour space is C420p17; Y4M is read with"),
            (" W5 H3 C440", "C440"),
            (" W5 H3 Cmonojpeg", "Cmonojpeg"),
        ] {
            let error = Header::parse(text).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}
