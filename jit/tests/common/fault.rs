//! Programs with one thing wrong, as a compiler's bug would have it.
#![allow(dead_code, clippy::unwrap_used)]

use super::Random;
use isophote_symbolic::{
    ChannelId, Comparison, CoordinateId, Instruction, Op, PixelSet, Program, ProgramParts, Sink, Value,
};

/// The program with one fault, and what it is; `None` where the choice has no fault to offer.
pub fn planted(program: &Program, random: &mut Random) -> Option<(String, Program)> {
    let live = live(program);
    let at = *random.pick(&live);
    let mut parts = ProgramParts {
        coordinates: program.coordinates() as u32,
        channels: program.channels() as u32,
        inputs: program.inputs().to_vec(),
        instructions: program.instructions().to_vec(),
        pixel_set: *program.pixel_set(),
        sink: program.sink().clone(),
        fused: program.is_fused(),
    };
    let what = match random.below(8) {
        0 => wrong_pixel_set(&mut parts.pixel_set, random)?,
        1 => wrong_sums(&mut parts.sink)?,
        _ => wrong_instruction(&mut parts, at, random)?,
    };
    Program::from_parts(parts).ok().map(|program| (what, program))
}

/// Instructions that something depends on; of a program without any, all.
fn live(program: &Program) -> Vec<usize> {
    let set = program.pixel_set();
    let mut roots: Vec<Value> = set.bounds.into_iter().flat_map(|(lo, hi)| [lo, hi]).collect();
    roots.extend(set.mask.into_iter().chain(set.saturated));
    match program.sink() {
        Sink::Sums { accumulators, totals, outputs } => {
            roots.extend([accumulators, totals, outputs].into_iter().flatten())
        }
        Sink::Plane(value) => roots.push(*value),
    }
    let needed = program.made_of(roots);
    let all: Vec<usize> = (0..needed.len()).filter(|i| needed[*i]).collect();
    if all.is_empty() { (0..needed.len()).collect() } else { all }
}

fn wrong_pixel_set(set: &mut PixelSet, random: &mut Random) -> Option<String> {
    let what = match random.below(4) {
        0 => set.mask.take().map(|_| "mask dropped"),
        1 => set.saturated.take().map(|_| "saturated pixels kept"),
        2 => set.bounds.take().map(|_| "bounds dropped"),
        _ => set.bounds.as_mut().map(|(lo, hi)| {
            std::mem::swap(lo, hi);
            "bounds swapped"
        }),
    };
    what.map(str::to_string)
}

fn wrong_sums(sink: &mut Sink) -> Option<String> {
    let Sink::Sums { accumulators, .. } = sink else { return None };
    let other = accumulators.iter().position(|value| *value != accumulators[0])?;
    accumulators.swap(0, other);
    Some("two sums swapped".into())
}

fn wrong_instruction(parts: &mut ProgramParts, at: usize, random: &mut Random) -> Option<String> {
    let before = parts.instructions[at].op;
    let coin = random.below(2) == 0;
    let after = match before {
        Op::Add(a, b) if coin => Op::Sub(a, b),
        Op::Add(a, b) => Op::Mul(a, b),
        Op::Sub(a, b) if coin => Op::Sub(b, a),
        Op::Sub(a, b) => Op::Add(a, b),
        Op::Mul(a, b) if coin => Op::Add(a, b),
        Op::Mul(a, b) => Op::Div(a, b),
        Op::Div(a, b) if coin => Op::Div(b, a),
        Op::Div(a, b) => Op::Mul(a, b),
        Op::Fma(a, b, c) if coin => {
            round_twice(parts, at, [a, b, c]);
            return Some(format!("v{at}: {before:?} rounded twice"));
        }
        Op::Fma(a, b, c) => Op::Fma(a, c, b),
        Op::Neg(a) => Op::Abs(a),
        Op::Abs(a) => Op::Neg(a),
        Op::Sqrt(a) => Op::Abs(a),
        Op::Compare(Comparison::Lt, a, b) if coin => Op::Compare(Comparison::Lt, b, a),
        Op::Compare(Comparison::Lt, a, b) => Op::Compare(Comparison::Le, a, b),
        Op::Compare(Comparison::Le, a, b) if coin => Op::Compare(Comparison::Le, b, a),
        Op::Compare(Comparison::Le, a, b) => Op::Compare(Comparison::Lt, a, b),
        Op::Compare(Comparison::Eq, a, b) => Op::Compare(Comparison::Ne, a, b),
        Op::Compare(Comparison::Ne, a, b) => Op::Compare(Comparison::Eq, a, b),
        Op::And(a, b) => Op::Or(a, b),
        Op::Or(a, b) => Op::And(a, b),
        Op::Not(a) => Op::And(a, a),
        Op::Select(c, a, b) => Op::Select(c, b, a),
        Op::Const(x) => Op::Const(x.abs() + 1.0),
        Op::Outer(c) if parts.coordinates > 2 => Op::Outer(CoordinateId(1 + c.0 % (parts.coordinates - 1))),
        Op::Channel(c) if parts.channels > 1 => Op::Channel(ChannelId((c.0 + 1) % parts.channels)),
        Op::RowCount => Op::Const(1.0),
        Op::PassCount => Op::Const(1.0),
        _ => return None,
    };
    parts.instructions[at].op = after;
    Some(format!("v{at}: {before:?} became {after:?}"))
}

/// a · b + c with the product rounded: one instruction more, so that every later value moves on by one.
fn round_twice(parts: &mut ProgramParts, at: usize, [a, b, c]: [Value; 3]) {
    let moved = |value: Value| Value(value.0 + u32::from(value.index() >= at));
    for instruction in &mut parts.instructions[at..] {
        instruction.op = with_operands(instruction.op, moved);
    }
    let Instruction { level, span, .. } = parts.instructions[at];
    parts.instructions[at].op = Op::Add(Value(at as u32), c);
    parts.instructions.insert(at, Instruction { op: Op::Mul(a, b), level, span });
    let set = &mut parts.pixel_set;
    set.bounds = set.bounds.map(|(lo, hi)| (moved(lo), moved(hi)));
    (set.mask, set.saturated) = (set.mask.map(moved), set.saturated.map(moved));
    match &mut parts.sink {
        Sink::Plane(value) => *value = moved(*value),
        Sink::Sums { accumulators, totals, outputs } => {
            [accumulators, totals, outputs].into_iter().flatten().for_each(|value| *value = moved(*value));
        }
    }
}

fn with_operands(op: Op, to: impl Fn(Value) -> Value) -> Op {
    match op {
        Op::Offset(a) => Op::Offset(to(a)),
        Op::Neg(a) => Op::Neg(to(a)),
        Op::Abs(a) => Op::Abs(to(a)),
        Op::Sqrt(a) => Op::Sqrt(to(a)),
        Op::Add(a, b) => Op::Add(to(a), to(b)),
        Op::Sub(a, b) => Op::Sub(to(a), to(b)),
        Op::Mul(a, b) => Op::Mul(to(a), to(b)),
        Op::Div(a, b) => Op::Div(to(a), to(b)),
        Op::Fma(a, b, c) => Op::Fma(to(a), to(b), to(c)),
        Op::Compare(comparison, a, b) => Op::Compare(comparison, to(a), to(b)),
        Op::And(a, b) => Op::And(to(a), to(b)),
        Op::Or(a, b) => Op::Or(to(a), to(b)),
        Op::Not(a) => Op::Not(to(a)),
        Op::Select(c, a, b) => Op::Select(to(c), to(a), to(b)),
        Op::Call1(f, a) => Op::Call1(f, to(a)),
        Op::Call2(f, a, b) => Op::Call2(f, to(a), to(b)),
        op => op,
    }
}
