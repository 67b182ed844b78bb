//! The bytes of a TIFF file as its decoder has to see them.
//!
//! The decoder knows neither stacks of one directory nor bits in the other order, and inverts pictures whose white is 0. All three are
//! a matter of which bytes it reads.

use std::fs::File;
use std::io::{BufReader, Read, Result, Seek, SeekFrom};

/// A file with a few bytes read as others.
pub(super) struct TiffReader {
    file: BufReader<File>,
    at: u64,
    /// Added to every position: the frames behind the first of a stack with one directory lie so far behind it.
    pub shift: u64,
    /// The bits of each byte come in the other order.
    pub is_reversed: bool,
    /// This byte reads as 1.
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
