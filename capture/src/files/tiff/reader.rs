//! Presents a TIFF file's bytes to the decoder with corrections.
//!
//! The decoder supports neither stacks of one directory nor reversed bit order, and it inverts pictures whose white is 0.
//! All three are corrected in the bytes it reads.

use std::fs::File;
use std::io::{BufReader, Read, Result, Seek, SeekFrom};

/// A file reader that alters some bytes.
pub(super) struct TiffReader {
    file: BufReader<File>,
    at: u64,
    /// Added to every absolute position: the offset of a frame from the first in a stack of one directory.
    pub shift: u64,
    /// Reverses the bits of each byte.
    pub is_reversed: bool,
    /// The byte at this position reads as 1.
    pub one_at: Option<u64>,
}

impl TiffReader {
    pub fn new(file: File) -> TiffReader {
        TiffReader { file: BufReader::new(file), at: 0, shift: 0, is_reversed: false, one_at: None }
    }
}

impl Read for TiffReader {
    fn read(&mut self, into: &mut [u8]) -> Result<usize> {
        let count = self.file.read(into)?;
        let read = &mut into[..count];
        if self.is_reversed {
            read.iter_mut().for_each(|byte| *byte = byte.reverse_bits());
        }
        let place = self.one_at.and_then(|one| usize::try_from(one.checked_sub(self.at)?).ok());
        if let Some(byte) = place.and_then(|place| read.get_mut(place)) {
            *byte = 1;
        }
        self.at += count as u64;
        Ok(count)
    }
}

impl Seek for TiffReader {
    fn seek(&mut self, to: SeekFrom) -> Result<u64> {
        let to = match to {
            SeekFrom::Start(place) => SeekFrom::Start(place.saturating_add(self.shift)),
            other => other,
        };
        self.at = self.file.seek(to)?;
        Ok(self.at.saturating_sub(self.shift))
    }
}
