//! Replacement of out-of-range pixels by NaN, which marks pixels without a value.

use std::borrow::Cow;

use isophote_jit::PixelFormat;

use crate::{Buffer, Frame, Plane};

impl Frame {
    /// Replaces values of magnitude above `largest`, infinities included, by NaN. Only floating-point planes are affected.
    pub fn within(&self, largest: f64) -> Cow<'_, Frame> {
        let rows = self.rows();
        let beyond = |plane: &Plane| beyond(plane, self.width(), rows, largest);
        if self.planes.iter().all(|plane| beyond(plane).is_empty()) {
            return Cow::Borrowed(self);
        }
        let found: Vec<Vec<usize>> = self.planes.iter().map(beyond).collect();
        let mut planes = self.planes.clone();
        for (plane, firsts) in self.planes.iter().zip(&found).filter(|(_, firsts)| !firsts.is_empty()) {
            // Planes that share a buffer keep sharing it, with the changes of earlier planes.
            let own = plane.buffer.bytes().as_ptr();
            let sharing = |other: &Plane| other.buffer.bytes().as_ptr() == own;
            let all: Vec<usize> = (0..planes.len()).filter(|index| sharing(&self.planes[*index])).collect();
            let Some(first) = all.first() else { continue };
            let mut bytes = planes[*first].buffer.bytes().to_vec();
            for at in firsts {
                match plane.format {
                    PixelFormat::U8 | PixelFormat::U16 => {}
                    PixelFormat::F32 => bytes[*at..at + 4].copy_from_slice(&f32::NAN.to_ne_bytes()),
                    PixelFormat::F64 => bytes[*at..at + 8].copy_from_slice(&f64::NAN.to_ne_bytes()),
                }
            }
            let buffer = Buffer::Owned(bytes.into());
            all.into_iter().for_each(|index| planes[index].buffer = buffer.clone());
        }
        Cow::Owned(Frame { planes, ..self.clone() })
    }
}

/// Byte offsets of such pixels in their buffer.
fn beyond(plane: &Plane, width: usize, rows: usize, largest: f64) -> Vec<usize> {
    match plane.format {
        PixelFormat::U8 | PixelFormat::U16 => Vec::new(),
        PixelFormat::F32 => firsts(plane, width, rows, |bytes| f64::from(f32::from_ne_bytes(bytes)).abs() > largest),
        PixelFormat::F64 => firsts(plane, width, rows, |bytes| f64::from_ne_bytes(bytes).abs() > largest),
    }
}

/// Expects a checked plane: all of its pixels are inside its buffer.
fn firsts<const BYTES: usize>(
    plane: &Plane,
    width: usize,
    rows: usize,
    is_meant: impl Fn([u8; BYTES]) -> bool,
) -> Vec<usize> {
    let mut found = Vec::new();
    for row in 0..rows {
        let first = plane.offset + row * plane.row_stride;
        let bytes = &plane.buffer.bytes()[first..][..(width - 1) * plane.pixel_stride + BYTES];
        for at in (0..width).map(|x| x * plane.pixel_stride) {
            if bytes[at..].first_chunk().is_some_and(|pixel| is_meant(*pixel)) {
                found.push(first + at);
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn infinite_pixels_become_nan() {
        let values = [1.0, f32::INFINITY, 3.0, f32::NEG_INFINITY, 5.0, f32::MAX];
        let buffer = Buffer::Owned(values.iter().flat_map(|value| value.to_ne_bytes()).collect::<Vec<u8>>().into());
        let planes = (0..2).map(|channel| Plane::interleaved(PixelFormat::F32, &buffer, 3, 2, channel)).collect();
        let frame = Frame::new(&[3, 1], planes).unwrap();
        let seen: Vec<f64> = (0..6).map(|i| frame.plane_view(i % 2).pixel(i / 2, 0)).collect();
        assert!(seen[1].is_nan() && seen[3].is_nan(), "{seen:?}");
        assert_eq!([seen[0], seen[2], seen[4], seen[5]], [1.0, 3.0, 5.0, f64::from(f32::MAX)]);
        let [first, second] = frame.planes() else { panic!("two planes") };
        assert_eq!(first.buffer.bytes().as_ptr(), second.buffer.bytes().as_ptr());
    }

    #[test]
    fn values_beyond_a_limit_become_nan() {
        let values = [1e16, -1e16, 1.1e16, -1e300, f64::NAN, 7.0];
        let bytes = values.iter().flat_map(|value| value.to_ne_bytes()).collect();
        let frame = Frame::new(&[3, 1, 2], vec![Plane::owned(PixelFormat::F64, bytes, 3)]).unwrap();
        let within = frame.within(1e16);
        let is_kept: Vec<bool> =
            (0..6).map(|i| !within.plane_view(0).pixel_at([i % 3, 0, i / 3, 0]).is_nan()).collect();
        assert_eq!(is_kept, [true, true, false, false, false, true]);
        assert!(matches!(frame.within(1e301), Cow::Borrowed(_)));
        let whole = Frame::new(&[2], vec![Plane::owned(PixelFormat::U8, vec![255; 2], 2)]).unwrap();
        assert!(matches!(whole.within(1.0), Cow::Borrowed(_)), "whole values always are values");
    }
}
