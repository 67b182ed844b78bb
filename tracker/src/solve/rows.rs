//! `Rows`: sums of pixels whose rows are off, each by something that nobody knows, as a camera's read-out leaves them.
//!
//! What comes in: kernels of a model with an offset among its parameters, and the variance of a row's offset. What goes out:
//! sums over all rows, without an offset. It never knows what the sums are for.
//!
//! An offset o of variance τ² adds o²/τ² to a row's F. That is a parabola in o, of curvature `A = F_oo + 2/τ²` and least at
//! −F_o/A, so with o at its best
//! `F − F_o²/(2A)`, `F_u − F_uo F_o/A`, `F_uv − F_uo F_vo/A`;
//! of squares, `Σ w r² − κ (Σ w r)²` with `κ = τ²/(1 + τ² Σ w)`. Those are the sums of the pixels' true covariance
//! `diag(σ²) + τ² 1 1ᵀ`, whose determinant has one more factor, `1 + τ² Σ w`.

use isophote_jit::{PlaneView, Window};
use isophote_symbolic::Bindings;

use crate::sight::gaps::overlap;
use crate::solve::loops::{Loops, Totals};

/// Loops whose rows have an offset.
#[derive(Clone)]
pub(crate) struct Rows {
    /// Those of one entry of `observed` each, with the offset among the parameters.
    pub entries: Vec<Loops>,
    /// Of each parameter that is asked for, its number among those of the loops, …
    pub places: Vec<usize>,
    /// … that of the offset, …
    pub offset: usize,
    /// … and how many there are.
    pub count: usize,
}

/// What rows' offsets turned out to be.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct RowOffsets {
    /// Rows with pixels.
    pub rows: u32,
    /// What is to be expected of their squares, summed, in pixel values².
    pub squares: f64,
    /// By how much F is less than without offsets.
    pub reduction: f64,
    /// Σ ln (1 + τ² Σ w).
    pub logarithm: f64,
}

impl RowOffsets {
    /// Of an offset, where there are some.
    pub fn variance(&self) -> Option<f64> {
        (self.rows > 0).then(|| self.squares / f64::from(self.rows))
    }
}

impl Rows {
    /// The sums over windows without a common pixel, as [`Loops::sums`] has them. `variances`: τ² of each entry.
    pub fn sums(
        &self,
        bindings: &Bindings,
        planes: &[PlaneView],
        windows: &[Window],
        gaps: &[Window],
        variances: &[f64],
        totals: &mut Totals,
    ) -> Option<()> {
        totals.clear();
        totals.resize(1 + self.places.len() + self.places.len() * (self.places.len() + 1) / 2);
        let with_offset = |known: &[f64]| known.iter().copied().chain([0.0]).collect::<Vec<f64>>();
        let (parameters, entry) = (with_offset(bindings.parameters), with_offset(bindings.entry));
        let bindings = Bindings { parameters: &parameters, entry: &entry, ..*bindings };
        let inside = |row: Window, windows: &[Window], parts: &mut Vec<Window>| {
            parts.clear();
            parts.extend(windows.iter().filter_map(|window| overlap(*window, row)));
        };
        let (mut seen, mut hidden, mut sums) = (Vec::new(), Vec::new(), Totals::default());
        for row in rows_of(windows) {
            inside(row, windows, &mut seen);
            inside(row, gaps, &mut hidden);
            for (loops, variance) in self.entries.iter().zip(variances).filter(|_| !seen.is_empty()) {
                loops.sums(&bindings, planes, &seen, &hidden, &[], &mut sums)?;
                self.add(&sums, *variance, totals);
            }
        }
        Some(())
    }

    /// Adds a row's sums, without its offset.
    fn add(&self, sums: &Totals, variance: f64, totals: &mut Totals) {
        totals.pixels += sums.pixels;
        totals.saturated += sums.saturated;
        totals.left_out += sums.left_out;
        if sums.pixels + sums.saturated == 0 {
            return;
        }
        let outputs = &sums.outputs;
        let slope = |u: usize| outputs[1 + u];
        let curvature = |u: usize, v: usize| {
            let (u, v) = (u.min(v), u.max(v));
            outputs[1 + self.count + u * self.count - u * (u + 1) / 2 + v]
        };
        let (o, information) = (self.offset, 2.0 / variance);
        let bend = curvature(o, o).max(0.0) + information;
        let offset = -slope(o) / bend;
        let reduction = 0.5 * bend * offset * offset;
        let mut to = totals.outputs.iter_mut();
        let mut put = |value: f64| {
            if let Some(sum) = to.next() {
                *sum += value;
            }
        };
        put(outputs[0] - reduction);
        self.places.iter().for_each(|&u| put(slope(u) + curvature(u, o) * offset));
        for (i, &u) in self.places.iter().enumerate() {
            self.places[i..].iter().for_each(|&v| put(curvature(u, v) - curvature(u, o) * curvature(v, o) / bend));
        }
        if let (Some(sum), Some(seen)) = (totals.seen.first_mut(), sums.seen.first()) {
            *sum += seen - reduction;
        }
        let known = &mut totals.rows;
        known.rows += 1;
        known.squares += offset * offset + 2.0 / bend;
        known.reduction += reduction;
        known.logarithm += (bend / information).ln();
    }
}

/// Every row that may have a pixel of some windows, as wide as all of them.
fn rows_of(windows: &[Window]) -> impl Iterator<Item = Window> {
    let ends = |axis: usize| {
        let first = windows.iter().map(|window| window.first()[axis]).min().unwrap_or(0);
        let end = windows.iter().map(|window| window.first()[axis] + window.size()[axis]).max().unwrap_or(0);
        first..end
    };
    let [x, y, z, w] = [0, 1, 2, 3].map(ends);
    let slices = w.flat_map(move |w| z.clone().map(move |z| [z, w]));
    slices.flat_map(move |first| {
        let row = Window { x: x.start, width: x.len(), height: 1, ..Window::whole(1, 1) };
        let slices = isophote_jit::Slices { first, ..isophote_jit::Slices::ONE };
        y.clone().map(move |y| Window { y, slices, ..row })
    })
}

#[cfg(test)]
#[path = "rows_tests.rs"]
mod tests;
