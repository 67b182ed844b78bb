//! Random programs: every operation at every level that has it, by the rules of `Program::check` alone, independent of
//! meaning and compilation.
#![allow(dead_code, clippy::unwrap_used)]

use super::{Random, tables};
use isophote_symbolic::{
    AccumulatorId, ChannelId, ConstantId, CoordinateId, Input, InputId, Instruction, Kind, Level, LoopNest, Op, Opcode,
    ParameterId, PixelSet, Program, Sink, TotalId, Value,
};
use std::mem::discriminant;

/// Limits of a program.
#[derive(Clone, Copy)]
pub struct Variety {
    pub fma: bool,
    pub calls: bool,
    pub tables: bool,
    /// Instructions of pass, row and pixel.
    pub lengths: [usize; 3],
    /// Maximum number of sums.
    pub sums: usize,
}

const LEVELS: [Level; 5] = [Level::Pass, Level::Row, Level::Pixel, Level::RowEnd, Level::PassEnd];

/// A program under construction: numbers and truth values by level.
struct Draft<'r> {
    random: &'r mut Random,
    variety: Variety,
    /// Numbers of coordinates, channels, inputs; of accumulators and totals once chosen.
    sizes: [usize; 5],
    instructions: Vec<Instruction>,
    kinds: Vec<bool>,
}

impl Draft<'_> {
    fn push(&mut self, level: Level, op: Op, truth: bool) -> Value {
        self.instructions.push(Instruction { op, level, span: None });
        self.kinds.push(truth);
        Value(self.kinds.len() as u32 - 1)
    }

    /// A value that `level` may read, most often a late one.
    fn value(&mut self, level: Level, truth: bool) -> Option<Value> {
        let readable = |from: Level| match from {
            Level::Pass => true,
            Level::Row => !matches!(level, Level::Pass | Level::PassEnd),
            from => from == level,
        };
        let fits = |i: &usize| readable(self.instructions[*i].level) && self.kinds[*i] == truth;
        let all: Vec<usize> = (0..self.kinds.len()).filter(fits).collect();
        let recent = if self.random.below(3) > 0 { all.len().saturating_sub(8) } else { 0 };
        let at = recent + self.random.below((all.len() - recent).max(1));
        all.get(at).map(|i| Value(*i as u32))
    }

    /// An operation without operands.
    fn leaf(&mut self, level: Level) -> Op {
        let [coordinates, channels, inputs, accumulators, totals] = self.sizes;
        let number = if self.random.below(20) == 0 { self.random.special() } else { self.random.ordinary() };
        let mut below = |n: usize| self.random.below(n.max(1)) as u32;
        let code = match (level, below(4)) {
            (_, 0) => Opcode::number(number),
            (Level::Pass, _) if inputs > 0 => Opcode::Input(InputId(below(inputs))),
            (Level::Row, _) => Opcode::Outer(CoordinateId(1 + below(coordinates.max(2) - 1))),
            (Level::Pixel, _) if channels > 0 => Opcode::Channel(ChannelId(below(channels))),
            (Level::RowEnd, 1..=2) if accumulators > 0 => Opcode::RowTotal(AccumulatorId(below(accumulators))),
            (Level::RowEnd, _) => Opcode::RowCount,
            (Level::PassEnd, 1..=2) if totals > 0 => Opcode::PassTotal(TotalId(below(totals))),
            (Level::PassEnd, _) => Opcode::PassCount,
            _ => Opcode::number(number),
        };
        code.of([])
    }

    /// Relative frequency of an operation: those that seldom yield NaN are drawn more often.
    fn weight(&self, code: Opcode) -> usize {
        match code {
            Opcode::Fma if !self.variety.fma => 0,
            Opcode::Call1(_) | Opcode::Call2(_) if !self.variety.calls => 0,
            Opcode::Gather(_) if !self.variety.tables => 0,
            Opcode::Add => 6,
            Opcode::Sub | Opcode::Mul | Opcode::Fma | Opcode::Select | Opcode::Compare(_) => 3,
            Opcode::Offset => 3,
            _ => 1,
        }
    }

    /// An operation that gives a number or a truth value at a level.
    fn code(&mut self, level: Level, truth: bool) -> Opcode {
        let gives = |kind: Kind| kind == Kind::Either || (kind == Kind::Truth) == truth;
        let mut drawn: Vec<Vec<Opcode>> = Vec::new();
        for code in Opcode::every() {
            let row = code.row();
            if row.operands.is_empty() || row.level.is_some_and(|only| only != level) || !gives(row.result) {
                continue;
            }
            match drawn.last_mut().filter(|all| discriminant(&all[0]) == discriminant(&code)) {
                Some(all) => all.push(code),
                None => drawn.push(vec![code]),
            }
        }
        let weighted: Vec<usize> = (0..drawn.len()).flat_map(|i| vec![i; self.weight(drawn[i][0])]).collect();
        let all = &drawn[*self.random.pick(&weighted)];
        *self.random.pick(all)
    }

    fn instruction(&mut self, level: Level) {
        let truth = self.random.below(5) == 0;
        let code = self.code(level, truth);
        let mut operand = |kind: &Kind| match kind {
            Kind::Number => self.value(level, false),
            Kind::Truth => self.value(level, true),
            Kind::Either => self.value(level, truth),
            Kind::OfRow => self.value(Level::Row, false),
        };
        let operands: Option<Vec<Value>> = code.row().operands.iter().map(&mut operand).collect();
        match operands.filter(|_| truth || self.random.below(22) > 3).as_deref() {
            Some(&[a]) => self.push(level, code.of([a]), truth),
            Some(&[a, b]) => self.push(level, code.of([a, b]), truth),
            Some(&[a, b, c]) => self.push(level, code.of([a, b, c]), truth),
            _ => {
                let leaf = self.leaf(level);
                self.push(level, leaf, false)
            }
        };
    }

    /// A few instructions of a level, with at least one number that it can read.
    fn level(&mut self, level: Level, count: usize) {
        for _ in 0..count {
            self.instruction(level);
        }
        let leaf = self.leaf(level);
        self.push(level, leaf, false);
    }

    fn several(&mut self, level: Level, most: usize) -> Vec<Value> {
        (0..self.random.below(most + 1)).filter_map(|_| self.value(level, false)).collect()
    }
}

/// A program; `renders`: into a plane.
pub fn program(random: &mut Random, variety: Variety, renders: bool) -> Program {
    let sizes = [1 + random.below(4), if renders { 0 } else { random.below(3) }, random.below(6), 0, 0];
    let input = |random: &mut Random, i: usize| match random.below(5) {
        0 | 1 => Input::Parameter(ParameterId(i as u32)),
        2 => Input::Entry(ParameterId(i as u32)),
        3 => Input::Constant(ConstantId(i as u32)),
        _ if sizes[1] > 0 => Input::Saturation(ChannelId((i % sizes[1]) as u32)),
        _ => Input::Shift(CoordinateId((i % sizes[0]) as u32)),
    };
    let inputs: Vec<Input> = (0..sizes[2]).map(|i| input(random, i)).collect();
    let mut draft = Draft { random, variety, sizes, instructions: Vec::new(), kinds: Vec::new() };
    for (level, count) in LEVELS.into_iter().zip(variety.lengths) {
        draft.level(level, count);
    }
    let often = |draft: &mut Draft<'_>| draft.random.below(3) == 0;
    let truth = |draft: &mut Draft<'_>| often(draft).then(|| draft.value(Level::Pixel, true)).flatten();
    let (mask, saturated) = (truth(&mut draft), truth(&mut draft));
    let bounds = match draft.random.below(3) {
        0 => draft.value(Level::Row, false).zip(draft.value(Level::Row, false)),
        _ => None,
    };
    let sink = if renders {
        Sink::Plane(draft.value(Level::Pixel, false).unwrap())
    } else {
        // Every sum is also an output of its own: otherwise one NaN hides them all.
        let accumulators = draft.several(Level::Pixel, variety.sums);
        draft.sizes[3] = accumulators.len();
        let count = 1 + draft.random.below(8);
        draft.level(Level::RowEnd, count);
        let mut totals = draft.several(Level::RowEnd, 3);
        let all = (0..draft.sizes[3] as u32).map(|i| Opcode::RowTotal(AccumulatorId(i)).of([]));
        totals.extend(all.map(|op| draft.push(Level::RowEnd, op, false)));
        draft.sizes[4] = totals.len();
        let count = 1 + draft.random.below(8);
        draft.level(Level::PassEnd, count);
        let mut outputs = draft.several(Level::PassEnd, 5);
        let all = (0..draft.sizes[4] as u32).map(|i| Opcode::PassTotal(TotalId(i)).of([]));
        outputs.extend(all.map(|op| draft.push(Level::PassEnd, op, false)));
        Sink::Sums { accumulators, totals, outputs }
    };
    let instructions = draft.instructions;
    let [coordinates, channels, ..] = sizes.map(|n| n as u32);
    let pixel_set = PixelSet { bounds, mask, saturated };
    let fused = variety.fma;
    Program::of(LoopNest {
        coordinates,
        channels,
        inputs,
        tables: tables(),
        instructions,
        pixel_set,
        sink,
        names: Default::default(),
        fused,
    })
    .unwrap()
}
