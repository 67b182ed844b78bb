//! The table of pixel formats, with their codes and layouts.

use isophote_frame::Frame;
use isophote_jit::PixelFormat;

use super::colour::Colour;
use super::error::PixelsError;
use super::layout::PixelLayout;
use super::{convert, jpeg};
use crate::limits::LIMITS;

/// A supported camera pixel format, identified by its V4L2 four-character code.
///
/// Values of more than 8 bits are in the low bits of little-endian 16-bit words.
///
/// ```
/// use isophote_capture::{Colour, Encoding};
///
/// let yuyv = Encoding::of(*b"YUYV").ok_or("unknown")?;
/// let frame = yuyv.frame(&[10, 128, 20, 128, 0, 0, 30, 128, 40, 128, 0, 0], [2, 2], 6, Colour::All)?;
/// assert_eq!(frame.plane_view(0).pixel(1, 1), 40.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Encoding {
    fourcc: [u8; 4],
    bits: u32,
    layout: PixelLayout,
}

const fn row(fourcc: &[u8; 4], bits: u32, layout: PixelLayout) -> Encoding {
    Encoding { fourcc: *fourcc, bits, layout }
}

const RGGB: PixelLayout = PixelLayout::Mosaic { red: [0, 0] };
const GRBG: PixelLayout = PixelLayout::Mosaic { red: [1, 0] };
const GBRG: PixelLayout = PixelLayout::Mosaic { red: [0, 1] };
const BGGR: PixelLayout = PixelLayout::Mosaic { red: [1, 1] };

/// All formats in order of preference for photometry; see [`Encoding::all`].
const TABLE: [Encoding; 28] = [
    row(b"Y16 ", 16, PixelLayout::Grey),
    row(b"Y12 ", 12, PixelLayout::Grey),
    row(b"Y10 ", 10, PixelLayout::Grey),
    row(b"GREY", 8, PixelLayout::Grey),
    row(b"YUYV", 8, PixelLayout::Packed { luma: 0 }),
    row(b"UYVY", 8, PixelLayout::Packed { luma: 1 }),
    row(b"NV12", 8, PixelLayout::Planar { chroma: 1 }),
    row(b"YU12", 8, PixelLayout::Planar { chroma: 2 }),
    row(b"RGB3", 8, PixelLayout::Rgb { red: 0 }),
    row(b"BGR3", 8, PixelLayout::Rgb { red: 2 }),
    row(b"RG16", 16, RGGB),
    row(b"GR16", 16, GRBG),
    row(b"GB16", 16, GBRG),
    row(b"BYR2", 16, BGGR),
    row(b"RG12", 12, RGGB),
    row(b"BA12", 12, GRBG),
    row(b"GB12", 12, GBRG),
    row(b"BG12", 12, BGGR),
    row(b"RG10", 10, RGGB),
    row(b"BA10", 10, GRBG),
    row(b"GB10", 10, GBRG),
    row(b"BG10", 10, BGGR),
    row(b"RGGB", 8, RGGB),
    row(b"GRBG", 8, GRBG),
    row(b"GBRG", 8, GBRG),
    row(b"BA81", 8, BGGR),
    row(b"MJPG", 8, PixelLayout::Jpeg),
    row(b"JPEG", 8, PixelLayout::Jpeg),
];

impl Encoding {
    /// All formats, in order of preference for photometry.
    ///
    /// Grey sensors come first: each pixel is one count at its position; deeper formats precede shallower ones, so that
    /// rounding stays below the noise. Uncompressed luma follows, which the camera mixes from colours and gamma-corrects,
    /// but which needs no conversion; then r, g, b, the same with more bytes. Mosaics are raw counts as well, but each
    /// colour covers only a quarter or half of the pixels, and interpolation costs time. JPEG is last: it discards detail
    /// that a fit needs.
    pub fn all() -> impl Iterator<Item = Encoding> {
        TABLE.into_iter()
    }

    /// Looks up a four-character code; `None` if it is not supported.
    pub fn of(fourcc: [u8; 4]) -> Option<Encoding> {
        TABLE.into_iter().find(|encoding| encoding.fourcc == fourcc)
    }

    /// Its four-character code.
    pub fn fourcc(self) -> [u8; 4] {
        self.fourcc
    }

    /// The code without trailing blanks, for display: `GREY`, `Y10`.
    pub fn name(self) -> String {
        String::from_utf8_lossy(&self.fourcc).trim_end().to_string()
    }

    /// Whether pictures vary in size, in bytes.
    pub fn is_compressed(self) -> bool {
        self.layout == PixelLayout::Jpeg
    }

    /// Whether it is a colour mosaic.
    pub fn is_bayer(self) -> bool {
        matches!(self.layout, PixelLayout::Mosaic { .. })
    }

    /// Whether [`Encoding::frame`] supports `colour`: luma formats have no red, green and blue.
    pub fn has(self, colour: Colour) -> bool {
        colour == Colour::All
            || matches!(self.layout, PixelLayout::Mosaic { .. } | PixelLayout::Rgb { .. } | PixelLayout::Jpeg)
    }

    /// The largest value of a pixel.
    pub fn saturation(self) -> f64 {
        f64::from((1u32 << self.bits) - 1)
    }

    /// Pixel format of the planes.
    pub fn format(self) -> PixelFormat {
        if self.bits > 8 { PixelFormat::U16 } else { PixelFormat::U8 }
    }

    /// Planes per frame: 1 (grey, luma or one colour) or 3 (r, g, b).
    pub fn planes(self, colour: Colour) -> usize {
        match (self.layout, colour) {
            (PixelLayout::Mosaic { .. } | PixelLayout::Rgb { .. }, Colour::All) => 3,
            _ => 1,
        }
    }

    /// Width and height of the frames, px: a single colour of a mosaic has half the picture's sides.
    pub fn size(self, size: [usize; 2], colour: Colour) -> [usize; 2] {
        if self.is_bayer() && colour != Colour::All { size.map(|side| side / 2) } else { size }
    }

    /// Minimum bytes of a complete picture whose (first) plane has the row stride `stride`; 0 if compressed. The last row
    /// needs no padding.
    pub fn bytes_min(self, size: [usize; 2], stride: usize) -> usize {
        let [width, height] = size;
        let above = stride.saturating_mul(height.saturating_sub(1));
        match self.layout {
            PixelLayout::Jpeg => 0,
            PixelLayout::Planar { chroma } => {
                // Chroma sides are rounded up to cover odd sides.
                let (rows, apart) = (height.div_ceil(2), stride.div_ceil(2).saturating_mul(2 / chroma));
                let last = width.div_ceil(2) * (2 / chroma);
                let above = apart.saturating_mul((rows * chroma).saturating_sub(1));
                stride.saturating_mul(height).saturating_add(above).saturating_add(last)
            }
            _ => above.saturating_add(self.row_bytes(width)),
        }
    }

    /// Bytes of a row of the (first) plane, without padding.
    pub(crate) fn row_bytes(self, width: usize) -> usize {
        let each = match self.layout {
            PixelLayout::Grey | PixelLayout::Mosaic { .. } => self.format().bytes_per_pixel(),
            PixelLayout::Packed { .. } => 2,
            PixelLayout::Planar { .. } => 1,
            PixelLayout::Rgb { .. } => 3,
            PixelLayout::Jpeg => 0,
        };
        width.saturating_mul(each)
    }

    /// Converts a picture of `size` px to a frame. Trailing bytes are ignored; `stride` is unused for compressed formats.
    /// Pixels are copied once, unchanged, except for interpolated mosaics and JPEG.
    ///
    /// - A mosaic's gaps are interpolated from the nearest pixels of the colour (bilinear), with reflection at the edges. A
    ///   single colour is not interpolated: pixel (x, y) is the sensor's pixel (2x + a, 2y + b), where (a, b) is the
    ///   position of the colour in the 2 × 2 cell; of green, the one in red's row.
    /// - JPEG yields its stored luma, or with a single colour the decoder's r, g or b.
    ///
    /// # Errors
    /// If the size exceeds the limits, rows overlap, bytes are missing, the format lacks the colour, or a JPEG is damaged or
    /// has another size.
    pub fn frame(self, bytes: &[u8], size: [usize; 2], stride: usize, colour: Colour) -> Result<Frame, PixelsError> {
        self.check_size(size)?;
        if !self.has(colour) {
            return Err(PixelsError::NoColour { name: self.name() });
        }
        if self.is_compressed() {
            return jpeg::frame(bytes, size, colour);
        }
        let least = self.row_bytes(size[0]);
        if stride < least {
            return Err(PixelsError::Stride { name: self.name(), least, given: stride });
        }
        let expected = self.bytes_min(size, stride);
        let whole = bytes.get(..expected).ok_or(PixelsError::Short { expected, got: bytes.len() })?;
        let frame = convert::frame(self.layout, self.format(), whole, size, stride, colour)?;
        Ok(frame.with_largest(self.saturation()))
    }

    fn check_size(self, size: [usize; 2]) -> Result<(), PixelsError> {
        let least = if self.is_bayer() { 2 } else { 1 };
        let [width, height] = size.map(|side| side as u64);
        let reason = if width.min(height) < least {
            format!("a {} picture has at least {least} px on each side", self.name())
        } else if width.max(height) > u64::from(LIMITS.side_px) {
            format!("a side may have {} px", LIMITS.side_px)
        } else if width * height > LIMITS.frame_pixels {
            format!("a frame may have {} px", LIMITS.frame_pixels)
        } else {
            return Ok(());
        };
        Err(PixelsError::Size { size, reason })
    }
}
