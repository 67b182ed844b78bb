//! The meaning of a [`Program`]: what comes in is a program, numbers and pixels; what goes out are the sums that native
//! code must equal bit for bit. It is written to be read, not to be fast.

use crate::program::elementary::{Accuracy, MAGIC, Plain};
use crate::program::{Bindings, Instruction, Level, Op, Precision, Program, Sink, Value};
use crate::proof::evaluate::holds;

/// Where pixels come from. Coordinates are those of the whole plane.
pub trait Pixels {
    /// The pixel of a channel of a picture, as stored; f32 and integers are exact in f64.
    fn at(&self, channel: usize, x: usize, y: usize) -> f64;

    /// The pixel at (x, y, z, w). What has no slices is the same in all of them.
    fn at_place(&self, channel: usize, [x, y, ..]: [usize; 4]) -> f64 {
        self.at(channel, x, y)
    }
}

/// The third and fourth coordinate of a window: which slices of which volumes.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Slices {
    /// First slice, first volume.
    pub first: [usize; 2],
    /// How many slices of each volume, how many volumes.
    pub count: [usize; 2],
}

impl Slices {
    /// The one slice of a picture.
    pub const ONE: Slices = Slices { first: [0, 0], count: [1, 1] };
    /// As many as there are.
    pub const ALL: Slices = Slices { first: [0, 0], count: [usize::MAX, usize::MAX] };
}

/// A rectangle of pixels, in one slice or in several.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Window {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Slices; more than one only for a program of more than two coordinates.
    pub slices: Slices,
}

/// What a run hands back.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Outcome {
    /// The program's outputs; empty for a plane.
    pub outputs: Vec<f64>,
    /// Pixels used.
    pub pixels: u64,
    /// Pixels of the set that were left out as saturated.
    pub saturated: u64,
}

/// Rounds to the nearest integer, ties to even, for magnitudes below 2⁵¹; larger ones come back nearly as they are.
pub fn nearest(x: f64) -> f64 {
    (x + MAGIC) - MAGIC
}

/// The arithmetic of one lane.
trait Lane: Copy {
    /// How exact elementary functions are before they are rounded.
    const ACCURACY: Accuracy;
    fn from_f64(x: f64) -> Self;
    fn to_f64(self) -> f64;
    fn add(self, b: Self) -> Self;
    fn sub(self, b: Self) -> Self;
    fn mul(self, b: Self) -> Self;
    fn div(self, b: Self) -> Self;
    fn fma(self, b: Self, c: Self) -> Self;
    fn sqrt(self) -> Self;
    fn neg(self) -> Self;
    fn abs(self) -> Self;
}

macro_rules! lane {
    ($type:ty, $accuracy:expr) => {
        impl Lane for $type {
            const ACCURACY: Accuracy = $accuracy;
            fn from_f64(x: f64) -> Self {
                x as $type
            }
            fn to_f64(self) -> f64 {
                f64::from(self)
            }
            fn add(self, b: Self) -> Self {
                self + b
            }
            fn sub(self, b: Self) -> Self {
                self - b
            }
            fn mul(self, b: Self) -> Self {
                self * b
            }
            fn div(self, b: Self) -> Self {
                self / b
            }
            fn fma(self, b: Self, c: Self) -> Self {
                self.mul_add(b, c)
            }
            fn sqrt(self) -> Self {
                <$type>::sqrt(self)
            }
            fn neg(self) -> Self {
                -self
            }
            fn abs(self) -> Self {
                <$type>::abs(self)
            }
        }
    };
}
lane!(f32, Accuracy::Single);
lane!(f64, Accuracy::Double);

/// A value: a number or a truth value.
#[derive(Clone, Copy)]
enum Cell<T> {
    Number(T),
    Truth(bool),
}

impl<T: Lane> Cell<T> {
    fn number(self) -> T {
        match self {
            Cell::Number(x) => x,
            Cell::Truth(b) => T::from_f64(f64::from(u8::from(b))),
        }
    }
    fn truth(self) -> bool {
        matches!(self, Cell::Truth(true))
    }
}

/// An operation that reads only values; elementary functions compute on `machine`.
fn apply<T: Lane>(op: Op, machine: Plain, at: impl Fn(Value) -> Cell<T>) -> Cell<T> {
    let n = |v: Value| at(v).number();
    Cell::Number(match op {
        Op::Const(x) => T::from_f64(x),
        Op::Neg(a) => n(a).neg(),
        Op::Abs(a) => n(a).abs(),
        Op::Sqrt(a) => n(a).sqrt(),
        Op::Add(a, b) => n(a).add(n(b)),
        Op::Sub(a, b) => n(a).sub(n(b)),
        Op::Mul(a, b) => n(a).mul(n(b)),
        Op::Div(a, b) => n(a).div(n(b)),
        Op::Fma(a, b, c) => n(a).fma(n(b), n(c)),
        Op::Call1(f, a) => T::from_f64(f.value_with(machine, T::ACCURACY, n(a).to_f64())),
        Op::Call2(f, a, b) => T::from_f64(f.value_with(machine, T::ACCURACY, n(a).to_f64(), n(b).to_f64())),
        Op::Compare(c, a, b) => return Cell::Truth(holds(c, n(a).to_f64(), n(b).to_f64())),
        Op::And(a, b) => return Cell::Truth(at(a).truth() && at(b).truth()),
        Op::Or(a, b) => return Cell::Truth(at(a).truth() || at(b).truth()),
        Op::Not(a) => return Cell::Truth(!at(a).truth()),
        Op::Select(c, a, b) => return if at(c).truth() { at(a) } else { at(b) },
        _ => T::from_f64(f64::NAN),
    })
}

/// Runs a program over a window. `plane` is the output of a plane program: a value for each pixel of the window, added to.
pub fn run(
    program: &Program,
    precision: Precision,
    bindings: &Bindings<'_>,
    pixels: &dyn Pixels,
    window: Window,
    plane: Option<&mut [f32]>,
) -> Outcome {
    match precision {
        Precision::F32 => run_lanes::<f32, 4>(program, bindings, pixels, window, plane),
        Precision::F64 => run_lanes::<f64, 2>(program, bindings, pixels, window, plane),
    }
}

/// The same with another number of lanes, which exported source may have: 1, 2, 4, 8 or 16; `None` for any other.
pub fn run_in_lanes(
    program: &Program,
    precision: Precision,
    lanes: usize,
    bindings: &Bindings<'_>,
    pixels: &dyn Pixels,
    window: Window,
    plane: Option<&mut [f32]>,
) -> Option<Outcome> {
    macro_rules! of {
        ($lane:ty, $count:literal) => {
            Some(run_lanes::<$lane, $count>(program, bindings, pixels, window, plane))
        };
    }
    match (precision, lanes) {
        (Precision::F32, 1) => of!(f32, 1),
        (Precision::F32, 2) => of!(f32, 2),
        (Precision::F32, 4) => of!(f32, 4),
        (Precision::F32, 8) => of!(f32, 8),
        (Precision::F32, 16) => of!(f32, 16),
        (Precision::F64, 1) => of!(f64, 1),
        (Precision::F64, 2) => of!(f64, 2),
        (Precision::F64, 4) => of!(f64, 4),
        (Precision::F64, 8) => of!(f64, 8),
        (Precision::F64, 16) => of!(f64, 16),
        _ => None,
    }
}

struct Scalars<'a> {
    program: &'a Program,
    inputs: Vec<f64>,
    cells: Vec<Cell<f64>>,
}

impl Scalars<'_> {
    /// Executes every instruction of a level; `leaf` gives those that read no values.
    fn execute(&mut self, level: Level, leaf: &dyn Fn(Op) -> Option<f64>) {
        for (i, Instruction { op, .. }) in
            self.program.instructions.iter().enumerate().filter(|(_, x)| x.level == level)
        {
            self.cells[i] = match (*op, leaf(*op)) {
                (Op::Input(input), _) => Cell::Number(self.inputs[input.index()]),
                (_, Some(value)) => Cell::Number(value),
                (op, None) => apply(op, Plain { fused: false }, |v| self.cells[v.index()]),
            };
        }
    }
    fn number(&self, value: Value) -> f64 {
        self.cells[value.index()].number()
    }
}

/// First and last pixel of the row, relative to the window.
fn row_range(scalars: &Scalars<'_>, window: Window) -> Option<(usize, usize)> {
    let Some((lo, hi)) = scalars.program.pixel_set.bounds else { return Some((0, window.width - 1)) };
    let (lo, hi) = (scalars.number(lo), scalars.number(hi));
    let (first, last) = (window.x as f64, (window.x + window.width - 1) as f64);
    // A NaN fails the comparison and empties the row.
    let ordered = |a: f64, b: f64| a <= b;
    if !ordered(lo, hi) {
        return None;
    }
    let lo = if lo > first { lo } else { first };
    let hi = if hi < last { hi } else { last };
    if !ordered(lo, hi) {
        return None;
    }
    let distance = lo - first;
    let mut start = distance as i64;
    start += i64::from((start as f64) < distance);
    let end = (hi - first) as i64;
    (start <= end).then_some((start as usize, end as usize))
}

fn run_lanes<T: Lane, const L: usize>(
    program: &Program,
    bindings: &Bindings<'_>,
    pixels: &dyn Pixels,
    window: Window,
    mut plane: Option<&mut [f32]>,
) -> Outcome {
    let count = program.instructions.len();
    let machine = Plain { fused: program.fused };
    let mut scalars =
        Scalars { program, inputs: program.gather(bindings).collect(), cells: vec![Cell::Number(0.0); count] };
    let (accumulators, totals, outputs) = match &program.sink {
        Sink::Sums { accumulators, totals, outputs } => {
            (accumulators.as_slice(), totals.as_slice(), outputs.as_slice())
        }
        Sink::Plane(_) => (&[][..], &[][..], &[][..]),
    };
    let contractions = program.contractions();
    let mut outcome = Outcome::default();
    let mut pass_totals = vec![0.0_f64; totals.len()];
    scalars.execute(Level::Pass, &|_| None);
    if window.width == 0 {
        return outcome;
    }
    let [depth, length] = match program.coordinates {
        0..=2 => [1, 1],
        3 => [window.slices.count[0], 1],
        _ => window.slices.count,
    };
    for row in 0..window.height * depth * length {
        let (slice, y) = (row / window.height, window.y + row % window.height);
        let [z, w] = [window.slices.first[0] + slice % depth, window.slices.first[1] + slice / depth];
        let outer = |op: Op| match op {
            Op::Outer(c) => Some([f64::NAN, y as f64, z as f64, w as f64][c.index()]),
            _ => None,
        };
        scalars.execute(Level::Row, &outer);
        let Some((start, end)) = row_range(&scalars, window) else { continue };
        let mut lanes: Vec<[Cell<T>; L]> = scalars.cells.iter().map(|c| [rounded(*c); L]).collect();
        let mut sums = vec![[T::from_f64(0.0); L]; accumulators.len()];
        let mut offsets: Vec<(usize, [T; L], T)> = Vec::new();
        for (i, instruction) in program.instructions.iter().enumerate() {
            if let Op::Offset(c) = instruction.op {
                let c = scalars.number(c);
                let n = nearest(-c);
                let base = T::from_f64((window.x + start) as f64 - n);
                let lane = std::array::from_fn(|l| base.add(T::from_f64(l as f64)));
                offsets.push((i, lane, T::from_f64(c + n)));
            }
        }
        let mut used_in_row = 0_u64;
        // All groups but the last are full. The last one has the pixels from `rest` on; where it would leave the window it
        // begins further left, and the lanes before `rest` take no part either.
        let rest = start + (end - start) / L * L;
        let last = rest.min(window.width.saturating_sub(L));
        for group in (start..rest).step_by(L).chain([last]) {
            let is_last = group == last;
            let shift = T::from_f64(last as f64 - rest as f64);
            for (i, lane, fraction) in &mut offsets {
                let here = if is_last { lane.map(|t| t.add(shift)) } else { *lane };
                lanes[*i] = here.map(|t| Cell::Number(t.add(*fraction)));
                *lane = lane.map(|t| t.add(T::from_f64(L as f64)));
            }
            for (i, Instruction { op, .. }) in
                program.instructions.iter().enumerate().filter(|(_, x)| x.level == Level::Pixel)
            {
                lanes[i] = match *op {
                    Op::Offset(_) => lanes[i],
                    Op::Channel(c) => std::array::from_fn(|l| {
                        let x = window.x + (group + l).min(window.width - 1);
                        Cell::Number(T::from_f64(pixels.at_place(c.index(), [x, y, z, w])))
                    }),
                    op => std::array::from_fn(|l| apply(op, machine, |v| lanes[v.index()][l])),
                };
            }
            let alive = if is_last { rest..=end } else { group..=end };
            for l in (0..L).filter(|l| alive.contains(&(group + l))) {
                let holds = |v: Option<Value>, otherwise: bool| v.map_or(otherwise, |v| lanes[v.index()][l].truth());
                if !holds(program.pixel_set.mask, true) {
                    continue;
                }
                if holds(program.pixel_set.saturated, false) {
                    outcome.saturated += 1;
                    continue;
                }
                used_in_row += 1;
                for ((sum, value), factors) in sums.iter_mut().zip(accumulators).zip(&contractions) {
                    let number = |v: Value| lanes[v.index()][l].number();
                    sum[l] = match *factors {
                        Some((a, b)) => number(a).fma(number(b), sum[l]),
                        None => sum[l].add(number(*value)),
                    };
                }
                if let (Sink::Plane(value), Some(plane)) = (&program.sink, plane.as_deref_mut()) {
                    plane[row * window.width + group + l] += lanes[value.index()][l].number().to_f64() as f32;
                }
            }
        }
        if used_in_row == 0 {
            continue;
        }
        outcome.pixels += used_in_row;
        // The upper half of the lanes is added to the lower one until one is left.
        let row_total = |lanes: &[T; L]| {
            let mut sum = lanes.map(T::to_f64);
            let mut half = L / 2;
            while half > 0 {
                (0..half).for_each(|l| sum[l] += sum[l + half]);
                half /= 2;
            }
            sum[0]
        };
        let leaf = |op: Op| match op {
            Op::RowTotal(a) => Some(row_total(&sums[a.index()])),
            Op::RowCount => Some(used_in_row as f64),
            _ => None,
        };
        scalars.execute(Level::RowEnd, &leaf);
        for (total, value) in pass_totals.iter_mut().zip(totals) {
            *total += scalars.number(*value);
        }
    }
    let leaf = |op: Op| match op {
        Op::PassTotal(t) => Some(pass_totals[t.index()]),
        Op::PassCount => Some(outcome.pixels as f64),
        _ => None,
    };
    scalars.execute(Level::PassEnd, &leaf);
    outcome.outputs = outputs.iter().map(|v| scalars.number(*v)).collect();
    outcome
}

fn rounded<T: Lane>(cell: Cell<f64>) -> Cell<T> {
    match cell {
        Cell::Number(x) => Cell::Number(T::from_f64(x)),
        Cell::Truth(b) => Cell::Truth(b),
    }
}
