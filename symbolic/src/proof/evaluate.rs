//! A program's value in any arithmetic: exact meaning, no lanes.
//!
//! What comes in: a [`Program`], and numbers for what it reads. What goes out: its outputs as the real-number formulas that its
//! instructions are, worked out in a [`Number`]: f64, double-double, residues. [`crate::program::interpreter`] says what a program's rounding
//! is; this says what it rounds. It must never know: where a program came from.

use std::ops::{Add, Div, Mul, Neg, Sub};

use crate::program::function::{Function1, Function2};
use crate::program::{Level, Op, Program, Sink, Value, holds};
use crate::proof::double_double::DoubleDouble;

/// An arithmetic.
pub(crate) trait Number:
    Copy
    + PartialOrd
    + From<f64>
    + Neg<Output = Self>
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
{
    /// |x|.
    fn abs(self) -> Self;
    /// √x.
    fn sqrt(self) -> Self;
    /// An elementary function.
    fn call1(self, function: Function1) -> Self;
    /// An elementary function of two arguments.
    fn call2(self, function: Function2, other: Self) -> Self;
    /// 2 / √π.
    fn two_over_root_pi() -> Self {
        Self::from(std::f64::consts::FRAC_2_SQRT_PI)
    }
}

impl Number for f64 {
    fn abs(self) -> f64 {
        f64::abs(self)
    }
    fn sqrt(self) -> f64 {
        f64::sqrt(self)
    }
    fn call1(self, function: Function1) -> f64 {
        function.value(self)
    }
    fn call2(self, function: Function2, other: f64) -> f64 {
        function.value(self, other)
    }
}

impl Number for DoubleDouble {
    fn abs(self) -> Self {
        self.abs()
    }
    fn sqrt(self) -> Self {
        self.sqrt()
    }
    fn call1(self, function: Function1) -> Self {
        self.call1(function)
    }
    fn call2(self, function: Function2, other: Self) -> Self {
        self.call2(function, other)
    }
    fn two_over_root_pi() -> Self {
        Self::from(2.0) / Self::from(-1.0).call1(Function1::Acos).sqrt()
    }
}

/// Where a program is evaluated: numbers for its inputs, coordinates and pixels.
pub(crate) struct Sample<'a, N> {
    /// In the order of [`Program::inputs`].
    pub inputs: Vec<N>,
    /// Values of the inner coordinate.
    pub columns: Vec<N>,
    /// Values of the outer coordinates, one list a row.
    pub rows: Vec<Vec<N>>,
    /// The pixel of a channel, at an index into the columns and one into the rows.
    pub pixel: &'a dyn Fn(usize, usize, usize) -> N,
    /// Every pixel takes part, whatever the program's pixel set says.
    pub every_pixel: bool,
}

/// The outputs of a sums program over the pixels of a window; empty for a plane program.
#[cfg(test)]
pub(crate) fn evaluate<N: Number>(
    program: &Program,
    bindings: &crate::program::Bindings<'_>,
    pixels: &dyn crate::program::interpreter::Pixels,
    window: crate::program::interpreter::Window,
) -> Vec<N> {
    let sample = Sample {
        inputs: program.gather(bindings).map(N::from).collect(),
        columns: (window.x..window.x + window.width).map(|x| N::from(x as f64)).collect(),
        rows: (window.y..window.y + window.height).map(|y| vec![N::from(y as f64)]).collect(),
        pixel: &|channel, column, row| pixels.at(channel, window.x + column, window.y + row).into(),
        every_pixel: false,
    };
    evaluate_at(program, &sample).outputs
}

/// What a sums program makes of a sample.
pub(crate) struct Evaluated<N> {
    /// Empty for a plane program.
    pub outputs: Vec<N>,
    /// The pixels that took part, row by row.
    pub taken: Vec<bool>,
}

/// Evaluates a program.
pub(crate) fn evaluate_at<N: Number>(program: &Program, sample: &Sample<'_, N>) -> Evaluated<N> {
    let mut evaluated = Evaluated { outputs: Vec::new(), taken: Vec::new() };
    let Sink::Sums { accumulators, totals, outputs } = &program.sink else { return evaluated };
    let zero = N::from(0.0);
    let mut cells = vec![Cell::Number(zero); program.instructions.len()];
    let mut pass_totals = vec![zero; totals.len()];
    let mut pass_count = 0.0;
    let input = |op| match op {
        Op::Input(input) => Some(sample.inputs[input.index()]),
        _ => None,
    };
    execute(program, Level::Pass, &mut cells, input);
    for (row, outer) in sample.rows.iter().enumerate() {
        let coordinate = |op| match op {
            Op::Outer(c) => Some(outer[c.index() - 1]),
            _ => None,
        };
        execute(program, Level::Row, &mut cells, coordinate);
        let mut sums = vec![zero; accumulators.len()];
        let mut count = 0.0;
        for (column, x) in sample.columns.iter().enumerate() {
            if let (Some((lo, hi)), false) = (program.pixel_set.bounds, sample.every_pixel)
                && !(cells[lo.index()].number() <= *x && *x <= cells[hi.index()].number())
            {
                evaluated.taken.push(false);
                continue;
            }
            for (i, op) in at_level(program, Level::Pixel) {
                cells[i] = match op {
                    Op::Offset(c) => Cell::Number(*x + cells[c.index()].number()),
                    Op::Channel(c) => Cell::Number((sample.pixel)(c.index(), column, row)),
                    op => apply(op, &cells),
                };
            }
            let truth = |value: Option<Value>| value.map(|v| cells[v.index()].truth());
            let outside = truth(program.pixel_set.mask) == Some(false);
            let left_out = outside || truth(program.pixel_set.saturated) == Some(true);
            evaluated.taken.push(sample.every_pixel || !left_out);
            if !sample.every_pixel && left_out {
                continue;
            }
            count += 1.0;
            for (sum, value) in sums.iter_mut().zip(accumulators) {
                *sum = *sum + cells[value.index()].number();
            }
        }
        if count == 0.0 {
            continue;
        }
        pass_count += count;
        execute(program, Level::RowEnd, &mut cells, |op| match op {
            Op::RowTotal(a) => Some(sums[a.index()]),
            Op::RowCount => Some(count.into()),
            _ => None,
        });
        for (total, value) in pass_totals.iter_mut().zip(totals) {
            *total = *total + cells[value.index()].number();
        }
    }
    execute(program, Level::PassEnd, &mut cells, |op| match op {
        Op::PassTotal(t) => Some(pass_totals[t.index()]),
        Op::PassCount => Some(pass_count.into()),
        _ => None,
    });
    evaluated.outputs = outputs.iter().map(|value| cells[value.index()].number()).collect();
    evaluated
}

/// A number or a truth value.
#[derive(Clone, Copy)]
enum Cell<N> {
    Number(N),
    Truth(bool),
}

impl<N: Number> Cell<N> {
    fn number(self) -> N {
        match self {
            Cell::Number(x) => x,
            Cell::Truth(b) => f64::from(u8::from(b)).into(),
        }
    }
    fn truth(self) -> bool {
        matches!(self, Cell::Truth(true))
    }
}

fn at_level(program: &Program, level: Level) -> impl Iterator<Item = (usize, Op)> {
    let of_level = move |(i, x): (usize, &crate::program::Instruction)| (x.level == level).then_some((i, x.op));
    program.instructions.iter().enumerate().filter_map(of_level)
}

/// Executes a level above or below the pixels; `leaf` gives what reads no values.
fn execute<N: Number>(program: &Program, level: Level, cells: &mut [Cell<N>], leaf: impl Fn(Op) -> Option<N>) {
    for (i, op) in at_level(program, level) {
        cells[i] = leaf(op).map_or_else(|| apply(op, cells), Cell::Number);
    }
}

/// An operation that reads only values.
fn apply<N: Number>(op: Op, cells: &[Cell<N>]) -> Cell<N> {
    let n = |v: Value| cells[v.index()].number();
    let t = |v: Value| cells[v.index()].truth();
    Cell::Number(match op {
        Op::Const(x) => x.into(),
        Op::Neg(a) => -n(a),
        Op::Abs(a) => n(a).abs(),
        Op::Sqrt(a) => n(a).sqrt(),
        Op::Add(a, b) => n(a) + n(b),
        Op::Sub(a, b) => n(a) - n(b),
        Op::Mul(a, b) => n(a) * n(b),
        Op::Div(a, b) => n(a) / n(b),
        Op::Fma(a, b, c) => n(a) * n(b) + n(c),
        Op::Call1(f, a) => n(a).call1(f),
        Op::Call2(f, a, b) => n(a).call2(f, n(b)),
        Op::Compare(c, a, b) => return Cell::Truth(holds(c, n(a), n(b))),
        Op::And(a, b) => return Cell::Truth(t(a) && t(b)),
        Op::Or(a, b) => return Cell::Truth(t(a) || t(b)),
        Op::Not(a) => return Cell::Truth(!t(a)),
        Op::Select(c, a, b) => return cells[if t(c) { a } else { b }.index()],
        Op::Input(_) | Op::Outer(_) | Op::Offset(_) | Op::Channel(_) => N::from(f64::NAN),
        Op::RowTotal(_) | Op::RowCount | Op::PassTotal(_) | Op::PassCount => N::from(f64::NAN),
    })
}
