//! `Rows`: sums over pixels whose rows have unknown offsets, as from a camera's read-out, with the offsets eliminated.
//!
//! An offset o of variance τ² adds o²/τ² to a row's F. That is a parabola in o, of curvature `A = F_oo + 2/τ²` and minimum
//! at −F_o/A, so with the optimal o
//! `F − F_o²/(2A)`, `F_u − F_uo F_o/A`, `F_uv − F_uo F_vo/A`;
//! for squares, `Σ w r² − κ (Σ w r)²` with `κ = τ²/(1 + τ² Σ w)`. These are the sums with the pixels' full covariance
//! `diag(σ²) + τ² 1 1ᵀ`, whose determinant has one more factor, `1 + τ² Σ w`.

use isophote_jit::{PlaneView, Window};
use isophote_symbolic::Bindings;

use crate::sight::gaps::overlap;
use crate::solve::loops::{Loops, Totals};

/// Loops over rows with offsets.
#[derive(Clone)]
pub(crate) struct Rows {
    /// One set of loops per entry of `observed`, with the offset among the parameters.
    pub entries: Vec<Loops>,
    /// The wanted parameters, as indices into the loops' parameters.
    pub parameter_indices: Vec<usize>,
    /// Index of the offset among the loops' parameters.
    pub offset: usize,
    /// Number of the loops' parameters.
    pub count: usize,
}

/// Statistics of the rows' offsets.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct RowOffsets {
    /// Rows with pixels.
    pub rows: u32,
    /// Sum of the expected squares of the offsets, in pixel values².
    pub squares: f64,
    /// Reduction of F by the offsets.
    pub reduction: f64,
    /// Σ ln (1 + τ² Σ w).
    pub logarithm: f64,
}

impl RowOffsets {
    /// The variance of an offset, if any row has one.
    pub fn variance(&self) -> Option<f64> {
        (self.rows > 0).then(|| self.squares / f64::from(self.rows))
    }
}

impl Rows {
    /// Sums over disjoint windows as in [`Loops::sums`]. `variances`: τ² of each entry.
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
        totals.resize(
            1 + self.parameter_indices.len() + self.parameter_indices.len() * (self.parameter_indices.len() + 1) / 2,
        );
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

    /// Adds a row's sums with its offset eliminated.
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
        self.parameter_indices.iter().for_each(|&u| put(slope(u) + curvature(u, o) * offset));
        for (i, &u) in self.parameter_indices.iter().enumerate() {
            self.parameter_indices[i..]
                .iter()
                .for_each(|&v| put(curvature(u, v) - curvature(u, o) * curvature(v, o) / bend));
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

/// Every row that may have a pixel of some windows, as wide as all of them together.
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
