//! `Inpainted`: a copy of a picture, in its own format, with masked outliers as gaps, so that the model's own kernels
//! can sum it.

use isophote_jit::{PlaneView, Window};

use crate::sight::view::View;

/// A copy of a window with masked pixels replaced by neighbours, and the mask.
pub(crate) struct Inpainted {
    planes: Vec<Vec<u8>>,
    mask: Vec<bool>,
    runs: Vec<Window>,
}

impl Inpainted {
    /// Copies a view without the masked pixels.
    pub fn of(view: &View, mask: Vec<bool>) -> Inpainted {
        let runs = runs(&mask, view.window);
        let planes = view.planes.iter().map(|plane| copied(plane, view.window, &runs)).collect();
        Inpainted { planes, mask, runs }
    }

    /// Whether it was made with this mask.
    pub fn has(&self, mask: &[bool]) -> bool {
        self.mask == mask
    }

    /// The masked pixels.
    pub fn mask(&self) -> &[bool] {
        &self.mask
    }

    /// The unmasked part of the view from which it was made.
    pub fn view<'a>(&'a self, view: &View<'a>) -> Option<View<'a>> {
        let Window { width, height, .. } = view.window;
        let plane = |(plane, bytes): (&PlaneView, &'a Vec<u8>)| {
            let stride = plane.pixel_stride();
            let copy = PlaneView::new(plane.format(), bytes, width, height, width * stride, stride).ok()?;
            Some(copy.placed(view.window.first()))
        };
        let planes = view.planes.iter().zip(&self.planes).map(plane).collect::<Option<_>>()?;
        let narrow = view.narrowed(view.window);
        let gaps = narrow.gaps.iter().chain(&self.runs).copied().collect();
        Some(View { planes, gaps, ..narrow })
    }
}

/// The masked pixels as horizontal runs.
fn runs(mask: &[bool], window: Window) -> Vec<Window> {
    let mut runs: Vec<Window> = Vec::new();
    for (row, pixels) in mask.chunks(window.width).enumerate() {
        let mut from = 0;
        for part in pixels.chunk_by(|a, b| a == b) {
            if part[0] {
                let (x, y) = (window.x + from, window.y + row);
                runs.push(Window { x, y, width: part.len(), height: 1, ..window });
            }
            from += part.len();
        }
    }
    runs
}

/// The window's pixels, with each run replaced by the pixel before it, or after it: gaps are summed and subtracted again,
/// so their values should be like their neighbours'.
fn copied(plane: &PlaneView, window: Window, runs: &[Window]) -> Vec<u8> {
    let (stride, bytes) = (plane.pixel_stride(), plane.format().bytes_per_pixel());
    let row_bytes = window.width * stride;
    let mut copy = vec![0; row_bytes * window.height];
    for y in 0..window.height {
        for x in 0..window.width {
            let at = y * row_bytes + x * stride;
            copy[at..at + bytes].copy_from_slice(plane.pixel_bytes([window.x + x, window.y + y, 0, 0]));
        }
    }
    for run in runs {
        let (row, first) = ((run.y - window.y) * row_bytes, run.x - window.x);
        let behind = first + run.width;
        let beside = if first > 0 { first - 1 } else { behind.min(window.width - 1) };
        for x in first..behind {
            let from = row + beside * stride;
            copy.copy_within(from..from + bytes, row + x * stride);
        }
    }
    copy
}

#[cfg(test)]
mod tests {
    use isophote_jit::PixelFormat;
    use isophote_symbolic::Precision;
    use smallvec::smallvec;

    use super::*;

    const SIDE: usize = 24;
    const BAD: usize = 16;

    /// The right half of a picture is dark but for a mended bad column; the window excludes the first three rows and
    /// columns.
    #[test]
    fn masked_pixels_become_gaps_with_neighbouring_values() {
        let bytes: Vec<u8> = (0..SIDE * SIDE).map(|i| if i % SIDE < 12 || i % SIDE == BAD { 100 } else { 3 }).collect();
        let plane = PlaneView::new(PixelFormat::U8, &bytes, SIDE, SIDE, SIDE, 1).expect("the buffer fits");
        let window = Window { x: 3, y: 3, width: SIDE - 3, height: SIDE - 3, ..Window::whole(SIDE, SIDE) };
        let mut view = View::new(vec![plane], window, smallvec![255.0], Precision::F32);
        view.gaps = vec![Window { x: BAD, y: 0, width: 1, height: SIDE, ..window }];
        let mask = (0..window.pixels()).map(|i| 3 + i % window.width >= 12 && 3 + i % window.width != BAD).collect();
        let inpainted = Inpainted::of(&view, mask);
        let rest = inpainted.view(&view).expect("the planes fit");
        // The bad column and the masked pixels on both sides of it, each pixel once.
        assert_eq!(rest.gap_pixels(), window.height * (SIDE - 12));
        assert_eq!(rest.planes[0].format(), PixelFormat::U8);
        assert!(inpainted.planes[0].iter().all(|byte| *byte == 100));
    }
}
