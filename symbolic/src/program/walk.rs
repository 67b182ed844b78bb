//! The loop nest, walked: the one place that says in which order a program's instructions run, over which pixels, and what
//! becomes of their values.
//!
//! What comes in: a program, taken apart, and a [`Walk`], which says in which arithmetic, over which rows and pixels, and with how many lanes.
//! What goes out: outputs and counts. [`crate::program::interpreter`] walks in the lanes of machine code, bit for bit;
//! [`crate::proof::evaluate`] in exact arithmetic, at any numbers. It must never know: what an operation does (the table in
//! [`crate::program::op`]), or where pixels come from.

use isophote_elementary::Tables;

use crate::program::arithmetic::{Cell, Number};
use crate::program::op::{Op, Opcode, apply};
use crate::program::{ChannelId, CoordinateId, InputId, Level, PixelSet, Program, Sink, Value};

/// A pixel of a row: its column, and the lane that sums it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Place {
    pub column: usize,
    pub lane: usize,
}

/// How a program is walked.
pub(crate) trait Walk {
    /// The arithmetic of pass and row and of their ends.
    type Outer: Number;
    /// That of the pixels.
    type Inner: Number;

    fn lanes(&self) -> usize;
    fn rows(&self) -> usize;
    /// How many rows have totals of their own until the end of the pass, a power of two.
    fn rows_apart(&self) -> usize;
    /// The pixels of a row from the first of two numbers to the second, in the order of their sums.
    fn places(&self, bounds: Option<[Self::Outer; 2]>) -> Vec<Place>;
    fn input(&self, input: InputId) -> Self::Outer;
    fn coordinate(&self, coordinate: CoordinateId, row: usize) -> Self::Outer;
    /// The inner coordinate plus `c` at each of a row's places.
    fn offset(&self, places: &[Place], c: Self::Outer) -> Vec<Self::Inner>;
    fn pixel(&self, channel: ChannelId, column: usize, row: usize) -> Self::Inner;
    /// What the pixel loop reads of a number that is known outside of it.
    fn rounded(&self, x: Self::Outer) -> Self::Inner;
    /// The lanes of a row's sum, together.
    fn total(&self, lanes: &[Self::Inner]) -> Self::Outer;
    /// A pixel takes part; `shown` is what it adds to a plane.
    fn takes(&mut self, column: usize, row: usize, shown: Option<Self::Inner>);
}

/// What a walk hands back.
pub(crate) struct Walked<N> {
    /// Empty for a plane.
    pub outputs: Vec<N>,
    /// Pixels that took part.
    pub pixels: u64,
    /// Pixels of the set that were left out as saturated.
    pub saturated: u64,
}

/// A program taken apart, for one walk after another.
pub(crate) struct LoopNest<'p> {
    program: &'p Program,
    /// By level, in order; the offsets of the inner coordinate stand apart.
    instructions: [Vec<(usize, Op)>; 5],
    offsets: Vec<(usize, Value)>,
    contractions: Vec<Option<(Value, Value)>>,
}

impl<'p> LoopNest<'p> {
    pub fn of(program: &'p Program) -> LoopNest<'p> {
        let mut loops = LoopNest {
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

    pub fn program(&self) -> &'p Program {
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

/// The sum of so many numbers: the upper half is added to the lower one until one is left.
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
pub(crate) fn walk<W: Walk>(loops: &LoopNest<'_>, set: &PixelSet, walk: &mut W) -> Walked<W::Outer> {
    let program = loops.program;
    let tables = &program.tables;
    // The check refuses a leaf at another level than its own.
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
        // What a row without pixels knows may be NaN, which no product with an empty sum makes 0.
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
