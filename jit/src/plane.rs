//! Pixels in memory: what a kernel may read, checked once, so that the loop needs no checks.

use thiserror::Error;

/// How one pixel of a plane is stored; native byte order, any alignment.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum PixelFormat {
    /// 0 … 255
    U8,
    /// 0 … 65535
    U16,
    /// IEEE 754 single
    F32,
    /// IEEE 754 double
    F64,
}

impl PixelFormat {
    /// Every format.
    pub const ALL: [PixelFormat; 4] = [PixelFormat::U8, PixelFormat::U16, PixelFormat::F32, PixelFormat::F64];

    /// The size of one pixel.
    pub const fn bytes_per_pixel(self) -> usize {
        match self {
            PixelFormat::U8 => 1,
            PixelFormat::U16 => 2,
            PixelFormat::F32 => 4,
            PixelFormat::F64 => 8,
        }
    }
}

/// Why bytes are not a plane.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Error)]
pub enum PlaneError {
    /// No pixel at all.
    #[error("a plane needs at least one pixel, this one has {width} × {height}")]
    Empty {
        /// Pixels a row.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// A side beyond [`PlaneView::SIDE_MAX`].
    #[error("a plane of {width} × {height} px is too large, a side may have {} px", PlaneView::SIDE_MAX)]
    TooLarge {
        /// Pixels a row.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// The last pixel is not inside the bytes.
    #[error("{given} bytes are too few for {width} × {height} px at these strides")]
    TooShort {
        /// Pixels a row.
        width: usize,
        /// Rows.
        height: usize,
        /// Bytes handed in.
        given: usize,
    },
}

/// A rectangle of pixels inside `bytes`, which [`PlaneView::new`] has checked: pixel (x, y) starts at byte
/// `y · row_stride + x · pixel_stride`. Rows and pixels may overlap or interleave.
#[derive(Clone, Copy, Debug)]
pub struct PlaneView<'a> {
    format: PixelFormat,
    bytes: &'a [u8],
    width: usize,
    height: usize,
    row_stride: usize,
    pixel_stride: usize,
}

impl<'a> PlaneView<'a> {
    /// The longest side, px.
    pub const SIDE_MAX: usize = i32::MAX as usize;

    /// A plane of `width` × `height` pixels; strides in bytes.
    pub fn new(
        format: PixelFormat,
        bytes: &'a [u8],
        width: usize,
        height: usize,
        row_stride: usize,
        pixel_stride: usize,
    ) -> Result<PlaneView<'a>, PlaneError> {
        if width == 0 || height == 0 {
            return Err(PlaneError::Empty { width, height });
        }
        if width > Self::SIDE_MAX || height > Self::SIDE_MAX {
            return Err(PlaneError::TooLarge { width, height });
        }
        let rows = (height - 1).checked_mul(row_stride);
        let pixels = (width - 1).checked_mul(pixel_stride);
        let end = rows.zip(pixels).and_then(|(r, p)| r.checked_add(p)?.checked_add(format.bytes_per_pixel()));
        match end {
            Some(end) if end <= bytes.len() => Ok(PlaneView { format, bytes, width, height, row_stride, pixel_stride }),
            _ => Err(PlaneError::TooShort { width, height, given: bytes.len() }),
        }
    }

    /// How a pixel is stored.
    pub fn format(&self) -> PixelFormat {
        self.format
    }
    /// Pixels a row.
    pub fn width(&self) -> usize {
        self.width
    }
    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }
    /// Bytes from a pixel to the one below.
    pub fn row_stride(&self) -> usize {
        self.row_stride
    }
    /// Bytes from a pixel to the next of its row.
    pub fn pixel_stride(&self) -> usize {
        self.pixel_stride
    }
    /// True when the pixels of a row follow each other without gaps.
    pub fn is_packed(&self) -> bool {
        self.pixel_stride == self.format.bytes_per_pixel()
    }

    /// The value of pixel (x, y), exactly. Panics outside the plane, as a slice does.
    #[inline]
    pub fn pixel(&self, x: usize, y: usize) -> f64 {
        assert!(x < self.width && y < self.height, "pixel ({x}, {y}) of {} × {}", self.width, self.height);
        let bytes = &self.bytes[y * self.row_stride + x * self.pixel_stride..];
        match self.format {
            PixelFormat::U8 => f64::from(bytes[0]),
            PixelFormat::U16 => f64::from(u16::from_ne_bytes([bytes[0], bytes[1]])),
            PixelFormat::F32 => f64::from(f32::from_ne_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
            PixelFormat::F64 => {
                f64::from_ne_bytes([bytes[0], bytes[1], bytes[2], bytes[3], bytes[4], bytes[5], bytes[6], bytes[7]])
            }
        }
    }

    /// The part of the plane under `window`; `None` where the window leaves the plane or is empty.
    pub(crate) fn region(&self, window: Window) -> Option<Region<'a>> {
        if window.clipped(self.width, self.height)? != window {
            return None;
        }
        let first = window.y * self.row_stride + window.x * self.pixel_stride;
        Some(Region { plane: *self, first: &self.bytes[first..], window })
    }
}

/// A window that lies inside its plane, by construction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Region<'a> {
    plane: PlaneView<'a>,
    first: &'a [u8],
    window: Window,
}

impl<'a> Region<'a> {
    pub fn plane(&self) -> &PlaneView<'a> {
        &self.plane
    }
    pub fn window(&self) -> Window {
        self.window
    }
    /// The bytes from the window's first pixel on.
    pub fn first(&self) -> &'a [u8] {
        self.first
    }
}

/// A rectangle of pixels of an image, px; (x, y) is its top-left pixel.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Window {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Window {
    /// All of an image.
    pub fn whole(width: usize, height: usize) -> Window {
        Window { x: 0, y: 0, width, height }
    }

    /// The part inside an image of `width` × `height` pixels; `None` when no pixel is left.
    pub fn clipped(self, width: usize, height: usize) -> Option<Window> {
        let columns = self.x.saturating_add(self.width).min(width).checked_sub(self.x)?;
        let rows = self.y.saturating_add(self.height).min(height).checked_sub(self.y)?;
        (columns > 0 && rows > 0).then_some(Window { x: self.x, y: self.y, width: columns, height: rows })
    }

    /// How many pixels it has.
    pub fn pixels(self) -> usize {
        self.width * self.height
    }
}

impl From<Window> for isophote_symbolic::interpreter::Window {
    fn from(window: Window) -> Self {
        let Window { x, y, width, height } = window;
        Self { x, y, width, height }
    }
}
