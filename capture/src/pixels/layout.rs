//! `PixelLayout`: byte layouts, shared by the format table and the conversions.

/// Layout of a picture's pixels in a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PixelLayout {
    /// One value per pixel.
    Grey,
    /// Bayer mosaic; column and row of red in the 2 × 2 cell. Blue is diagonally opposite.
    Mosaic { red: [usize; 2] },
    /// Alternating luma and chroma bytes: byte `luma` of each two is luma.
    Packed { luma: usize },
    /// A luma plane, followed by 2 × 2 subsampled chroma in this number of planes.
    Planar { chroma: usize },
    /// Three bytes per pixel; red is at this index, 0 or 2, blue at the other.
    Rgb { red: usize },
    /// A compressed picture.
    Jpeg,
}
