//! `View`: the part of a picture that a fit uses, with the limits of its pixels and kernel layout.

use std::borrow::Cow;

use isophote_jit::{PixelFormat, PlaneView, Window};
use isophote_symbolic::Precision;
use smallvec::{SmallVec, smallvec};

use crate::budget::{FrameBudget, Stop};
use crate::sight::clipping::clipping;
use crate::sight::gaps::overlap;
use crate::sight::grey::{Grey, Mixture};

/// Variance of rounding to whole pixel values: uniform over one step.
const QUANTISATION: f64 = 1.0 / 12.0;

/// One value per plane; on the stack for typical documents, as each window of a frame makes a new one.
pub(crate) type PerPlane<T> = SmallVec<[T; 4]>;

/// The memory layout of a frame's pixels, as far as kernels depend on it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct PlaneLayout {
    pub formats: PerPlane<PixelFormat>,
    pub packed: bool,
    /// Rows have offsets.
    pub has_rows: bool,
}

impl PlaneLayout {
    /// The layout of some planes.
    pub fn of(planes: &[PlaneView]) -> PlaneLayout {
        PlaneLayout {
            formats: planes.iter().map(|plane| plane.format()).collect(),
            packed: planes.iter().all(|plane| plane.pixel_stride() == plane.format().bytes_per_pixel()),
            has_rows: false,
        }
    }

    /// The layout of this many planes of one format: packed when there is one, else interleaved.
    pub fn of_format(format: PixelFormat, planes: usize) -> PlaneLayout {
        PlaneLayout { formats: smallvec![format; planes], packed: planes == 1, has_rows: false }
    }

    /// The layout without row offsets.
    pub fn without_rows(&self) -> Cow<'_, PlaneLayout> {
        match self.has_rows {
            true => Cow::Owned(PlaneLayout { has_rows: false, ..self.clone() }),
            false => Cow::Borrowed(self),
        }
    }

    /// The layout with this many planes of corrections added.
    pub fn corrected(&self, corrections: usize) -> PlaneLayout {
        let mut formats = self.formats.clone();
        formats.extend(std::iter::repeat_n(PixelFormat::F32, corrections));
        PlaneLayout { formats, ..*self }
    }
}

/// The largest pixel value of a format: the default limit of a camera.
pub(crate) fn largest_value(format: PixelFormat) -> f64 {
    match format {
        PixelFormat::U8 => f64::from(u8::MAX),
        PixelFormat::U16 => f64::from(u16::MAX),
        PixelFormat::F32 | PixelFormat::F64 => f64::INFINITY,
    }
}

/// The largest magnitude of a pixel that is fitted in this precision; larger ones count as unknown. Its square times the
/// pixels of a row is finite: 1e16² · 2²⁰ < 3.4e38, and far from the largest f64.
pub(crate) fn summable(precision: Precision) -> f64 {
    match precision {
        Precision::F32 => 1e16,
        Precision::F64 => 1e140,
    }
}

/// The inputs of a fit.
pub(crate) struct View<'a> {
    pub planes: Vec<PlaneView<'a>>,
    pub window: Window,
    /// One limit per plane.
    pub saturation: PerPlane<f64>,
    /// The limits for kernels: whole pixel values stand for all that is rounded to them, so light is at the limit from half
    /// a step below it on.
    pub limits: PerPlane<f64>,
    pub layout: PlaneLayout,
    /// Rounding error of a residual by the lane's precision, in pixel values: at the brightest adjacent pixels. For a much
    /// brighter lone pixel F itself determines the rounding.
    pub rounding: f64,
    /// Gaps of the window, as disjoint rectangles.
    pub gaps: Vec<Window>,
    /// The variance of row offsets, one per entry of `observed`; empty without them.
    pub row_variances: Vec<f64>,
    /// The frame's budget; `None` without a bound.
    pub budget: Option<&'a FrameBudget<'a>>,
}

impl<'a> View<'a> {
    /// Planes of one size; the window lies inside. `saturation`: one limit per plane.
    pub fn new(
        planes: Vec<PlaneView<'a>>,
        window: Window,
        saturation: PerPlane<f64>,
        precision: Precision,
    ) -> View<'a> {
        let largest =
            planes.iter().zip(&saturation).map(|(plane, limit)| largest(plane, window, *limit)).fold(0.0, f64::max);
        let lane = match precision {
            Precision::F32 => f64::from(f32::EPSILON),
            Precision::F64 => f64::EPSILON,
        };
        let layout = PlaneLayout::of(&planes);
        let step = |plane: &PlaneView| if is_whole(plane) { 0.5 } else { 0.0 };
        let limits = planes.iter().zip(&saturation).map(|(plane, limit)| limit - step(plane)).collect();
        let (gaps, row_variances) = (Vec::new(), Vec::new());
        View { planes, window, saturation, limits, layout, rounding: lane * largest, gaps, row_variances, budget: None }
    }

    /// Adds row offsets of these variances, one per entry of `observed`.
    pub fn with_rows(mut self, variances: Vec<f64>) -> View<'a> {
        self.layout.has_rows = !variances.is_empty();
        View { row_variances: variances, ..self }
    }
}

impl<'a> View<'a> {
    /// The same window of a floating-point copy of the picture, with the limits at which pixels were rounded.
    pub fn with_planes<'b>(&self, planes: Vec<PlaneView<'b>>, precision: Precision) -> View<'b>
    where
        'a: 'b,
    {
        let mut view = View::new(planes, self.window, smallvec![f64::INFINITY; self.saturation.len()], precision);
        view.saturation.clone_from(&self.limits);
        view.limits.clone_from(&self.limits);
        view.rounding = self.rounding;
        view.gaps.clone_from(&self.gaps);
        view.budget = self.budget;
        view.with_rows(self.row_variances.clone())
    }

    /// Narrows to a window inside this one.
    pub fn narrowed(&self, window: Window) -> View<'a> {
        View {
            planes: self.planes.clone(),
            window,
            saturation: self.saturation.clone(),
            limits: self.limits.clone(),
            layout: self.layout.clone(),
            rounding: self.rounding,
            gaps: self.gaps.iter().filter_map(|gap| overlap(*gap, window)).collect(),
            row_variances: self.row_variances.clone(),
            budget: self.budget,
        }
    }

    /// Adds a plane of corrections per fitted entry; the planes cover `window`, which contains this view's.
    pub fn corrected<'b>(&self, corrections: &'b [Vec<f32>], window: Window) -> Option<View<'b>>
    where
        'a: 'b,
    {
        const BYTES: usize = PixelFormat::F32.bytes_per_pixel();
        let [width, height, depth, length] = window.size();
        let strides = [BYTES, width * BYTES, width * height * BYTES, width * height * depth * BYTES];
        let plane = |pixels: &'b Vec<f32>| {
            let bytes = bytemuck::cast_slice(pixels);
            let plane = PlaneView::stack(PixelFormat::F32, bytes, [width, height, depth, length], strides);
            plane.ok().map(|plane| plane.placed(window.first()))
        };
        let with = |limits: &[f64]| {
            let free = corrections.iter().map(|_| f64::INFINITY);
            limits.iter().copied().chain(free).collect()
        };
        let mut planes: Vec<PlaneView> = Vec::with_capacity(self.planes.len() + corrections.len());
        planes.extend_from_slice(&self.planes);
        for pixels in corrections {
            planes.push(plane(pixels)?);
        }
        Some(View {
            planes,
            window: self.window,
            saturation: with(&self.saturation),
            limits: with(&self.limits),
            layout: self.layout.corrected(corrections.len()),
            rounding: self.rounding,
            gaps: self.gaps.clone(),
            row_variances: self.row_variances.clone(),
            budget: self.budget,
        })
    }

    /// Charges a pass over this many pixels.
    ///
    /// # Errors
    /// When there is to be no further pass.
    pub fn spend(&self, pixels: usize) -> Result<(), Stop> {
        self.budget.map_or(Ok(()), |budget| budget.spend(pixels as u64))
    }

    /// True once the frame's budget is used up.
    pub fn is_over(&self) -> bool {
        self.budget.is_some_and(FrameBudget::is_over)
    }

    /// Pixels of the window inside gaps.
    pub fn gap_pixels(&self) -> usize {
        self.gaps.iter().map(|gap| gap.pixels()).sum()
    }

    /// Pixels of the window that are finite in every plane.
    pub fn numbers(&self) -> usize {
        let (first, [width, height, depth, length]) = (self.window.first(), self.window.size());
        let is_number = |number: &usize| {
            let (x, row) = (number % width, number / width);
            let at = [x, row % height, row / height % depth, row / height / depth];
            let place = std::array::from_fn(|axis| first[axis] + at[axis]);
            self.planes.iter().all(|plane| plane.pixel_at(place).is_finite())
        };
        (0..width * height * depth * length).filter(is_number).count()
    }

    /// The variance of rounding to whole pixel values; 0 where a plane holds floats.
    pub fn quantisation(&self) -> f64 {
        if self.planes.iter().all(is_whole) { QUANTISATION } else { 0.0 }
    }

    /// The variance of all rounding, including that of the arithmetic.
    pub fn rounding_variance(&self) -> f64 {
        self.quantisation().max(self.rounding.powi(2))
    }
}

/// The limit of one plane of an otherwise unknown camera with largest value `most` (∞ if unknown): where the pixels show
/// clipping, else `most` or the largest value of the format.
pub(crate) fn limit(plane: &PlaneView, window: Window, most: f64) -> f64 {
    clipping(plane, window, most).unwrap_or(largest_value(plane.format())).min(most)
}

fn is_whole(plane: &PlaneView) -> bool {
    matches!(plane.format(), PixelFormat::U8 | PixelFormat::U16)
}

/// A bound on pixel values, lone ones excepted; for floats without a limit from the picture.
fn largest(plane: &PlaneView, window: Window, limit: f64) -> f64 {
    if limit.is_finite() {
        return limit.abs();
    }
    Grey::read_with_nan(&[*plane], window, &[f64::INFINITY], &Mixture::mean(1)).reached()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn one_huge_pixel_does_not_set_the_rounding_of_the_others() {
        let plane = |huge: f32| -> Vec<u8> {
            let value = |i: usize| if i == 77 { huge } else { 100.0 + (i % 13) as f32 };
            (0..30 * 20).flat_map(|i| value(i).to_ne_bytes()).collect()
        };
        let rounding = |huge: f32, precision| {
            let bytes = plane(huge);
            let plane = PlaneView::new(PixelFormat::F32, &bytes, 30, 20, 120, 4).unwrap();
            View::new(vec![plane], Window::whole(30, 20), smallvec![f64::INFINITY], precision).rounding
        };
        for precision in [Precision::F32, Precision::F64] {
            let clean = rounding(100.0, precision);
            assert!(clean > 0.0);
            for huge in [1e9, -1e9, 1e30, f32::MAX, f32::MIN, f32::NAN] {
                assert_eq!(rounding(huge, precision), clean, "{huge}");
            }
        }
    }
}
