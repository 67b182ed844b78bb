//! Camera pixel formats, each against a picture packed by its definition.
#![allow(clippy::unwrap_used)]

mod blocks;
mod compressed;
mod mosaic;
mod packing;
mod refused;
mod uncompressed;

use isophote_tracker::Frame;

/// Deterministic pseudo-random numbers.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 >> 11
    }

    /// From 0 to `most`.
    fn to(&mut self, most: u64) -> u64 {
        self.next() % (most + 1)
    }

    fn pixels(&mut self, size: [usize; 2], most: u64) -> Vec<u16> {
        (0..size[0] * size[1]).map(|_| self.to(most) as u16).collect()
    }
}

/// Differences between a frame's plane and `pixels`: column, row, expected, found.
fn differences(frame: &Frame, plane: usize, pixels: &[u16]) -> Vec<(usize, usize, f64, f64)> {
    let (view, width) = (frame.plane_view(plane), frame.width());
    assert_eq!(pixels.len(), width * frame.rows());
    let expected = pixels.iter().enumerate().map(|(i, pixel)| (i % width, i / width, f64::from(*pixel)));
    expected.map(|(x, y, pixel)| (x, y, pixel, view.pixel(x, y))).filter(|(_, _, pixel, got)| pixel != got).collect()
}
