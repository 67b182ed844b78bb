//! `Frame`: raw planes of one exposure, one to four dimensions, owned or leased from a driver; a [`PlaneView`] per
//! channel, without copies.
//!
//! Frames of more than two dimensions are stacks: their outer dimensions are rows.

mod mend;
mod number;
mod response;
mod unknown;

use std::borrow::Cow;
use std::fmt;
use std::sync::Arc;

use isophote_jit::{PixelFormat, PlaneError, PlaneView};

pub use mend::Mend;
pub use number::{LIGHT_MAX, NUMBER_MAX, plain};
pub use response::{CameraResponse, GainMap, Response, ResponseError};

/// Largest number of dimensions.
const DIMENSIONS_MAX: usize = 4;
/// Thousandths of red, green and blue in the luma of Rec. 601.
const LUMA: [u32; 3] = [299, 587, 114];

/// A buffer that returns to its owner on drop, e.g. to a driver's queue.
pub trait Lease: Send + Sync {
    /// The pixels; the same slice at every call.
    fn bytes(&self) -> &[u8];
}

/// Pixel memory; clones share it.
#[derive(Clone)]
pub enum Buffer {
    /// Own memory.
    Owned(Arc<[u8]>),
    /// Foreign memory, leased until all clones are dropped.
    Leased(Arc<dyn Lease>),
}

impl Buffer {
    /// The pixels.
    pub fn bytes(&self) -> &[u8] {
        match self {
            Buffer::Owned(bytes) => bytes,
            Buffer::Leased(lease) => lease.bytes(),
        }
    }
}

impl fmt::Debug for Buffer {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let kind = if matches!(self, Buffer::Owned(_)) { "Owned" } else { "Leased" };
        write!(f, "{kind}({} bytes)", self.bytes().len())
    }
}

/// One channel of a frame: the layout of its pixels in a buffer.
#[derive(Clone, Debug)]
pub struct Plane {
    /// Type of a pixel.
    pub format: PixelFormat,
    /// Bytes from a row to the next.
    pub row_stride: usize,
    /// Bytes from a pixel to the next: 3 for one channel of interleaved 8-bit RGB.
    pub pixel_stride: usize,
    /// Bytes before the first pixel.
    pub offset: usize,
    /// The buffer, possibly shared with other planes.
    pub buffer: Buffer,
}

impl Plane {
    /// A plane with its own buffer: rows of `width` pixels without gaps.
    pub fn owned(format: PixelFormat, bytes: Vec<u8>, width: usize) -> Plane {
        let pixel_stride = format.bytes_per_pixel();
        Plane { format, row_stride: width * pixel_stride, pixel_stride, offset: 0, buffer: Buffer::Owned(bytes.into()) }
    }

    /// Plane `channel` of `channels` interleaved ones without gaps between pixels or rows.
    pub fn interleaved(format: PixelFormat, buffer: &Buffer, width: usize, channels: usize, channel: usize) -> Plane {
        let pixel_stride = format.bytes_per_pixel() * channels;
        let offset = format.bytes_per_pixel() * channel;
        Plane { format, row_stride: width * pixel_stride, pixel_stride, offset, buffer: buffer.clone() }
    }

    /// Slices and volumes are contiguous rows.
    fn view(&self, sides: [usize; 4]) -> Result<PlaneView<'_>, PlaneError> {
        let bytes = self.buffer.bytes().get(self.offset..).unwrap_or(&[]);
        let slice = sides[1].saturating_mul(self.row_stride);
        let strides = [self.pixel_stride, self.row_stride, slice, sides[2].saturating_mul(slice)];
        PlaneView::stack(self.format, bytes, sides, strides)
    }
}

/// Why planes do not make a frame.
#[derive(Debug, thiserror::Error)]
pub enum FrameError {
    /// Invalid dimensions.
    #[error("a frame has one to {DIMENSIONS_MAX} dimensions, each of at least one pixel; this one has sizes {0:?}")]
    Size(Vec<usize>),
    /// No planes.
    #[error("a frame has at least one plane")]
    NoPlane,
    /// A plane's pixels are not all inside its buffer.
    #[error("plane {channel}: {source}")]
    Plane {
        /// Index of the plane.
        channel: usize,
        /// The fault.
        source: PlaneError,
    },
}

/// Raw planes of one exposure, all of one size.
#[derive(Clone, Debug)]
pub struct Frame {
    size: Vec<usize>,
    planes: Vec<Plane>,
    /// Frame number of the source; gaps are lost frames.
    pub sequence: u64,
    /// Capture time, CLOCK_MONOTONIC; `None` offline.
    pub capture_ns: Option<u64>,
    /// Capture time on the source's own clock, s, if it has one. Velocities are per second of this clock, however fast
    /// the frames are played.
    pub time_s: Option<f64>,
    /// Largest pixel value, where the source has a tighter limit than the format: 1023 of a camera of 10 bits.
    pub largest: Option<f64>,
    /// Names of the planes, if any: the columns of a table.
    names: Option<Arc<[String]>>,
}

impl Frame {
    /// A frame of `size` pixels, the inner dimension first. Infinite pixels become NaN.
    ///
    /// # Errors
    /// When there are no planes, no or too many dimensions, or a plane's pixels exceed its buffer.
    pub fn new(size: &[usize], planes: Vec<Plane>) -> Result<Frame, FrameError> {
        let rows = size.iter().skip(1).try_fold(1usize, |rows, &n| rows.checked_mul(n));
        if size.is_empty() || size.len() > DIMENSIONS_MAX || size.contains(&0) || rows.is_none() {
            return Err(FrameError::Size(size.to_vec()));
        }
        if planes.is_empty() {
            return Err(FrameError::NoPlane);
        }
        let size = size.to_vec();
        let frame = Frame { size, planes, sequence: 0, capture_ns: None, time_s: None, largest: None, names: None };
        for (channel, plane) in frame.planes.iter().enumerate() {
            plane.view(frame.sides()).map_err(|source| FrameError::Plane { channel, source })?;
        }
        match frame.within(f64::MAX) {
            Cow::Owned(within) => Ok(within),
            Cow::Borrowed(_) => Ok(frame),
        }
    }

    /// Sets the frame number.
    pub fn with_sequence(mut self, sequence: u64) -> Frame {
        self.sequence = sequence;
        self
    }

    /// Sets the capture time.
    pub fn with_capture_ns(mut self, capture_ns: Option<u64>) -> Frame {
        self.capture_ns = capture_ns;
        self
    }

    /// Sets the time on the source's own clock.
    pub fn with_time_s(mut self, time_s: Option<f64>) -> Frame {
        self.time_s = time_s;
        self
    }

    /// Sets the largest pixel value.
    pub fn with_largest(mut self, largest: f64) -> Frame {
        self.largest = Some(largest);
        self
    }

    /// Sets the names of the planes, one each; channels are then found by name only.
    pub fn with_names(mut self, names: Arc<[String]>) -> Frame {
        self.names = Some(names);
        self
    }

    /// Whether any buffer is leased.
    pub fn is_lent(&self) -> bool {
        self.planes.iter().any(|plane| matches!(plane.buffer, Buffer::Leased(_)))
    }

    /// A copy in own memory; leases end with the last clone of the other frames.
    pub fn owned(&self) -> Frame {
        let mut copies: Vec<(*const u8, Buffer)> = Vec::new();
        let mut frame = self.clone();
        for plane in frame.planes.iter_mut().filter(|plane| matches!(plane.buffer, Buffer::Leased(_))) {
            let bytes = plane.buffer.bytes();
            let known =
                copies.iter().find(|(first, copy)| *first == bytes.as_ptr() && copy.bytes().len() == bytes.len());
            let copy = known.map(|(_, copy)| copy.clone()).unwrap_or_else(|| Buffer::Owned(bytes.into()));
            copies.push((bytes.as_ptr(), copy.clone()));
            plane.buffer = copy;
        }
        frame
    }

    /// Names of the planes, if any.
    pub fn names(&self) -> Option<&[String]> {
        self.names.as_deref()
    }

    /// Indices of the planes of these channels: by name if planes have names, else by position. `None` when they do not match.
    pub fn planes_of(&self, channels: &[String]) -> Option<Vec<usize>> {
        match &self.names {
            Some(names) => channels.iter().map(|channel| names.iter().position(|name| name == channel)).collect(),
            None => (channels.len() == self.planes.len()).then(|| (0..channels.len()).collect()),
        }
    }

    /// Pixels along each dimension, inner first.
    pub fn size(&self) -> &[usize] {
        &self.size
    }

    /// Pixels along x, y, z and w; 1 for missing dimensions.
    pub fn sides(&self) -> [usize; 4] {
        std::array::from_fn(|axis| self.size.get(axis).copied().unwrap_or(1))
    }

    /// Pixels of a row.
    pub fn width(&self) -> usize {
        self.size[0]
    }

    /// Rows: the product of all dimensions but the inner one.
    pub fn rows(&self) -> usize {
        self.size[1..].iter().product()
    }

    /// The channels.
    pub fn planes(&self) -> &[Plane] {
        &self.planes
    }

    /// The pixels of a channel.
    ///
    /// # Panics
    /// When there is no such channel, as indexing does.
    pub fn plane_view(&self, channel: usize) -> PlaneView<'_> {
        let view = self.planes[channel].view(self.sides());
        view.expect("Frame::new made this very view, and a buffer's bytes stay the same")
    }

    /// Linearised: light in DN above black, as interleaved f32 planes; the size must match the response's gains. No
    /// clipped pixel is below `largest`.
    pub fn linear(&self, response: &Response) -> Frame {
        const BYTES: usize = PixelFormat::F32.bytes_per_pixel();
        let [width, height, depth, length] = self.sides();
        let channels = self.planes.len();
        let mut bytes = vec![0; width * height * depth * length * channels * BYTES];
        let mut light = vec![0.0; width];
        for channel in 0..channels {
            let view = self.plane_view(channel);
            for (row, into) in bytes.chunks_exact_mut(width * channels * BYTES).enumerate() {
                let place = [0, row % height, row / height % depth, row / height / depth];
                response.linear_row(&view, place, &mut light);
                into.chunks_exact_mut(channels * BYTES).zip(&light).for_each(|(pixel, light)| {
                    pixel[channel * BYTES..][..BYTES].copy_from_slice(&light.to_ne_bytes());
                });
            }
        }
        let buffer = Buffer::Owned(bytes.into());
        let plane = |channel| Plane::interleaved(PixelFormat::F32, &buffer, width, channels, channel);
        let largest = self.planes.iter().map(|plane| response.clipped(plane.format)).fold(f64::INFINITY, f64::min);
        Frame { planes: (0..channels).map(plane).collect(), largest: Some(largest), ..self.clone() }
    }

    /// The Rec. 601 luma `0.299 R + 0.587 G + 0.114 B` of a frame of three planes, in f32 (f64 from f64). Where all
    /// three planes are at their maximum, so is the luma. Frames with other numbers of planes, and named planes, are
    /// returned unchanged.
    pub fn luma(&self) -> Frame {
        if self.planes.len() != LUMA.len() || self.names.is_some() {
            return self.clone();
        }
        // The rows of a stack form one tall image.
        let tall = [self.width(), self.rows(), 1, 1];
        let views: Vec<PlaneView> = self.planes.iter().filter_map(|plane| plane.view(tall).ok()).collect();
        let (format, most) = match self.planes[0].format {
            PixelFormat::U8 => (PixelFormat::F32, Some(f64::from(u8::MAX))),
            PixelFormat::U16 => (PixelFormat::F32, Some(f64::from(u16::MAX))),
            PixelFormat::F32 => (PixelFormat::F32, None),
            PixelFormat::F64 => (PixelFormat::F64, None),
        };
        let mut bytes = Vec::with_capacity(self.width() * self.rows() * format.bytes_per_pixel());
        for y in 0..self.rows() {
            if let Some(rows) = self.byte_rows(y) {
                append_luma(&mut bytes, rows, self.width());
                continue;
            }
            for x in 0..self.width() {
                let thousandths: f64 = LUMA.iter().zip(&views).map(|(n, view)| f64::from(*n) * view.pixel(x, y)).sum();
                let value = thousandths / 1000.0;
                match format {
                    PixelFormat::F64 => bytes.extend(value.to_ne_bytes()),
                    _ => bytes.extend((value as f32).to_ne_bytes()),
                }
            }
        }
        let planes = vec![Plane::owned(format, bytes, self.width())];
        Frame { planes, largest: self.largest.or(most), ..self.clone() }
    }

    /// Row `y` of three 8-bit planes, each with its pixel stride.
    fn byte_rows(&self, y: usize) -> Option<[(&[u8], usize); 3]> {
        let [r, g, b] = &self.planes[..] else { return None };
        let row = |plane: &Plane| plane.offset + y * plane.row_stride;
        let are_bytes = [r, g, b].iter().all(|plane| plane.format == PixelFormat::U8 && plane.pixel_stride > 0);
        are_bytes.then(|| [r, g, b].map(|plane| (&plane.buffer.bytes()[row(plane)..], plane.pixel_stride)))
    }
}

/// Luma of bytes in integer arithmetic, which is several times faster: live cameras wait for it.
fn append_luma(into: &mut Vec<u8>, rows: [(&[u8], usize); 3], width: usize) {
    let [r, g, b] = rows.map(|(bytes, stride)| bytes.iter().step_by(stride).take(width).map(|byte| u32::from(*byte)));
    let thousandths = r.zip(g).zip(b).map(|((r, g), b)| LUMA[0] * r + LUMA[1] * g + LUMA[2] * b);
    into.extend(thousandths.flat_map(|sum| (sum as f32 / 1000.0).to_ne_bytes()));
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::sync::atomic::{AtomicU32, Ordering};

    #[test]
    fn sizes_and_buffers_are_checked() {
        let plane = |bytes: usize| vec![Plane::owned(PixelFormat::U8, vec![0; bytes], 3)];
        assert!(Frame::new(&[3, 2], plane(6)).is_ok());
        assert!(Frame::new(&[3, 2], plane(5)).is_err());
        assert!(Frame::new(&[3], plane(3)).is_ok());
        assert!(Frame::new(&[3, 2, 2, 2], plane(24)).is_ok());
        assert!(Frame::new(&[3, 2, 2, 2], plane(23)).is_err());
        for size in [&[][..], &[0], &[3, 0], &[1, 1, 1, 1, 1], &[1, usize::MAX, 2]] {
            assert!(matches!(Frame::new(size, plane(6)), Err(FrameError::Size(_))), "{size:?}");
        }
        assert!(matches!(Frame::new(&[3, 2], vec![]), Err(FrameError::NoPlane)));
        let mut shifted = plane(6);
        shifted[0].offset = 7;
        assert!(Frame::new(&[3, 2], shifted).is_err());
    }

    #[test]
    fn luma_of_interleaved_colour() {
        let buffer = Buffer::Owned(vec![255, 255, 255, 255, 0, 0, 0, 100, 200].into());
        let planes = (0..3).map(|channel| Plane::interleaved(PixelFormat::U8, &buffer, 3, 3, channel)).collect();
        let frame = Frame::new(&[3, 1], planes).unwrap().with_sequence(7);
        let luma = frame.luma();
        assert_eq!(luma.planes().len(), 1);
        let found = |frame: &Frame| (0..3).map(|x| frame.plane_view(0).pixel(x, 0)).collect::<Vec<_>>();
        let expected = [255.0, 76.245, 81.5].map(|value: f32| f64::from(value));
        assert_eq!((found(&luma), luma.largest), (expected.to_vec(), Some(255.0)));
        assert_eq!(luma.sequence, 7);
        assert_eq!(found(&luma.luma()), expected);
    }

    #[test]
    fn frames_of_every_layout_are_linearised() {
        let gains = [1.0, 1.1, 0.9, 1.0, 1.05, 0.95];
        let document = CameraResponse { gamma: 0.45, gains: Some(GainMap::of(3, 2, &gains)) };
        let camera = Response::new(16.0, Some(255.0), &document).unwrap();
        let values = [16u8, 20, 100, 200, 254, 255];
        let words: Vec<u8> = values.iter().flat_map(|value| u16::from(*value).to_ne_bytes()).collect();
        let floats: Vec<u8> = values.iter().flat_map(|value| f32::from(*value).to_ne_bytes()).collect();
        let twice: Vec<u8> = values.iter().flat_map(|value| [*value, *value]).collect();
        let interleaved = Plane { pixel_stride: 2, row_stride: 6, ..Plane::owned(PixelFormat::U8, twice, 3) };
        let planes = vec![
            Plane::owned(PixelFormat::U8, values.to_vec(), 3),
            Plane::owned(PixelFormat::U16, words, 3),
            Plane::owned(PixelFormat::F32, floats, 3),
            interleaved,
        ];
        let linear = Frame::new(&[3, 2], planes).unwrap().linear(&camera);
        for channel in 0..4 {
            for (place, (value, gain)) in values.iter().zip(gains).enumerate() {
                let light = linear.plane_view(channel).pixel(place % 3, place / 3);
                let expected = camera.light(f64::from(*value)) / gain;
                // Steps of the map are 0.1 / 127.
                assert!((light - expected).abs() <= 5e-4 * expected, "{channel} {place}: {light}, {expected}");
            }
        }
        // Every clipped pixel is at the limit, whatever its gain.
        let limit = linear.largest.unwrap();
        assert!((limit - camera.light(254.5) / 1.1).abs() < 1e-9 && camera.light(255.0) / 1.1 > limit);
        assert_eq!(document.check_size(&[3, 2, 5]), Ok(()));
        assert!(
            document
                .check_size(&[2, 3])
                .is_err_and(|error| error.to_string().contains("3 × 2 px, the frames are 2 × 3 px"))
        );
    }

    #[test]
    fn named_planes_are_found_by_name_only() {
        let named = |names: &[&str]| names.iter().map(|name| name.to_string()).collect::<Vec<_>>();
        let planes = || (0..3).map(|value| Plane::owned(PixelFormat::U8, vec![value], 1)).collect();
        let frame = Frame::new(&[1], planes()).unwrap();
        assert_eq!(frame.planes_of(&named(&["y", "x", "z"])), Some(vec![0, 1, 2]));
        assert_eq!(frame.planes_of(&named(&["y", "x"])), None);
        let frame = frame.with_names(named(&["y", "x", "w"]).into());
        assert_eq!(frame.planes_of(&named(&["x", "y"])), Some(vec![1, 0]));
        assert_eq!(frame.planes_of(&named(&["x", "y", "z"])), None);
        assert_eq!(frame.luma().planes().len(), 3);
    }

    #[test]
    fn a_stack_is_read_by_four_coordinates() {
        let plane = Plane::owned(PixelFormat::U8, (0..24).collect(), 3);
        let frame = Frame::new(&[3, 2, 2, 2], vec![plane]).unwrap();
        let view = frame.plane_view(0);
        assert_eq!((frame.sides(), view.size()), ([3, 2, 2, 2], [3, 2, 2, 2]));
        assert_eq!(
            (view.pixel_at([1, 0, 0, 0]), view.pixel_at([0, 1, 1, 0]), view.pixel_at([2, 1, 1, 1])),
            (1.0, 9.0, 23.0)
        );
        let colour = Frame::new(&[2, 1, 2], vec![Plane::owned(PixelFormat::U8, vec![7; 4], 2); 3]).unwrap();
        assert_eq!((colour.luma().size(), colour.luma().plane_view(0).pixel_at([1, 0, 1, 0])), (&[2, 1, 2][..], 7.0));
    }

    #[test]
    fn lease_ends_with_the_last_clone() {
        static RETURNED: AtomicU32 = AtomicU32::new(0);
        struct Loan(Vec<u8>);
        impl Lease for Loan {
            fn bytes(&self) -> &[u8] {
                &self.0
            }
        }
        impl Drop for Loan {
            fn drop(&mut self) {
                RETURNED.fetch_add(1, Ordering::SeqCst);
            }
        }
        let plane = Plane {
            format: PixelFormat::U16,
            row_stride: 6,
            pixel_stride: 2,
            offset: 1,
            buffer: Buffer::Leased(Arc::new(Loan((0..14).collect()))),
        };
        let frame = Frame::new(&[2, 2], vec![plane]).unwrap();
        assert_eq!(frame.plane_view(0).pixel(1, 1), f64::from(u16::from_le_bytes([9, 10])));
        let second = frame.clone();
        drop(frame);
        assert_eq!(RETURNED.load(Ordering::SeqCst), 0);
        let copy = second.owned();
        drop(second);
        assert_eq!(RETURNED.load(Ordering::SeqCst), 1);
        assert_eq!(copy.plane_view(0).pixel(1, 1), f64::from(u16::from_le_bytes([9, 10])));
    }
}
