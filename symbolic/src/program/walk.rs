//! Walks the loop nest: the single definition of a program's execution order, its pixels, and the use of their values.
//!
//! A [`Walk`] chooses the arithmetic, the rows and pixels, and the lanes. [`crate::program::interpreter`] walks in the
//! lanes of machine code, bit for bit; [`crate::proof::evaluate`] in exact arithmetic, at any numbers. The table in
//! [`crate::program::op`] defines the operations.

use isophote_elementary::Tables;

use crate::program::arithmetic::{Cell, Number};
use crate::program::op::{Op, Opcode, apply};
use crate::program::{ChannelId, CoordinateId, InputId, Level, LoopNest, PixelSet, Sink, Value};

/// A pixel of a row: its column, and the lane that sums it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Place {
    pub column: usize,
    pub lane: usize,
}

/// Arithmetic and iteration of a walk.
pub(crate) trait Walk {
    /// The number type of pass, row, and their ends.
    type Outer: Number;
    /// The number type of pixels.
    type Inner: Number;

    fn lanes(&self) -> usize;
    fn rows(&self) -> usize;
    /// Rows of a block with separate pass totals, a power of two.
    fn rows_apart(&self) -> usize;
    /// The pixels of a row within `bounds`, in summation order.
    fn places(&self, bounds: Option<[Self::Outer; 2]>) -> Vec<Place>;
    fn input(&self, input: InputId) -> Self::Outer;
    fn coordinate(&self, coordinate: CoordinateId, row: usize) -> Self::Outer;
    /// The inner coordinate plus `c` at each of `places`.
    fn offset(&self, places: &[Place], c: Self::Outer) -> Vec<Self::Inner>;
    fn pixel(&self, channel: ChannelId, column: usize, row: usize) -> Self::Inner;
    /// An outer value as the pixel loop reads it.
    fn rounded(&self, x: Self::Outer) -> Self::Inner;
    /// Sums the lanes of a row.
    fn total(&self, lanes: &[Self::Inner]) -> Self::Outer;
    /// Records a pixel that takes part; `shown` is what it adds to a plane.
    fn takes(&mut self, column: usize, row: usize, shown: Option<Self::Inner>);
}

/// Result of a walk.
pub(crate) struct Walked<N> {
    /// Empty for a plane.
    pub outputs: Vec<N>,
    /// Pixels that took part.
    pub pixels: u64,
    /// Saturated pixels left out of the set.
    pub saturated: u64,
}

/// A program split by level, for repeated walks.
pub(crate) struct ByLevel<'p> {
    program: &'p LoopNest,
    /// By level, in order, without the offsets of the inner coordinate.
    instructions: [Vec<(usize, Op)>; 5],
    offsets: Vec<(usize, Value)>,
    contractions: Vec<Option<(Value, Value)>>,
}

impl<'p> ByLevel<'p> {
    pub fn of(program: &'p LoopNest) -> ByLevel<'p> {
        let mut loops = ByLevel {
            program,
            instructions: Default::default(),
            offsets: Vec::new(),
            contractions: program.contractions(),
        };
        for (i, instruction) in program.instructions.iter().enumerate() {
            match instruction.op.parts() {
                (Opcode::Offset, &[c]) if instruction.level == Level::Pixel => loops.offsets.push((i, c)),
                _ => loops.instructions[instruction.level as usize].push((i, instruction.op)),
            }
        }
        loops
    }

    pub fn program(&self) -> &'p LoopNest {
        self.program
    }

    fn level(&self, level: Level) -> &[(usize, Op)] {
        &self.instructions[level as usize]
    }
}

fn execute<N: Number>(ops: &[(usize, Op)], tables: &Tables, cells: &mut [Cell<N>], leaf: impl Fn(Op) -> N) {
    for (i, op) in ops {
        cells[*i] = match op.parts() {
            (Opcode::Gather(lookup), &[a, b]) => {
                let [a, b] = [a, b].map(|v| cells[v.index()].number());
                Cell::Number(a.look_up(b, tables, lookup))
            }
            _ => apply(*op, cells, &leaf),
        };
    }
}

/// Sums by adding the upper half to the lower one until one is left.
pub(crate) fn folded<N: Number>(numbers: &[N]) -> N {
    let mut sum = numbers.to_vec();
    let mut half = sum.len() / 2;
    while half > 0 {
        (0..half).for_each(|i| sum[i] = sum[i] + sum[i + half]);
        half /= 2;
    }
    sum[0]
}

/// Walks a program over the pixels of `set`.
pub(crate) fn walk<W: Walk>(loops: &ByLevel<'_>, set: &PixelSet, walk: &mut W) -> Walked<W::Outer> {
    let program = loops.program;
    let tables = &program.tables;
    // The check rejects a leaf at another level than its own.
    let nowhere = || W::Outer::from(f64::NAN);
    let (accumulators, totals, outputs) = match &program.sink {
        Sink::Sums { accumulators, totals, outputs } => (&accumulators[..], &totals[..], &outputs[..]),
        Sink::Plane(_) => (&[][..], &[][..], &[][..]),
    };
    let factors = |i: usize| loops.contractions.get(i).copied().flatten();
    let mut cells = vec![Cell::Number(W::Outer::from(0.0)); program.instructions.len()];
    let mut lanes = vec![Cell::Number(W::Inner::from(0.0)); program.instructions.len()];
    let apart = walk.rows_apart();
    let mut pass_totals = vec![W::Outer::from(0.0); totals.len() * apart];
    let mut walked = Walked { outputs: Vec::new(), pixels: 0, saturated: 0 };

    let pass_level = loops.level(Level::Pass);
    execute(pass_level, tables, &mut cells, |op| match op.code {
        Opcode::Input(input) => walk.input(input),
        _ => nowhere(),
    });
    pass_level.iter().for_each(|(i, _)| lanes[*i] = cells[*i].map(|x| walk.rounded(x)));
    for row in 0..walk.rows() {
        let row_level = loops.level(Level::Row);
        execute(row_level, tables, &mut cells, |op| match op.code {
            Opcode::Outer(c) => walk.coordinate(c, row),
            _ => nowhere(),
        });
        row_level.iter().for_each(|(i, _)| lanes[*i] = cells[*i].map(|x| walk.rounded(x)));
        let number = |v: Value| cells[v.index()].number();
        let places = walk.places(set.bounds.map(|(lo, hi)| [number(lo), number(hi)]));
        let along: Vec<_> = loops.offsets.iter().map(|(i, c)| (*i, walk.offset(&places, number(*c)))).collect();
        let width = walk.lanes();
        let mut sums = vec![W::Inner::from(0.0); width * accumulators.len()];
        let mut used = 0;
        for (at, Place { column, lane }) in places.into_iter().enumerate() {
            along.iter().for_each(|(i, values)| lanes[*i] = Cell::Number(values[at]));
            execute(loops.level(Level::Pixel), tables, &mut lanes, |op| match op.code {
                Opcode::Channel(channel) => walk.pixel(channel, column, row),
                _ => W::Inner::from(f64::NAN),
            });
            let holds = |v: Value| lanes[v.index()].truth();
            if !set.mask.is_none_or(holds) {
                continue;
            }
            if set.saturated.is_some_and(holds) {
                walked.saturated += 1;
                continue;
            }
            used += 1;
            let number = |v: Value| lanes[v.index()].number();
            for (i, value) in accumulators.iter().enumerate() {
                let sum = &mut sums[width * i + lane];
                *sum = match factors(i) {
                    Some((a, b)) => number(a).fma(number(b), *sum),
                    None => *sum + number(*value),
                };
            }
            let shown = match program.sink {
                Sink::Plane(value) => Some(number(value)),
                Sink::Sums { .. } => None,
            };
            walk.takes(column, row, shown);
        }
        // Row values may be NaN in a row without pixels, and NaN times an empty sum is not 0.
        if used == 0 {
            continue;
        }
        walked.pixels += used;
        execute(loops.level(Level::RowEnd), tables, &mut cells, |op| match op.code {
            Opcode::RowTotal(a) => walk.total(&sums[width * a.index()..][..width]),
            Opcode::RowCount => W::Outer::from(used as f64),
            _ => nowhere(),
        });
        for (total, value) in pass_totals.iter_mut().skip(row % apart).step_by(apart).zip(totals) {
            *total = *total + cells[value.index()].number();
        }
    }
    let pass_totals: Vec<_> = pass_totals.chunks(apart).map(folded).collect();
    execute(loops.level(Level::PassEnd), tables, &mut cells, |op| match op.code {
        Opcode::PassTotal(t) => pass_totals[t.index()],
        Opcode::PassCount => W::Outer::from(walked.pixels as f64),
        _ => nowhere(),
    });
    walked.outputs = outputs.iter().map(|v| cells[v.index()].number()).collect();
    walked
}
