//! `Loops`: the kernels whose sums add up to those of a model.
//!
//! What comes in: one kernel for each of a model's summands. What goes out: their sums, added. It never knows what the sums
//! are for.

use std::sync::Arc;

use isophote_jit::{Kernel, PlaneView, Sums, Window};
use isophote_symbolic::Bindings;
use smallvec::SmallVec;

use crate::solve::rows::{RowOffsets, Rows};

/// One kernel a summand; those of pixels at their limit come after those of the others.
#[derive(Clone, Default)]
pub(crate) struct Loops {
    pub seen: SmallVec<[Arc<Kernel>; 4]>,
    pub clipped: SmallVec<[Arc<Kernel>; 4]>,
    /// The others are one kernel of several values of a pixel, whose last two sums are how many of them were below their limit, and
    /// how many at it.
    pub is_joint: bool,
    /// Where rows have offsets: what is summed in the place of these kernels, or, where those sum nothing but F with ln σ²
    /// and χ², what is taken away from that.
    pub rows: Option<Arc<Rows>>,
}

/// What a pass over all of them sums.
#[derive(Clone, Debug, Default)]
pub(crate) struct Totals {
    /// All outputs.
    pub outputs: Vec<f64>,
    /// Those of pixel values below their limit alone.
    pub seen: Vec<f64>,
    /// Pixel values below their limit, of all that the model observes.
    pub pixels: u64,
    /// Pixel values at their limit.
    pub saturated: u64,
    /// Pixel values of the domain that gaps left out.
    pub left_out: u64,
    /// Of rows' offsets, where they have some.
    pub rows: RowOffsets,
    /// Of the kernel that ran last.
    last: Sums,
}

impl Totals {
    pub(super) fn clear(&mut self) {
        self.outputs.clear();
        self.seen.clear();
        (self.pixels, self.saturated, self.left_out) = (0, 0, 0);
        self.rows = RowOffsets::default();
    }

    /// Room for so many outputs.
    pub(super) fn resize(&mut self, outputs: usize) {
        self.outputs.resize(outputs, 0.0);
        self.seen.resize(outputs, 0.0);
    }

    /// Takes what rows' offsets explain from F with ln σ² and from χ².
    fn explained(&mut self, rows: RowOffsets) {
        for sums in [&mut self.outputs, &mut self.seen] {
            if let [full, chi_square] = &mut sums[..] {
                *full += rows.logarithm - rows.reduction;
                *chi_square -= rows.reduction;
            }
        }
        self.rows = rows;
    }

    /// Takes those of a part away again.
    fn less(&mut self, part: &Totals) {
        let less = |to: &mut Vec<f64>, from: &[f64]| to.iter_mut().zip(from).for_each(|(sum, value)| *sum -= value);
        less(&mut self.outputs, &part.outputs);
        less(&mut self.seen, &part.seen);
        // Where rounding lets the domain end between two pixels, the whole and its part may differ by one.
        self.pixels = self.pixels.saturating_sub(part.pixels);
        self.saturated = self.saturated.saturating_sub(part.saturated);
        self.left_out += part.pixels + part.saturated;
    }
}

/// Without a pixel there is nothing to add: a parameter's factor that has no value makes NaN of an empty sum.
fn add(to: &mut Vec<f64>, from: &[f64], pixels: u64) {
    to.resize(from.len(), 0.0);
    if pixels > 0 {
        to.iter_mut().zip(from).for_each(|(sum, value)| *sum += value);
    }
}

impl Loops {
    /// The sums over windows without a common pixel, into `totals`, whatever was in there; without those over `gaps`, which
    /// lie inside and have no pixel in common either. `None` when a kernel refuses the planes; they were made for it, so only a
    /// bug could. `row_variances`: of rows' offsets, one for each entry of `observed`, where they have some.
    ///
    /// Gaps are summed and taken away again, so that kernels need not ask at every pixel.
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
                        // Without a pixel there are no counts.
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
            // Where nothing was left out there is nothing to make up for.
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

    /// Derivatives of `v0 · x / w` by v0 and w, over the pixels of a domain.
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
        // w = 0: what is taken out of the sums has no value.
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
        // And with w = 1, beside one that has pixels.
        let bindings = Bindings { parameters: &[1.0, 1.0], entry: &[1.0, 1.0], ..Bindings::default() };
        let full = kernel("x >= 0");
        let loops = Loops { seen: smallvec![empty, full.clone()], clipped: smallvec![], is_joint: false, rows: None };
        loops.sums(&bindings, &[plane], &[window], &[], &[], &mut totals).unwrap();
        let full = full.sums(&bindings, &[plane], window).unwrap();
        assert_eq!((totals.outputs, totals.pixels), (full.outputs, 64));
    }

    /// Beside a plane that has other values in the gaps, whose sums are the same, in either order.
    #[test]
    fn gaps_take_no_part() {
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
            // One by one, the sound pixels alone.
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
