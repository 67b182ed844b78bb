//! `PixelLayout`: how the bytes of a pixel format lie. Plain words, shared by the table of formats and by what converts them.

/// How the pixels of a picture lie in a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PixelLayout {
    /// One value for each pixel.
    Grey,
    /// Colour filters in front of a grey sensor; column and row of the red one among 2 × 2. Blue stands across from it.
    Mosaic { red: [usize; 2] },
    /// Luma and chroma take turns: byte `luma` of two is luma.
    Packed { luma: usize },
    /// A plane of luma; behind it chroma of 2 × 2 pixels each, in this number of planes.
    Planar { chroma: usize },
    /// Three bytes for each pixel; red is this one of them, blue the one across.
    Rgb { red: usize },
    /// A compressed picture.
    Jpeg,
}
