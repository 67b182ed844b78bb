//! Programs with one planted fault, as a compiler's bug would cause it.
#![allow(dead_code, clippy::unwrap_used)]

use super::Random;
use isophote_symbolic::{
    ChannelId, Comparison, CoordinateId, Instruction, LoopNest, Opcode, PixelSet, Program, Sink, Value,
};

/// The program with one fault, and its description; `None` if the choice offers no fault.
pub fn planted(program: &Program, random: &mut Random) -> Option<(String, Program)> {
    let live = live(program);
    let at = *random.pick(&live);
    let mut nest = LoopNest::clone(program);
    let what = match random.below(8) {
        0 => wrong_pixel_set(&mut nest.pixel_set, random)?,
        1 => wrong_sums(&mut nest.sink)?,
        _ => wrong_instruction(&mut nest, at, random)?,
    };
    Program::of(nest).ok().map(|program| (what, program))
}

/// Live instructions; of a program without any, all.
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

fn wrong_instruction(nest: &mut LoopNest, at: usize, random: &mut Random) -> Option<String> {
    use Opcode::*;
    let before = nest.instructions[at].op;
    let coin = random.below(2) == 0;
    let after = match before.parts() {
        (code @ (Sub | Div | Compare(Comparison::Lt | Comparison::Le)), &[a, b]) if coin => code.of([b, a]),
        (Select, &[c, a, b]) => Select.of([c, b, a]),
        (Fma, &[a, b, c]) if coin => {
            round_twice(nest, at, [a, b, c]);
            return Some(format!("v{at}: {before:?} rounded twice"));
        }
        (Fma, &[a, b, c]) => Fma.of([a, c, b]),
        (Const(x), _) => Opcode::number(x.get().abs() + 1.0).of([]),
        (Outer(c), _) if nest.coordinates > 2 => Outer(CoordinateId(1 + c.0 % (nest.coordinates - 1))).of([]),
        (Channel(c), _) if nest.channels > 1 => Channel(ChannelId((c.0 + 1) % nest.channels)).of([]),
        (RowCount | PassCount, _) => Opcode::number(1.0).of([]),
        (code, operands) => {
            // Another operation of the same kinds.
            let row = |code: Opcode| (code.row().operands, code.row().result);
            let others: Vec<Opcode> =
                Opcode::every().into_iter().filter(|o| *o != code && row(*o) == row(code)).collect();
            if operands.is_empty() || others.is_empty() {
                return None;
            }
            let other = *random.pick(&others);
            match *operands {
                [a] => other.of([a]),
                [a, b] => other.of([a, b]),
                _ => return None,
            }
        }
    };
    nest.instructions[at].op = after;
    Some(format!("v{at}: {before:?} became {after:?}"))
}

/// Splits a · b + c to round the product: one instruction more, so that every later value shifts by one.
fn round_twice(nest: &mut LoopNest, at: usize, [a, b, c]: [Value; 3]) {
    let moved = |value: Value| Value(value.0 + u32::from(value.index() >= at));
    for instruction in &mut nest.instructions[at..] {
        instruction.op = instruction.op.renamed(moved);
    }
    let Instruction { level, span, .. } = nest.instructions[at];
    nest.instructions[at].op = Opcode::Add.of([Value(at as u32), c]);
    nest.instructions.insert(at, Instruction { op: Opcode::Mul.of([a, b]), level, span });
    let set = &mut nest.pixel_set;
    set.bounds = set.bounds.map(|(lo, hi)| (moved(lo), moved(hi)));
    (set.mask, set.saturated) = (set.mask.map(moved), set.saturated.map(moved));
    match &mut nest.sink {
        Sink::Plane(value) => *value = moved(*value),
        Sink::Sums { accumulators, totals, outputs } => {
            [accumulators, totals, outputs].into_iter().flatten().for_each(|value| *value = moved(*value));
        }
    }
}
