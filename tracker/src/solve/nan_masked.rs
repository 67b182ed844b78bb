//! `NanMasked`: a copy of a picture with masked pixels as NaN; dilation of masks.

use isophote_jit::{PixelFormat, PlaneView};
use isophote_symbolic::Precision;

use crate::sight::view::View;

/// Dilates a mask by `radius` along both axes (a square structuring element).
pub(crate) fn dilated(mask: &[bool], width: usize, height: usize, radius: usize) -> Vec<bool> {
    let along = |mask: &[bool], step: usize, radius: usize| {
        let mut wider = mask.to_vec();
        for off in (1..=radius).map(|by| by * step) {
            wider[off..].iter_mut().zip(mask).for_each(|(wider, holds)| *wider |= *holds);
            wider.iter_mut().zip(&mask[off..]).for_each(|(wider, holds)| *wider |= *holds);
        }
        wider
    };
    let rows: Vec<bool> = mask.chunks(width).flat_map(|row| along(row, 1, radius.min(width))).collect();
    along(&rows, width, radius.min(height))
}

/// A copy of a view's window in f32, with NaN where masked. Pixels outside the window are not copied.
pub(crate) struct NanMasked {
    planes: Vec<Vec<u8>>,
    size: [usize; 2],
}

const BYTES: usize = PixelFormat::F32.bytes_per_pixel();

impl NanMasked {
    pub fn new(view: &View, mask: &[bool]) -> NanMasked {
        let [x0, y0, ..] = view.window.first();
        let [width, height, ..] = view.window.size();
        let size = [x0 + width, y0 + height];
        let copy = |plane: &PlaneView| {
            let mut bytes = vec![0; size[0] * size[1] * BYTES];
            for (pixel, is_blind) in mask.iter().enumerate() {
                let (x, y) = (x0 + pixel % width, y0 + pixel / width);
                let value = if *is_blind { f32::NAN } else { plane.pixel_at([x, y, 0, 0]) as f32 };
                let at = (y * size[0] + x) * BYTES;
                bytes[at..at + BYTES].copy_from_slice(&value.to_ne_bytes());
            }
            bytes
        };
        NanMasked { planes: view.planes.iter().map(copy).collect(), size }
    }

    /// The same window of the copy.
    pub fn view<'a>(&'a self, view: &View<'a>, precision: Precision) -> Option<View<'a>> {
        let [width, height] = self.size;
        let plane =
            |bytes: &'a Vec<u8>| PlaneView::new(PixelFormat::F32, bytes, width, height, width * BYTES, BYTES).ok();
        let planes = self.planes.iter().map(plane).collect::<Option<_>>()?;
        Some(view.with_planes(planes, precision))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dilation_is_square_and_does_not_wrap_around_rows() {
        let (width, height) = (20, 12);
        let mask: Vec<bool> = (0..width * height).map(|i| [3 * width + 19, 6 * width + 8].contains(&i)).collect();
        for (i, is_inside) in dilated(&mask, width, height, 2).into_iter().enumerate() {
            let is_near = |[x, y]: [usize; 2]| x.abs_diff(i % width) <= 2 && y.abs_diff(i / width) <= 2;
            assert_eq!(is_inside, is_near([19, 3]) || is_near([8, 6]), "{i}");
        }
    }
}
