//! Measured profiles: samples on a grid of one axis or two, and the cubic spline through them.
//!
//! A table holds the polynomial of each cell of the grid as a list of numbers, which code fetches by [`Lookup`]. With
//! t = (s − first)/step, i = ⌊t⌋ and f = t − i the value is Σ pₖ(i) fᵏ, k = 0 … 3, and over two axes Σ pₖₗ(i, j) fᵏ gˡ;
//! p is constant in a cell, so that derivatives of f alone are those of the spline.
//!
//! The spline has a continuous second derivative on the grid and passes through every sample; its B-spline coefficients
//! solve (cᵢ₋₁ + 4 cᵢ + cᵢ₊₁)/6 = sample with the samples mirrored at both ends, so that its slope there is 0. Beyond
//! the grid the value is that of the nearest edge, with continuous value and slope.

use std::cmp::Ordering;
use std::ops::Range;
use std::sync::Arc;

/// Positions of an axis' samples.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Axis {
    /// Position of the first sample.
    pub first: f64,
    /// Distance between samples.
    pub step: f64,
    /// Number of samples.
    pub count: usize,
}

impl Axis {
    /// Minimum number of samples for a cubic.
    pub const COUNT_MIN: usize = 4;

    /// Number of cells: one before the first sample, one between samples, one after the last.
    pub fn cells(&self) -> usize {
        self.count + 1
    }

    /// The cell of t; the first for NaN.
    #[inline]
    fn cell(&self, t: f64) -> usize {
        // NaN fails this comparison.
        if t >= 0.0 { 1 + t.min((self.count - 1) as f64) as usize } else { 0 }
    }
}

/// A number of a cell: the table, and the index of the polynomial's coefficient, k + 4 l for fᵏ gˡ.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Lookup {
    /// Index in [`Tables`].
    pub table: u16,
    /// Below [`Table::coefficients`].
    pub coefficient: u8,
}

/// Samples, prepared for lookups.
#[derive(Clone, Debug)]
pub struct Table {
    axes: Vec<Axis>,
    /// Cell by cell, the first axis running fastest, the coefficients of one cell together; shared with the other
    /// tables of [`Tables`].
    shared: Arc<[f64]>,
    /// This table's range.
    own: Range<usize>,
}

impl PartialEq for Table {
    fn eq(&self, other: &Table) -> bool {
        self.axes == other.axes && self.numbers() == other.numbers()
    }
}

impl Table {
    /// The spline through samples, the first axis running fastest. `None` unless there are one or two axes of at least
    /// four samples, all samples are there, everything is finite, the spline included, and steps are above 0.
    pub fn through(axes: &[Axis], samples: &[f64]) -> Option<Table> {
        let is_axis = |axis: &Axis| {
            axis.count >= Axis::COUNT_MIN && axis.first.is_finite() && axis.step.is_finite() && axis.step > 0.0
        };
        let count: usize = axes.iter().map(|axis| axis.count).product();
        let is_whole = count == samples.len() && samples.iter().all(|sample| sample.is_finite());
        if !is_whole || !matches!(axes.len(), 1 | 2) || !axes.iter().all(is_axis) {
            return None;
        }
        let (width, height) = (axes[0].count, axes.get(1).map_or(1, |axis| axis.count));
        let mut weights = samples.to_vec();
        for row in weights.chunks_exact_mut(width) {
            solve(row, 1);
        }
        if axes.len() == 2 {
            (0..width).for_each(|x| solve(&mut weights[x..], width));
        }
        let at = |x: usize, y: usize| weights[y * width + x];
        let mut numbers = Vec::new();
        if axes.len() == 1 {
            for cell in 0..axes[0].cells() {
                let (places, powers) = cell_of(cell, width);
                numbers.extend(powers.iter().map(|power| dot(power, |i| at(places[i], 0))));
            }
            return Table::alone(axes, numbers);
        }
        for row in 0..axes[1].cells() {
            let (rows, along_rows) = cell_of(row, height);
            for cell in 0..axes[0].cells() {
                let (places, powers) = cell_of(cell, width);
                for outer in &along_rows {
                    numbers.extend(powers.iter().map(|power| dot(outer, |j| dot(power, |i| at(places[i], rows[j])))));
                }
            }
        }
        Table::alone(axes, numbers)
    }

    fn alone(axes: &[Axis], numbers: Vec<f64>) -> Option<Table> {
        let is_finite = numbers.iter().all(|number| number.is_finite());
        is_finite.then(|| Table { axes: axes.to_vec(), own: 0..numbers.len(), shared: numbers.into() })
    }

    /// One or two.
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// Number of coefficients of a cell: 4 to the power of the axes.
    pub fn coefficients(&self) -> usize {
        if self.axes.len() == 1 { 4 } else { 16 }
    }

    /// Cell by cell, the first axis running fastest, the coefficients of one cell together.
    pub fn numbers(&self) -> &[f64] {
        &self.shared[self.own.clone()]
    }

    /// A coefficient of the cell at (a, b), counted in steps from the first sample; one axis ignores b.
    #[inline]
    pub fn coefficient(&self, coefficient: u8, a: f64, b: f64) -> f64 {
        let row = self.axes.get(1).map_or(0, |axis| axis.cell(b));
        let cell = row * self.axes[0].cells() + self.axes[0].cell(a);
        self.numbers().get(cell * self.coefficients() + usize::from(coefficient)).copied().unwrap_or(f64::NAN)
    }

    /// The spline at a position.
    pub fn value(&self, place: &[f64]) -> f64 {
        let t = |i: usize| match (self.axes.get(i), place.get(i)) {
            (Some(axis), Some(s)) => (s - axis.first) / axis.step,
            _ => 0.0,
        };
        let (a, b) = (t(0), t(1));
        let (f, g) = (crate::Function1::Fraction.value(a), crate::Function1::Fraction.value(b));
        let term = |k: usize| self.coefficient(k as u8, a, b) * f.powi((k % 4) as i32) * g.powi((k / 4) as i32);
        (0..self.coefficients()).map(term).sum()
    }
}

/// The shared tables of a document. Equal when all their bits are.
#[derive(Clone, Debug, Default)]
pub struct Tables {
    all: Arc<[Table]>,
    /// The numbers of all tables, one after another; the tables share them.
    numbers: Arc<[f64]>,
}

impl Ord for Tables {
    fn cmp(&self, other: &Tables) -> Ordering {
        if Arc::ptr_eq(&self.all, &other.all) {
            return Ordering::Equal;
        }
        let axes = |tables: &Tables| -> Vec<Vec<[u64; 3]>> {
            let axis = |axis: &Axis| [axis.first.to_bits(), axis.step.to_bits(), axis.count as u64];
            tables.all.iter().map(|table| table.axes.iter().map(axis).collect()).collect()
        };
        let numbers = |tables: &'_ Tables| tables.numbers.iter().map(|x| x.to_bits()).collect::<Vec<u64>>();
        axes(self).cmp(&axes(other)).then_with(|| numbers(self).cmp(&numbers(other)))
    }
}

impl PartialOrd for Tables {
    fn partial_cmp(&self, other: &Tables) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Tables {
    fn eq(&self, other: &Tables) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Tables {}

impl Tables {
    /// Numbers the tables in this order.
    pub fn of(tables: Vec<Table>) -> Tables {
        let numbers: Arc<[f64]> = tables.iter().flat_map(|table| table.numbers().iter().copied()).collect();
        let mut start = 0;
        let shared = |table: Table| {
            let own = start..start + table.own.len();
            start = own.end;
            Table { axes: table.axes, shared: numbers.clone(), own }
        };
        Tables { all: tables.into_iter().map(shared).collect(), numbers }
    }

    /// All tables.
    pub fn all(&self) -> &[Table] {
        &self.all
    }

    /// True when there is such a number.
    pub fn has(&self, lookup: Lookup) -> bool {
        self.all.get(usize::from(lookup.table)).is_some_and(|t| usize::from(lookup.coefficient) < t.coefficients())
    }

    /// A number of the cell at (a, b); NaN where there is no such table.
    #[inline]
    pub fn look_up(&self, lookup: Lookup, a: f64, b: f64) -> f64 {
        self.all.get(usize::from(lookup.table)).map_or(f64::NAN, |table| table.coefficient(lookup.coefficient, a, b))
    }

    /// The numbers of all tables, table after table.
    pub fn numbers(&self) -> &[f64] {
        &self.numbers
    }

    /// Index of a table's first number among them.
    pub fn start(&self, table: u16) -> usize {
        self.all.iter().take(table.into()).map(|table| table.own.len()).sum()
    }
}

/// Replaces samples, `apart` from each other and mirrored at both ends, by B-spline weights (Thomas 1949).
fn solve(samples: &mut [f64], apart: usize) {
    let count = samples.len().div_ceil(apart);
    let mut factors = vec![0.0; count];
    for i in 0..count {
        let above = if i == 0 { 2.0 } else { 1.0 };
        let below = match i {
            0 => 0.0,
            _ if i + 1 == count => 2.0,
            _ => 1.0,
        };
        let (before, rest) = if i == 0 { (0.0, 4.0) } else { (samples[(i - 1) * apart], 4.0 - below * factors[i - 1]) };
        factors[i] = above / rest;
        samples[i * apart] = (6.0 * samples[i * apart] - below * before) / rest;
    }
    for i in (0..count.saturating_sub(1)).rev() {
        samples[i * apart] -= factors[i] * samples[(i + 1) * apart];
    }
}

/// The weights of a cell, and their factors in each power of f.
fn cell_of(cell: usize, count: usize) -> ([usize; 4], [[f64; 4]; 4]) {
    let base = cell.saturating_sub(1);
    let mirrored = |i: usize| {
        // One more than the position, which may be −1.
        let i = (base + i).abs_diff(1);
        if i < count { i } else { 2 * (count - 1) - i }
    };
    let places = std::array::from_fn(mirrored);
    let level = [1.0, 4.0, 1.0, 0.0].map(|w| w / 6.0);
    let is_outside = cell == 0 || cell == count;
    let none = [0.0; 4];
    let powers = match is_outside {
        true => [level, none, none, none],
        false => [level, [-0.5, 0.0, 0.5, 0.0], [0.5, -1.0, 0.5, 0.0], [-1.0, 3.0, -3.0, 1.0].map(|w| w / 6.0)],
    };
    (places, powers)
}

fn dot(power: &[f64; 4], weight: impl Fn(usize) -> f64) -> f64 {
    (0..4).map(|i| power[i] * weight(i)).sum()
}

#[cfg(test)]
#[path = "table_tests.rs"]
mod tests;
