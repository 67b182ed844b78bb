//! `StoredPicture`: decoded pixels, before they are a frame; and why there are none.

use std::path::Path;

use isophote_jit::PixelFormat;

use crate::limits::LIMITS;
use crate::source::SourceError;

/// Why bytes are not a frame.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// Neither PNG nor JPEG.
    #[error("not a PNG or JPEG image")]
    UnknownKind,
    /// More pixels than the limits allow; nothing was decoded.
    #[error("{0}")]
    TooLarge(String),
    /// A sound file of a kind that is not read.
    #[error("{0}")]
    Unsupported(String),
    /// A file that cannot be decoded to its end.
    #[error("{0}")]
    Damaged(String),
}

impl DecodeError {
    /// The same of a file.
    pub(crate) fn about(self, path: &Path) -> SourceError {
        let path = path.to_path_buf();
        match self {
            DecodeError::UnknownKind => SourceError::UnknownKind { path },
            DecodeError::TooLarge(reason) => SourceError::TooLarge { path, reason },
            DecodeError::Damaged(reason) => SourceError::Damaged { path, reason },
            DecodeError::Unsupported(reason) => SourceError::Unsupported { path, reason },
        }
    }
}

/// Pixels side by side, row by row.
pub(crate) struct StoredPicture {
    /// Width and height.
    pub size: [usize; 2],
    pub format: PixelFormat,
    /// Channels of a pixel as stored, …
    pub stored: usize,
    /// … and the first of them that are used: alpha is not.
    pub used: usize,
    pub bytes: Vec<u8>,
}

impl StoredPicture {
    /// What pictures of one stack have in common.
    pub fn kind(&self) -> ([usize; 2], PixelFormat, usize, usize) {
        (self.size, self.format, self.stored, self.used)
    }

    /// For people.
    pub fn what(&self) -> String {
        let [width, height] = self.size;
        let colour = if self.used == 1 { "gray" } else { "colour" };
        let alpha = if self.stored > self.used { " with alpha" } else { "" };
        format!("{width}×{height} px of {}-bit {colour}{alpha}", 8 * self.format.bytes_per_pixel())
    }
}

/// Whether a frame may be as large, before memory is taken for it.
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
