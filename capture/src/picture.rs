//! `StoredPicture`, decoded pixels before they become a frame, and `DecodeError`.

use std::path::Path;

use isophote_jit::PixelFormat;

use crate::limits::LIMITS;
use crate::source::SourceError;

/// Why bytes cannot be decoded.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// Unknown format, neither PNG nor JPEG.
    #[error("not a PNG or JPEG image")]
    UnknownKind,
    /// Larger than the limits; nothing was decoded.
    #[error("{0}")]
    TooLarge(String),
    /// Valid, but of an unsupported kind.
    #[error("{0}")]
    Unsupported(String),
    /// Cannot be decoded completely.
    #[error("{0}")]
    Damaged(String),
}

impl DecodeError {
    /// The error for a file at `path`.
    pub(crate) fn in_file(self, path: &Path) -> SourceError {
        let path = path.to_path_buf();
        match self {
            DecodeError::UnknownKind => SourceError::UnknownKind { path },
            DecodeError::TooLarge(reason) => SourceError::TooLarge { path, reason },
            DecodeError::Damaged(reason) => SourceError::Damaged { path, reason },
            DecodeError::Unsupported(reason) => SourceError::Unsupported { path, reason },
        }
    }
}

/// Interleaved pixels, row by row.
pub(crate) struct StoredPicture {
    /// Width and height.
    pub size: [usize; 2],
    pub format: PixelFormat,
    /// Channels per pixel as stored.
    pub stored: usize,
    /// Channels used, the first ones: alpha is not.
    pub used: usize,
    pub bytes: Vec<u8>,
}

impl StoredPicture {
    /// Properties that pictures of one stack must share.
    pub fn kind(&self) -> ([usize; 2], PixelFormat, usize, usize) {
        (self.size, self.format, self.stored, self.used)
    }

    /// Description for messages.
    pub fn what(&self) -> String {
        let [width, height] = self.size;
        let colour = if self.used == 1 { "gray" } else { "colour" };
        let alpha = if self.stored > self.used { " with alpha" } else { "" };
        format!("{width}×{height} px of {}-bit {colour}{alpha}", 8 * self.format.bytes_per_pixel())
    }
}

/// Checks the size against the limits, before memory is allocated.
pub(crate) fn check_size(width: u32, height: u32) -> Result<(), DecodeError> {
    let pixels = u64::from(width) * u64::from(height);
    if width.max(height) > LIMITS.side_px {
        let limit = LIMITS.side_px;
        return Err(DecodeError::TooLarge(format!("{width}×{height} px; a side may have {limit} px")));
    }
    if pixels > LIMITS.frame_pixels {
        let limit = LIMITS.frame_pixels;
        return Err(DecodeError::TooLarge(format!(
            "{width}×{height} px is more than the {limit} px that a frame may have"
        )));
    }
    Ok(())
}
