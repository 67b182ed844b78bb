//! Replacement of defective pixels by the mean of others.

use std::sync::Arc;

use isophote_jit::{PixelFormat, PlaneView};

use crate::{Buffer, Frame, Plane};

/// A defective pixel and the pixels that replace it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mend {
    /// x, y.
    pub at: [usize; 2],
    /// x, y of the pixels whose mean replaces it, non-finite ones excluded; when empty the pixel stays as it is.
    pub from: Vec<[usize; 2]>,
}

impl Frame {
    /// A copy with mended pixels, in every slice of every plane. All places must lie inside the frame.
    pub fn mended(&self, mends: &[Mend]) -> Frame {
        let mut copies: Vec<(*const u8, Buffer)> = Vec::new();
        let mut planes = self.planes.clone();
        for (channel, plane) in planes.iter_mut().enumerate() {
            let bytes = plane.buffer.bytes();
            let known = copies.iter().position(|(first, _)| *first == bytes.as_ptr());
            let at = known.unwrap_or_else(|| {
                copies.push((bytes.as_ptr(), Buffer::Owned(bytes.into())));
                copies.len() - 1
            });
            if let Buffer::Owned(copy) = &mut copies[at].1
                && let Some(copy) = Arc::get_mut(copy)
            {
                mend(copy, plane, &self.plane_view(channel), self.sides(), mends);
            }
        }
        for plane in &mut planes {
            let own = plane.buffer.bytes().as_ptr();
            if let Some((_, copy)) = copies.iter().find(|(first, _)| *first == own) {
                plane.buffer = copy.clone();
            }
        }
        Frame { planes, ..self.clone() }
    }
}

/// Writes the means into a copy of the plane's bytes.
fn mend(copy: &mut [u8], plane: &Plane, view: &PlaneView, sides: [usize; 4], mends: &[Mend]) {
    let size = plane.format.bytes_per_pixel();
    for Mend { at: [x, y], from } in mends.iter().filter(|mend| !mend.from.is_empty()) {
        for slice in 0..sides[2] * sides[3] {
            let place = |x: usize, y: usize| [x, y, slice % sides[2], slice / sides[2]];
            let values = from.iter().map(|&[x, y]| view.pixel_at(place(x, y))).filter(|value| value.is_finite());
            let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
            // The mean of no values is NaN, like its neighbours.
            let mean: f64 = sum / count;
            let first = plane.offset + (slice * sides[1] + y) * plane.row_stride + x * plane.pixel_stride;
            let pixel = &mut copy[first..first + size];
            match plane.format {
                PixelFormat::U8 => pixel[0] = mean.round() as u8,
                PixelFormat::U16 => pixel.copy_from_slice(&(mean.round() as u16).to_le_bytes()),
                PixelFormat::F32 => pixel.copy_from_slice(&(mean as f32).to_le_bytes()),
                PixelFormat::F64 => pixel.copy_from_slice(&mean.to_le_bytes()),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn mended_pixel_is_the_mean_of_others_in_every_plane() {
        let buffer = Buffer::Owned((0..24).collect::<Vec<u8>>().into());
        let planes = (0..3).map(|channel| Plane::interleaved(PixelFormat::U8, &buffer, 4, 3, channel)).collect();
        let frame = Frame::new(&[4, 2], planes).unwrap().with_sequence(7);
        let mends = [Mend { at: [1, 0], from: vec![[0, 0], [3, 0], [1, 1]] }, Mend { at: [2, 1], from: Vec::new() }];
        let mended = frame.mended(&mends);
        assert_eq!(mended.sequence, 7);
        for channel in 0..3 {
            let (before, after) = (frame.plane_view(channel), mended.plane_view(channel));
            for (x, y) in (0..4).flat_map(|x| (0..2).map(move |y| (x, y))) {
                // (0 + 9 + 15)/3 = 8, and one more in each channel.
                let should = if (x, y) == (1, 0) { 8.0 + channel as f64 } else { before.pixel(x, y) };
                assert_eq!(after.pixel(x, y), should, "{channel}: {x}, {y}");
            }
        }
        let [first, second, ..] = mended.planes() else { panic!("three planes") };
        assert_eq!(first.buffer.bytes().as_ptr(), second.buffer.bytes().as_ptr());
    }

    #[test]
    fn every_format_and_every_slice_is_mended() {
        let values: [f64; 6] = [1.0, 100.0, 4.0, 8.0, 100.0, 13.0];
        for format in [PixelFormat::U8, PixelFormat::U16, PixelFormat::F32, PixelFormat::F64] {
            let mut bytes = Vec::new();
            values.iter().for_each(|value| match format {
                PixelFormat::U8 => bytes.push(*value as u8),
                PixelFormat::U16 => bytes.extend((*value as u16).to_ne_bytes()),
                PixelFormat::F32 => bytes.extend((*value as f32).to_ne_bytes()),
                PixelFormat::F64 => bytes.extend(value.to_ne_bytes()),
            });
            let frame = Frame::new(&[3, 1, 2], vec![Plane::owned(format, bytes, 3)]).unwrap();
            let mended = frame.mended(&[Mend { at: [1, 0], from: vec![[0, 0], [2, 0]] }]);
            let whole = matches!(format, PixelFormat::U8 | PixelFormat::U16);
            let seen: Vec<f64> = (0..6).map(|i| mended.plane_view(0).pixel_at([i % 3, 0, i / 3, 0])).collect();
            let means = if whole { [3.0, 11.0] } else { [2.5, 10.5] };
            assert_eq!(seen, [1.0, means[0], 4.0, 8.0, means[1], 13.0], "{format:?}");
        }
    }

    #[test]
    fn non_finite_pixels_are_excluded_from_the_mean() {
        let bytes = [f32::NAN, 9.0, 4.0, f32::INFINITY, 7.0].iter().flat_map(|value| value.to_le_bytes()).collect();
        let frame = Frame::new(&[5, 1], vec![Plane::owned(PixelFormat::F32, bytes, 5)]).unwrap();
        let mends =
            [Mend { at: [1, 0], from: vec![[0, 0], [2, 0], [3, 0]] }, Mend { at: [4, 0], from: vec![[0, 0], [3, 0]] }];
        let mended = frame.mended(&mends);
        assert_eq!(mended.plane_view(0).pixel(1, 0), 4.0);
        assert!(mended.plane_view(0).pixel(4, 0).is_nan());
    }
}
