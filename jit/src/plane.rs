//! Pixels in memory, bounds-checked once, so that the loop needs no checks.

pub use isophote_symbolic::interpreter::{Slices, Window};
use thiserror::Error;

/// The storage format of a pixel; native byte order, any alignment.
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
    /// No pixel.
    #[error("a plane needs at least one pixel, this one has {width} × {height}")]
    Empty {
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// A side beyond [`PlaneView::SIDE_MAX`].
    #[error("a plane of {width} × {height} px is too large, a side may have {} px", PlaneView::SIDE_MAX)]
    TooLarge {
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// The last pixel lies outside the bytes.
    #[error("{given} bytes are too few for {width} × {height} px at these strides")]
    TooShort {
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
        /// Bytes given.
        given: usize,
    },
}

/// Pixels inside `bytes`, checked by [`PlaneView::stack`]: pixel (x, y, z, w) starts at byte
/// `x · strides[0] + y · strides[1] + z · strides[2] + w · strides[3]`. An image is one slice of one volume. Rows, slices
/// and pixels may overlap or interleave.
#[derive(Clone, Copy, Debug)]
pub struct PlaneView<'a> {
    format: PixelFormat,
    bytes: &'a [u8],
    size: [usize; 4],
    strides: [usize; 4],
    /// Position of the first pixel in the image that windows refer to.
    origin: [usize; 4],
}

impl<'a> PlaneView<'a> {
    /// The longest side, px.
    pub const SIDE_MAX: usize = i32::MAX as usize;

    /// An image of `width` × `height` pixels; strides in bytes.
    pub fn new(
        format: PixelFormat,
        bytes: &'a [u8],
        width: usize,
        height: usize,
        row_stride: usize,
        pixel_stride: usize,
    ) -> Result<PlaneView<'a>, PlaneError> {
        Self::stack(format, bytes, [width, height, 1, 1], [pixel_stride, row_stride, 0, 0])
    }

    /// Pixels of four coordinates, the inner one first; strides in bytes.
    pub fn stack(
        format: PixelFormat,
        bytes: &'a [u8],
        size: [usize; 4],
        strides: [usize; 4],
    ) -> Result<PlaneView<'a>, PlaneError> {
        let (width, height) = (size[0], size[1..].iter().fold(1usize, |rows, n| rows.saturating_mul(*n)));
        if size.contains(&0) {
            return Err(PlaneError::Empty { width, height });
        }
        if size.iter().any(|side| *side > Self::SIDE_MAX) || height > Self::SIDE_MAX {
            return Err(PlaneError::TooLarge { width, height });
        }
        let last = size
            .iter()
            .zip(strides)
            .try_fold(0usize, |last, (n, stride)| (n - 1).checked_mul(stride)?.checked_add(last));
        match last.and_then(|last| last.checked_add(format.bytes_per_pixel())) {
            Some(end) if end <= bytes.len() => Ok(PlaneView { format, bytes, size, strides, origin: [0; 4] }),
            _ => Err(PlaneError::TooShort { width, height, given: bytes.len() }),
        }
    }

    /// Places the plane in a larger image, its first pixel at `origin`. Windows use the image's coordinates; all other
    /// accessors count from the plane's first pixel.
    pub fn placed(self, origin: [usize; 4]) -> PlaneView<'a> {
        PlaneView { origin, ..self }
    }

    /// The pixel format.
    pub fn format(&self) -> PixelFormat {
        self.format
    }
    /// Pixels along each coordinate.
    pub fn size(&self) -> [usize; 4] {
        self.size
    }
    /// Pixels per row.
    pub fn width(&self) -> usize {
        self.size[0]
    }
    /// Rows per slice.
    pub fn height(&self) -> usize {
        self.size[1]
    }
    /// Bytes from a pixel to the next along each coordinate.
    pub fn strides(&self) -> [usize; 4] {
        self.strides
    }
    /// Bytes from a row to the next.
    pub fn row_stride(&self) -> usize {
        self.strides[1]
    }
    /// Bytes from a pixel to the next of its row.
    pub fn pixel_stride(&self) -> usize {
        self.strides[0]
    }
    /// Whether the pixels of a row are contiguous.
    pub fn is_packed(&self) -> bool {
        self.strides[0] == self.format.bytes_per_pixel()
    }

    /// `count` 8-bit pixels of a row, starting at `place`; `None` for other formats, or if they are not contiguous or not all
    /// inside.
    pub fn bytes_of_row(&self, place: [usize; 4], count: usize) -> Option<&'a [u8]> {
        if self.format == PixelFormat::U8 { self.packed_row(place, count) } else { None }
    }

    /// Like [`PlaneView::bytes_of_row`] for 16-bit pixels, two bytes each.
    pub fn words_of_row(&self, place: [usize; 4], count: usize) -> Option<&'a [u8]> {
        if self.format == PixelFormat::U16 { self.packed_row(place, count) } else { None }
    }

    /// The bytes of `count` 8-bit pixels of a row, starting at `place`, up to the last pixel's, and the pixel stride; `None`
    /// for other formats, or if they are not all inside.
    pub fn spaced_bytes_of_row(&self, place: [usize; 4], count: usize) -> Option<(&'a [u8], usize)> {
        let first = self.first_of_row(place, count).filter(|_| self.format == PixelFormat::U8 && count > 0)?;
        Some((self.bytes.get(first..=first + (count - 1) * self.strides[0])?, self.strides[0]))
    }

    /// Byte offset of a row's pixels; `None` if they are not all inside.
    fn first_of_row(&self, place: [usize; 4], count: usize) -> Option<usize> {
        let inside = (0..4).all(|axis| place[axis] < self.size[axis]) && place[0] + count <= self.size[0];
        inside.then(|| place.iter().zip(self.strides).map(|(at, stride)| at * stride).sum())
    }

    fn packed_row(&self, place: [usize; 4], count: usize) -> Option<&'a [u8]> {
        let first = self.first_of_row(place, count).filter(|_| self.is_packed())?;
        self.bytes.get(first..first + count * self.format.bytes_per_pixel())
    }

    /// Position of its first pixel in the image: see [`PlaneView::placed`].
    pub fn origin(&self) -> [usize; 4] {
        self.origin
    }

    /// The value of pixel (x, y) of the first slice, exactly. Panics outside the plane, as a slice does.
    #[inline]
    pub fn pixel(&self, x: usize, y: usize) -> f64 {
        self.pixel_at([x, y, 0, 0])
    }

    /// The value of pixel (x, y, z, w), exactly. Panics outside the plane, as a slice does.
    #[inline]
    pub fn pixel_at(&self, place: [usize; 4]) -> f64 {
        let bytes = self.pixel_bytes(place);
        match self.format {
            PixelFormat::U8 => f64::from(bytes[0]),
            PixelFormat::U16 => f64::from(u16::from_ne_bytes([bytes[0], bytes[1]])),
            PixelFormat::F32 => f64::from(f32::from_ne_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
            PixelFormat::F64 => {
                f64::from_ne_bytes([bytes[0], bytes[1], bytes[2], bytes[3], bytes[4], bytes[5], bytes[6], bytes[7]])
            }
        }
    }

    /// The bytes of a pixel.
    ///
    /// # Panics
    /// If it is outside.
    pub fn pixel_bytes(&self, place: [usize; 4]) -> &'a [u8] {
        let [x, y, z, w] = place;
        let [width, height, depth, length] = self.size;
        assert!(x < width && y < height && z < depth && w < length, "pixel {place:?} of {:?}", self.size);
        let [across, down, slice, volume] = self.strides;
        &self.bytes[x * across + y * down + z * slice + w * volume..][..self.format.bytes_per_pixel()]
    }

    /// The part of the plane under `window`; `None` if the window leaves the plane or is empty.
    pub(crate) fn region(&self, window: Window) -> Option<Region<'_>> {
        let mut first = 0;
        for (axis, (at, count)) in window.first().into_iter().zip(window.size()).enumerate() {
            let at = at.checked_sub(self.origin[axis])?;
            if count == 0 || at.checked_add(count)? > self.size[axis] {
                return None;
            }
            first += at * self.strides[axis];
        }
        Some(Region { plane: self, first: &self.bytes[first..], window })
    }
}

/// A window that lies inside its plane, by construction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Region<'a> {
    plane: &'a PlaneView<'a>,
    first: &'a [u8],
    window: Window,
}

impl<'a> Region<'a> {
    pub fn plane(&self) -> &PlaneView<'a> {
        self.plane
    }
    pub fn window(&self) -> Window {
        self.window
    }
    /// The bytes from the window's first pixel on.
    pub fn first(&self) -> &'a [u8] {
        self.first
    }
}

/// A packed copy of a window's pixels with a minimum row length, padded with zeros.
pub(crate) struct Padded {
    bytes: Vec<u8>,
    strides: [usize; 4],
}

impl Padded {
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }
    pub fn strides(&self) -> [usize; 4] {
        self.strides
    }
}

impl Region<'_> {
    /// Copies the window's pixels into rows of at least `width_min`.
    pub fn padded(&self, width_min: usize) -> Padded {
        let pixel = self.plane.format.bytes_per_pixel();
        let [width, height, depth, length] = self.window.size();
        let row = width.max(width_min) * pixel;
        let strides = [pixel, row, height * row, depth * height * row];
        let mut bytes = vec![0; length * strides[3]];
        let [across, down, slice, volume] = self.plane.strides;
        for (number, copy) in bytes.chunks_mut(row).enumerate() {
            let (y, z, w) = (number % height, number / height % depth, number / (height * depth));
            let first = y * down + z * slice + w * volume;
            if across == pixel {
                copy[..width * pixel].copy_from_slice(&self.first[first..][..width * pixel]);
                continue;
            }
            for x in 0..width {
                let at = first + x * across;
                copy[x * pixel..][..pixel].copy_from_slice(&self.first[at..][..pixel]);
            }
        }
        Padded { bytes, strides }
    }
}
