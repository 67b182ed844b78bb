//! Stacks with a single directory: locates the pixels of the further pictures.
//!
//! ImageJ (above 4 GB) and tifffile (with `truncate`) write only the directory of the first picture. The description states
//! the number of pictures; their pixels are contiguous.

use std::io::Read;

use serde::Deserialize;
use tiff::TiffResult;
use tiff::decoder::Decoder;
use tiff::tags::{IfdPointer, Tag};

use super::pixels::fault;
use super::reader::TiffReader;
use crate::picture::DecodeError;

/// A budget: bytes of a description that are read; the number of pictures is in its first lines.
const DESCRIPTION_BYTES_MAX: u64 = 1 << 16;

/// Size of offsets and counts: four bytes, or eight in a BigTIFF.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum OffsetBytes {
    Four,
    Eight,
}

/// A stack whose only directory is that of the first picture.
pub(super) struct StackOfOneDirectory {
    pub pictures: u64,
    /// Per picture.
    bytes: u64,
    /// Offset of the first pixel; `end` bounds the pixels.
    start: u64,
    end: u64,
}

impl StackOfOneDirectory {
    /// Offset of a picture's pixels from those of the first.
    pub fn shift(&self, number: u64) -> Result<u64, DecodeError> {
        let shift = number.checked_mul(self.bytes);
        let left = shift.and_then(|shift| self.end.checked_sub(self.start.checked_add(shift)?)).unwrap_or(0);
        shift.filter(|_| left >= self.bytes).ok_or_else(|| {
            DecodeError::Damaged(format!(
                "its ImageDescription says that there are {} pictures behind one directory, but picture {number} is cut off: \
                 {left} of its {} bytes are there",
                self.pictures, self.bytes
            ))
        })
    }
}

/// The stack that the only directory's ImageDescription declares; `None` for a single picture.
pub(super) fn stack(
    decoder: &mut Decoder<TiffReader>,
    offsets: OffsetBytes,
    file_bytes: u64,
) -> Result<Option<StackOfOneDirectory>, DecodeError> {
    let read = |decoder: &mut Decoder<TiffReader>, tag| decoder.find_tag_unsigned_vec::<u64>(tag).map_err(fault);
    let Some(description) = description(decoder, offsets).map_err(fault)? else { return Ok(None) };
    let (width, height) = decoder.dimensions().map_err(fault)?;
    let first = |numbers: Option<Vec<u64>>| numbers.and_then(|numbers| numbers.first().copied()).unwrap_or(1);
    let samples = first(read(decoder, Tag::SamplesPerPixel)?).saturating_mul(u64::from(width) * u64::from(height));
    let Some(pictures) = stated(&description, samples).filter(|pictures| *pictures > 1) else { return Ok(None) };
    let bytes = samples.saturating_mul(first(read(decoder, Tag::BitsPerSample)?)).div_ceil(8);
    let starts = read(decoder, Tag::StripOffsets)?.unwrap_or_default();
    let lengths = read(decoder, Tag::StripByteCounts)?.unwrap_or_default();
    let follow = starts.windows(2).zip(&lengths).all(|(pair, length)| pair[0].checked_add(*length) == Some(pair[1]));
    let is_raw = first(read(decoder, Tag::Compression)?) == 1;
    let (Some(start), true, true) = (starts.first().copied(), follow, is_raw) else {
        return Err(DecodeError::Unsupported(format!(
            "its ImageDescription says that there are {pictures} pictures, but it has one directory, and the pixels of that are \
             {}; save it uncompressed, or with a directory for each picture",
            if is_raw { "not in one piece" } else { "compressed" }
        )));
    };
    // The directory itself may follow the pixels.
    let directory = decoder.ifd_pointer().map(|pointer| pointer.0).filter(|at| *at > start);
    Ok(Some(StackOfOneDirectory { pictures, bytes, start, end: directory.unwrap_or(file_bytes).min(file_bytes) }))
}

/// Number of pictures that a description states, each of `samples` samples.
fn stated(description: &str, samples: u64) -> Option<u64> {
    #[derive(Deserialize)]
    struct Shaped {
        shape: Vec<u64>,
    }
    if description.starts_with("ImageJ=") {
        return description.lines().find_map(|line| line.strip_prefix("images=")?.trim().parse().ok());
    }
    let shape = serde_json::from_str::<Shaped>(description).ok()?.shape;
    let all = shape.iter().try_fold(1u64, |all, side| all.checked_mul(*side))?;
    all.checked_div(samples).filter(|pictures| pictures * samples == all)
}

/// Text of the description. The decoder itself rejects non-ASCII text, such as ImageJ's units.
fn description(decoder: &mut Decoder<TiffReader>, offsets: OffsetBytes) -> TiffResult<Option<String>> {
    let Some(entry) = entry(decoder, offsets, Tag::ImageDescription)? else { return Ok(None) };
    let (is_inside, mut at) = (entry.count <= if offsets == OffsetBytes::Eight { 8 } else { 4 }, entry.value);
    if !is_inside {
        decoder.goto_offset_u64(at)?;
        at = decoder.read_ifd_offset()?;
    }
    decoder.goto_offset_u64(at)?;
    let mut text = Vec::new();
    decoder.inner().take(entry.count.min(DESCRIPTION_BYTES_MAX)).read_to_end(&mut text)?;
    let text = text.split(|byte| *byte == 0).next().unwrap_or_default();
    Ok(Some(String::from_utf8_lossy(text).into_owned()))
}

/// A directory entry.
pub(super) struct DirectoryEntry {
    /// Field type of its values.
    pub kind: u16,
    count: u64,
    /// Offset of its value, or of the value's offset.
    pub value: u64,
}

/// Finds the entry of a tag in the decoder's current directory.
pub(super) fn entry(
    decoder: &mut Decoder<TiffReader>,
    offsets: OffsetBytes,
    tag: Tag,
) -> TiffResult<Option<DirectoryEntry>> {
    let Some(IfdPointer(directory)) = decoder.ifd_pointer() else { return Ok(None) };
    decoder.goto_offset_u64(directory)?;
    let (entries, [head, each, value]) = match offsets {
        OffsetBytes::Eight => (decoder.read_long8()?, [8, 20, 12]),
        OffsetBytes::Four => (decoder.read_short()?.into(), [2, 12, 8]),
    };
    for number in 0..entries.min(u64::from(u16::MAX)) {
        let at = directory.saturating_add(head + number * each);
        decoder.goto_offset_u64(at)?;
        if decoder.read_short()? == tag.to_u16() {
            let kind = decoder.read_short()?;
            let count = match offsets {
                OffsetBytes::Eight => decoder.read_long8()?,
                OffsetBytes::Four => decoder.read_long()?.into(),
            };
            return Ok(Some(DirectoryEntry { kind, count, value: at.saturating_add(value) }));
        }
    }
    Ok(None)
}
