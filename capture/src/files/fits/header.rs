//! Parses FITS headers: locates the first image and reads its array layout and scaling.
//!
//! A header consists of blocks of 2880 bytes, each 36 cards of 80 characters; data follow, padded to a whole block, then the
//! next header (FITS standard 4.0, sections 3 and 4).

use std::io::{Read, SeekFrom};

use super::Source;
use crate::files::PageFault;
use crate::picture::DecodeError;

/// Signature of a FITS file.
pub(super) const FIRST: &[u8] = b"SIMPLE  =";

const BLOCK_BYTES: u64 = 2880;
const CARD_BYTES: usize = 80;
/// Limits on blocks per header, headers per file, and axes per array (the standard's bound).
const BLOCKS_MAX: u64 = 1024;
const HEADERS_MAX: usize = 4096;
const AXES_MAX: usize = 999;

/// Image layout and scaling from a header.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Header {
    /// Bits per stored number; negative for floating point.
    pub bitpix: i64,
    /// Length of each axis, the fastest-varying first.
    pub axes: Vec<u64>,
    /// A number's value is `zero + scale · stored`.
    pub zero: f64,
    /// See `zero`.
    pub scale: f64,
    /// Stored integer that marks an undefined value.
    pub blank: Option<i64>,
    /// Raw values of `BZERO`, `BSCALE` and `BLANK`, parsed only for images: elsewhere they may hold anything.
    scaling: [Option<Vec<u8>>; 3],
    kind: Kind,
    /// `PCOUNT`: further elements after the array; `groups` is `GCOUNT`, the number of repetitions.
    heap: u64,
    groups: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Image,
    /// A table whose cells are the tiles of a compressed image.
    Tiles,
    Other,
}

/// Finds the first image with pixels; returns its header and the offset of its data.
pub(crate) fn first_image(file: &mut dyn Source, file_bytes: u64) -> Result<(Header, u64), PageFault> {
    let mut at = 0;
    for number in 0..HEADERS_MAX {
        if at >= file_bytes {
            break;
        }
        let Some((mut header, start)) = header(file, at, number)? else { break };
        if header.kind == Kind::Image && !header.axes.is_empty() && !header.axes.contains(&0) {
            header.read_scaling()?;
            return Ok((header, start));
        }
        if header.kind == Kind::Tiles {
            let reason = "its image is compressed in tiles; unpack it first: funpack FILE";
            return Err(DecodeError::Unsupported(reason.into()).into());
        }
        at = header
            .data_bytes()
            .and_then(|bytes| start.checked_add(bytes.checked_next_multiple_of(BLOCK_BYTES)?))
            .ok_or_else(|| DecodeError::Damaged(format!("header {number} describes more data than there can be")))?;
    }
    let reason = "there is no image in it; FITS is read from the first header (or extension IMAGE) that has pixels";
    Err(DecodeError::Unsupported(reason.into()).into())
}

/// Parses header `number` at byte `at`; returns it with the offset of its data, or `None` if no further header begins there.
fn header(file: &mut dyn Source, at: u64, number: usize) -> Result<Option<(Header, u64)>, PageFault> {
    let mut header = Header {
        bitpix: 0,
        axes: Vec::new(),
        zero: 0.0,
        scale: 1.0,
        blank: None,
        scaling: [const { None }; 3],
        kind: Kind::Other,
        heap: 0,
        groups: 1,
    };
    file.seek(SeekFrom::Start(at))?;
    for block in 0..BLOCKS_MAX {
        let mut bytes = Vec::new();
        Read::take(&mut *file, BLOCK_BYTES).read_to_end(&mut bytes)?;
        if block == 0 {
            let first: &[u8] = if number == 0 { FIRST } else { b"XTENSION=" };
            match (bytes.starts_with(first), number) {
                (true, _) => {}
                (false, 0) => return Err(DecodeError::UnknownKind.into()),
                // Arbitrary bytes may follow the last array.
                (false, _) => return Ok(None),
            }
        }
        for card in bytes.chunks_exact(CARD_BYTES) {
            if card.starts_with(b"END     ") {
                return Ok(Some((header, at + (block + 1) * BLOCK_BYTES)));
            }
            header.read(card)?;
        }
        if bytes.len() < BLOCK_BYTES as usize {
            break;
        }
    }
    Err(DecodeError::Damaged(format!("header {number} has no END")).into())
}

impl Header {
    /// Applies a card if it describes the array.
    fn read(&mut self, card: &[u8]) -> Result<(), DecodeError> {
        let Some((name, value)) = card.split_at_checked(10).filter(|(name, _)| name.ends_with(b"= ")) else {
            return Ok(());
        };
        let (name, value) = (name[..8].trim_ascii_end(), value.trim_ascii());
        let name = std::str::from_utf8(name).unwrap_or_default();
        match name {
            "SIMPLE" => self.kind = Kind::Image,
            "XTENSION" if text(value) == b"IMAGE" => self.kind = Kind::Image,
            "ZIMAGE" if plain(value) == "T" => self.kind = Kind::Tiles,
            "BITPIX" => self.bitpix = integer(name, value)?,
            "NAXIS" => {
                let axes = natural(name, value)?;
                if axes > AXES_MAX as u64 {
                    return Err(wrong(name, value));
                }
                self.axes = vec![0; axes as usize];
            }
            "PCOUNT" => self.heap = natural(name, value)?,
            "GCOUNT" => self.groups = natural(name, value)?,
            "BZERO" => self.scaling[0] = Some(value.into()),
            "BSCALE" => self.scaling[1] = Some(value.into()),
            "BLANK" => self.scaling[2] = Some(value.into()),
            _ => {
                let axis = name.strip_prefix("NAXIS").and_then(|number| number.parse::<usize>().ok());
                if let Some(axis) = axis.and_then(|axis| self.axes.get_mut(axis.checked_sub(1)?)) {
                    *axis = natural(name, value)?;
                }
            }
        }
        Ok(())
    }

    /// Parses the scaling keywords. A keyword without a value counts as absent; floating point has no blank but NaN.
    fn read_scaling(&mut self) -> Result<(), DecodeError> {
        let [zero, scale, blank] =
            std::mem::take(&mut self.scaling).map(|value| value.filter(|value| !plain(value).is_empty()));
        if let Some(zero) = zero {
            self.zero = real("BZERO", &zero)?;
        }
        if let Some(scale) = scale {
            self.scale = real("BSCALE", &scale)?;
        }
        if let Some(blank) = blank.filter(|_| self.bitpix > 0) {
            self.blank = Some(integer("BLANK", &blank)?);
        }
        Ok(())
    }

    /// Data size without padding; `None` on overflow.
    fn data_bytes(&self) -> Option<u64> {
        if self.axes.is_empty() {
            return Some(0);
        }
        let numbers = self.axes.iter().try_fold(1u64, |product, axis| product.checked_mul(*axis))?;
        numbers.checked_add(self.heap)?.checked_mul(self.groups)?.checked_mul(self.bitpix.unsigned_abs() / 8)
    }
}

/// A non-string value, without the comment that follows it.
fn plain(value: &[u8]) -> &str {
    let end = value.iter().position(|byte| *byte == b'/').unwrap_or(value.len());
    std::str::from_utf8(value[..end].trim_ascii()).unwrap_or_default()
}

/// The text of a quoted string.
fn text(value: &[u8]) -> &[u8] {
    let inner = value.strip_prefix(b"'").unwrap_or_default();
    inner.split(|byte| *byte == b'\'').next().unwrap_or_default().trim_ascii_end()
}

fn integer(name: &str, value: &[u8]) -> Result<i64, DecodeError> {
    plain(value).parse().map_err(|_| wrong(name, value))
}

fn natural(name: &str, value: &[u8]) -> Result<u64, DecodeError> {
    plain(value).parse().map_err(|_| wrong(name, value))
}

/// Accepts FORTRAN exponents (1.5D3).
fn real(name: &str, value: &[u8]) -> Result<f64, DecodeError> {
    let number = plain(value).replace(['D', 'd'], "E").parse::<f64>();
    number.ok().filter(|number| number.is_finite()).ok_or_else(|| wrong(name, value))
}

fn wrong(name: &str, value: &[u8]) -> DecodeError {
    let shown: String = plain(value).chars().take(20).map(|c| if c.is_control() { ' ' } else { c }).collect();
    DecodeError::Damaged(format!("its header says {name} = {shown}"))
}
