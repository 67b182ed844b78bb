//! `Loops`: one kernel for each of a model's summands; adds their sums.

use std::sync::Arc;

use isophote_jit::{Kernel, PlaneView, Sums, Window};
use isophote_symbolic::Bindings;
use smallvec::SmallVec;

use crate::solve::rows::{RowOffsets, Rows};

/// One kernel per summand; those of saturated pixels come after the others.
#[derive(Clone, Default)]
pub(crate) struct Loops {
    pub seen: SmallVec<[Arc<Kernel>; 4]>,
    pub clipped: SmallVec<[Arc<Kernel>; 4]>,
    /// `seen` is one kernel over several values of a pixel, whose last two sums count the values below and at their limit.
    pub is_joint: bool,
    /// Where rows have offsets: summed in place of these kernels, or, where these sum only F with ln σ² and χ², what the
    /// offsets explain is subtracted from that.
    pub rows: Option<Arc<Rows>>,
}

/// The sums of a pass over all kernels.
#[derive(Clone, Debug, Default)]
pub(crate) struct Totals {
    /// All outputs.
    pub outputs: Vec<f64>,
    /// The outputs of pixel values below their limit alone.
    pub seen: Vec<f64>,
    /// Pixel values below their limit, over all entries of `observed`.
    pub pixels: u64,
    /// Pixel values at their limit.
    pub saturated: u64,
    /// Pixel values of the domain inside gaps.
    pub left_out: u64,
    /// Sums of the rows' offsets, where rows have them.
    pub rows: RowOffsets,
    /// Sums of the last kernel run.
    last: Sums,
}

impl Totals {
    pub(super) fn clear(&mut self) {
        self.outputs.clear();
        self.seen.clear();
        (self.pixels, self.saturated, self.left_out) = (0, 0, 0);
        self.rows = RowOffsets::default();
    }

    /// Sizes the sums for this many outputs.
    pub(super) fn resize(&mut self, outputs: usize) {
        self.outputs.resize(outputs, 0.0);
        self.seen.resize(outputs, 0.0);
    }

    /// Subtracts what rows' offsets explain from F with ln σ² and from χ².
    fn explained(&mut self, rows: RowOffsets) {
        for sums in [&mut self.outputs, &mut self.seen] {
            if let [full, chi_square] = &mut sums[..] {
                *full += rows.logarithm - rows.reduction;
                *chi_square -= rows.reduction;
            }
        }
        self.rows = rows;
    }

    /// Subtracts the sums over a part.
    fn less(&mut self, part: &Totals) {
        let less = |to: &mut Vec<f64>, from: &[f64]| to.iter_mut().zip(from).for_each(|(sum, value)| *sum -= value);
        less(&mut self.outputs, &part.outputs);
        less(&mut self.seen, &part.seen);
        // Rounding at the domain's edge may make the counts of whole and part differ by one pixel.
        self.pixels = self.pixels.saturating_sub(part.pixels);
        self.saturated = self.saturated.saturating_sub(part.saturated);
        self.left_out += part.pixels + part.saturated;
    }
}

/// Skips sums without pixels: a parameter's factor without a value makes NaN of an empty sum.
fn add(to: &mut Vec<f64>, from: &[f64], pixels: u64) {
    to.resize(from.len(), 0.0);
    if pixels > 0 {
        to.iter_mut().zip(from).for_each(|(sum, value)| *sum += value);
    }
}

impl Loops {
    /// Sums over disjoint windows into `totals`, which is overwritten, without those over `gaps`, which are disjoint and
    /// lie inside. `None` when a kernel refuses the planes; as they were made for it, only a bug causes that.
    /// `row_variances`: of the rows' offsets, one per entry of `observed`; empty without them.
    ///
    /// Gaps are summed and subtracted, so that kernels need no test per pixel.
    pub fn sums(
        &self,
        bindings: &Bindings,
        planes: &[PlaneView],
        windows: &[Window],
        gaps: &[Window],
        row_variances: &[f64],
        totals: &mut Totals,
    ) -> Option<()> {
        if let Some(rows) = self.rows.as_ref().filter(|_| self.seen.is_empty()) {
            return rows.sums(bindings, planes, windows, gaps, row_variances, totals);
        }
        self.whole(bindings, planes, windows, totals)?;
        if !gaps.is_empty() {
            let mut part = Totals::default();
            self.whole(bindings, planes, gaps, &mut part)?;
            totals.less(&part);
        }
        if let Some(rows) = &self.rows {
            let mut part = Totals::default();
            rows.sums(bindings, planes, windows, gaps, row_variances, &mut part)?;
            totals.explained(part.rows);
        }
        Some(())
    }

    fn whole(&self, bindings: &Bindings, planes: &[PlaneView], windows: &[Window], totals: &mut Totals) -> Option<()> {
        totals.clear();
        for window in windows {
            let mut saturated = 0;
            for kernel in &self.seen {
                let sums = &mut totals.last;
                kernel.sums_into(bindings, planes, *window, sums).ok()?;
                let (outputs, pixels) = match sums.outputs.as_slice() {
                    [outputs @ .., below, at_limit] if self.is_joint => {
                        // Without pixels there are no counts.
                        let [below, at_limit] = if sums.pixels > 0 { [*below, *at_limit] } else { [0.0; 2] };
                        saturated += at_limit as u64;
                        (outputs, below as u64)
                    }
                    outputs => {
                        saturated += sums.saturated;
                        (outputs, sums.pixels)
                    }
                };
                totals.pixels += pixels;
                add(&mut totals.seen, outputs, pixels);
                add(&mut totals.outputs, outputs, pixels);
            }
            totals.saturated += saturated;
            // Without saturated pixels the clipped kernels have nothing to add.
            for kernel in self.clipped.iter().filter(|_| saturated > 0) {
                kernel.sums_into(bindings, planes, *window, &mut totals.last).ok()?;
                let Sums { outputs, pixels, .. } = &totals.last;
                add(&mut totals.outputs, outputs, *pixels);
            }
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use isophote_jit::{KernelOptions, PixelFormat, VectorWidth, has_fma};
    use isophote_symbolic::{Lowering, Method, Model, ParameterId, Precision};

    use smallvec::smallvec;

    use super::*;

    /// Derivatives of `v0 · x / w` with respect to v0 and w, over the pixels of a domain.
    fn kernel(domain: &str) -> Arc<Kernel> {
        let text = format!(
            "name = \"ramp\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\nv0 = {{ start = 1.0 }}\n\
             w = {{ start = 1.0 }}\n[model]\nintensity = \"v0 * x / w\"\ndomain = \"{domain}\"\n"
        );
        let model = Model::from_toml(&text).unwrap();
        let objective = model.objective(&[ParameterId(0), ParameterId(1)], Method::GaussNewton).unwrap();
        let program = objective.program(Lowering { fma: has_fma(), drop_saturated: false }).unwrap();
        let options = KernelOptions {
            precision: Precision::F32,
            width: VectorWidth::Bits128,
            formats: vec![PixelFormat::U8],
            packed: true,
        };
        Arc::new(Kernel::compile(&program, &options).unwrap())
    }

    #[test]
    fn a_summand_without_pixels_adds_nothing() {
        let pixels: Vec<u8> = (0..64).collect();
        let plane = PlaneView::new(PixelFormat::U8, &pixels, 8, 8, 8, 1).unwrap();
        let window = Window::whole(8, 8);
        // w = 0: the factor outside of the sums has no value.
        let bindings = Bindings { parameters: &[1.0, 0.0], entry: &[1.0, 0.0], ..Bindings::default() };
        let empty = kernel("x < 0");
        let alone = empty.sums(&bindings, &[plane], window).unwrap();
        assert!(alone.pixels == 0 && alone.outputs.iter().any(|sum| sum.is_nan()), "{alone:?}");
        let mut totals = Totals::default();
        for clipped in [smallvec![], smallvec![empty.clone()]] {
            let loops = Loops { seen: smallvec![empty.clone()], clipped, is_joint: false, rows: None };
            loops.sums(&bindings, &[plane], &[window; 2], &[], &[], &mut totals).unwrap();
            assert_eq!((totals.outputs.as_slice(), totals.pixels), (&vec![0.0; alone.outputs.len()][..], 0));
        }
        // With w = 1, beside a summand that has pixels.
        let bindings = Bindings { parameters: &[1.0, 1.0], entry: &[1.0, 1.0], ..Bindings::default() };
        let full = kernel("x >= 0");
        let loops = Loops { seen: smallvec![empty, full.clone()], clipped: smallvec![], is_joint: false, rows: None };
        loops.sums(&bindings, &[plane], &[window], &[], &[], &mut totals).unwrap();
        let full = full.sums(&bindings, &[plane], window).unwrap();
        assert_eq!((totals.outputs, totals.pixels), (full.outputs, 64));
    }

    /// The sums do not depend on the gaps' values, and equal those over the sound pixels alone.
    #[test]
    fn gaps_are_left_out_of_the_sums() {
        let bindings = Bindings { parameters: &[1.5, 0.75], entry: &[1.5, 0.75], ..Bindings::default() };
        let rectangle = |x, y, width, height| Window { x, y, width, height, ..Window::whole(1, 1) };
        let gaps = [rectangle(2, 0, 1, 8), rectangle(4, 5, 3, 1), rectangle(7, 7, 1, 1)];
        let is_gap =
            |x: usize, y: usize| gaps.iter().any(|g| x >= g.x && x < g.x + g.width && y >= g.y && y < g.y + g.height);
        let kernel = kernel("x >= 1");
        let loops = Loops { seen: smallvec![kernel.clone()], clipped: smallvec![], is_joint: false, rows: None };
        let mut found = Vec::new();
        for hot in [0, 255] {
            let pixel = |i: usize| if is_gap(i % 8, i / 8) { hot } else { i as u8 };
            let pixels: Vec<u8> = (0..64).map(pixel).collect();
            let plane = PlaneView::new(PixelFormat::U8, &pixels, 8, 8, 8, 1).unwrap();
            let mut totals = Totals::default();
            loops.sums(&bindings, &[plane], &[Window::whole(8, 8)], &gaps, &[], &mut totals).unwrap();
            assert_eq!((totals.pixels, totals.left_out), (56 - 12, 12));
            found.push(totals.outputs.clone());
            // The sound pixels alone, one by one.
            let sound = (0..64).map(|i| (i % 8, i / 8)).filter(|(x, y)| !is_gap(*x, *y));
            let sound: Vec<Window> = sound.map(|(x, y)| rectangle(x, y, 1, 1)).collect();
            loops.sums(&bindings, &[plane], &sound, &[], &[], &mut totals).unwrap();
            found.push(totals.outputs.clone());
        }
        for other in &found[1..] {
            let close = |(a, b): (&f64, &f64)| (a - b).abs() <= 1e-5 * (a.abs() + 1.0);
            assert!(found[0].iter().zip(other).all(close), "{found:?}");
        }
        assert!(found[0].iter().all(|sum| sum.abs() > 1.0), "{found:?}");
    }
}
