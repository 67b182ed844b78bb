//! The last look at a program: division instead of a lone reciprocal, FMA, dead code, order by level.

use crate::program::{Instruction, Level, Op, Program, Sink, Value};

/// Improves the instructions in place and sorts them by level.
pub(crate) fn improve(program: &mut Program, fma: bool) {
    let mut uses = count_uses(program);
    // What nothing reads has no part in the counts.
    let live = live(program);
    for i in (0..program.instructions.len()).filter(|i| live[*i]) {
        let Instruction { op, level, .. } = program.instructions[i];
        let (make, a, b): (fn(Value, Value) -> Op, Value, Value) = match op {
            Op::Mul(a, b) => (Op::Mul, a, b),
            Op::Add(a, b) => (Op::Add, a, b),
            Op::Sub(a, b) => (Op::Sub, a, b),
            _ => continue,
        };
        let same_level = |v: Value| program.instructions[v.index()].level == level;
        let lone = |v: Value| uses[v.index()] == 1 && same_level(v);
        let new = match make(a, b) {
            // x · (1 / d), the reciprocal used here only.
            Op::Mul(..) => [(a, b), (b, a)].into_iter().find_map(|(x, reciprocal)| {
                match program.instructions[reciprocal.index()].op {
                    Op::Div(one, d) if lone(reciprocal) && is_one(program, one) => Some(Op::Div(x, d)),
                    _ => None,
                }
            }),
            Op::Add(..) if fma && level == Level::Pixel => {
                [(a, b), (b, a)].into_iter().find_map(|(product, c)| match program.instructions[product.index()].op {
                    Op::Mul(x, y) if lone(product) => Some(Op::Fma(x, y, c)),
                    _ => None,
                })
            }
            _ => None,
        };
        if let Some(new) = new {
            op.operands().for_each(|v| uses[v.index()] -= 1);
            new.operands().for_each(|v| uses[v.index()] += 1);
            // A product contracted away no longer uses its factors.
            for v in [a, b] {
                if uses[v.index()] == 0 {
                    program.instructions[v.index()].op.operands().for_each(|o| uses[o.index()] -= 1);
                }
            }
            program.instructions[i].op = new;
        }
    }
    if fma {
        contract_differences(program);
    }
    arrange(program);
}

/// c − x·y and x·y − c as FMA of a negated operand (a sign costs no flop).
fn contract_differences(program: &mut Program) {
    let uses = count_uses(program);
    let mut negated: Vec<Instruction> = Vec::new();
    let count = program.instructions.len();
    for i in 0..count {
        let Instruction { op: Op::Sub(a, b), level: Level::Pixel, span } = program.instructions[i] else { continue };
        let product = |v: Value| match program.instructions[v.index()] {
            Instruction { op: Op::Mul(x, y), level: Level::Pixel, .. } if uses[v.index()] == 1 => Some((x, y)),
            _ => None,
        };
        let level = |v: Value| program.instructions[v.index()].level;
        let value = Value((count + negated.len()) as u32);
        // c may be a factor as well: which operand is turned is a matter of place, not of which value it is.
        let (turned, contracted) = match (product(b), product(a)) {
            // The sign goes to the factor known earliest.
            (Some((x, y)), _) if level(y) < level(x) => (y, Op::Fma(x, value, a)),
            (Some((x, y)), _) => (x, Op::Fma(value, y, a)),
            (None, Some((x, y))) => (b, Op::Fma(x, y, value)),
            _ => continue,
        };
        negated.push(Instruction { op: Op::Neg(turned), level: level(turned), span });
        program.instructions[i].op = contracted;
    }
    program.instructions.extend(negated);
}

fn is_one(program: &Program, value: Value) -> bool {
    program.instructions[value.index()].op == Op::Const(1.0)
}

fn roots(program: &Program) -> Vec<Value> {
    let set = &program.pixel_set;
    let mut roots: Vec<Value> =
        set.bounds.into_iter().flat_map(|(a, b)| [a, b]).chain(set.mask).chain(set.saturated).collect();
    match &program.sink {
        Sink::Sums { accumulators, totals, outputs } => roots.extend(accumulators.iter().chain(totals).chain(outputs)),
        Sink::Plane(value) => roots.push(*value),
    }
    roots
}

fn live(program: &Program) -> Vec<bool> {
    let mut live = vec![false; program.instructions.len()];
    let mut stack = roots(program);
    while let Some(value) = stack.pop() {
        if !std::mem::replace(&mut live[value.index()], true) {
            stack.extend(program.instructions[value.index()].op.operands());
        }
    }
    live
}

fn count_uses(program: &Program) -> Vec<u32> {
    let mut uses = vec![0; program.instructions.len()];
    roots(program).iter().for_each(|v| uses[v.index()] += 1);
    let live = live(program);
    for (instruction, _) in program.instructions.iter().zip(&live).filter(|(_, live)| **live) {
        instruction.op.operands().for_each(|v| uses[v.index()] += 1);
    }
    uses
}

/// Drops dead instructions and orders the rest: by level, operands first, otherwise as they were emitted.
fn arrange(program: &mut Program) {
    let live = live(program);
    // Depth-first order within a level, because contraction may have appended operands behind their users.
    let mut order: Vec<usize> = Vec::with_capacity(live.len());
    let mut placed = vec![false; live.len()];
    for start in (0..live.len()).filter(|i| live[*i]) {
        let mut stack = vec![(start, false)];
        while let Some((i, ready)) = stack.pop() {
            if placed[i] {
                continue;
            }
            if ready {
                placed[i] = true;
                order.push(i);
            } else {
                stack.push((i, true));
                stack.extend(program.instructions[i].op.operands().map(|v| (v.index(), false)));
            }
        }
    }
    order.sort_by_key(|i| program.instructions[*i].level);
    let mut new = vec![Value(u32::MAX); live.len()];
    order.iter().enumerate().for_each(|(position, i)| new[*i] = Value(position as u32));
    let at = |v: Value| new[v.index()];
    program.instructions = order
        .iter()
        .map(|i| {
            let instruction = program.instructions[*i];
            Instruction { op: renamed(instruction.op, &at), ..instruction }
        })
        .collect();
    let set = &mut program.pixel_set;
    set.bounds = set.bounds.map(|(a, b)| (at(a), at(b)));
    set.mask = set.mask.map(at);
    set.saturated = set.saturated.map(at);
    match &mut program.sink {
        Sink::Sums { accumulators, totals, outputs } => {
            accumulators.iter_mut().chain(totals).chain(outputs).for_each(|v| *v = at(*v));
        }
        Sink::Plane(value) => *value = at(*value),
    }
}

/// The operation with its operands renamed.
pub(crate) fn renamed(op: Op, at: &dyn Fn(Value) -> Value) -> Op {
    match op {
        Op::Const(_) | Op::Input(_) | Op::Outer(_) | Op::Channel(_) => op,
        Op::RowTotal(_) | Op::RowCount | Op::PassTotal(_) | Op::PassCount => op,
        Op::Offset(a) => Op::Offset(at(a)),
        Op::Neg(a) => Op::Neg(at(a)),
        Op::Abs(a) => Op::Abs(at(a)),
        Op::Sqrt(a) => Op::Sqrt(at(a)),
        Op::Add(a, b) => Op::Add(at(a), at(b)),
        Op::Sub(a, b) => Op::Sub(at(a), at(b)),
        Op::Mul(a, b) => Op::Mul(at(a), at(b)),
        Op::Div(a, b) => Op::Div(at(a), at(b)),
        Op::Fma(a, b, c) => Op::Fma(at(a), at(b), at(c)),
        Op::Compare(k, a, b) => Op::Compare(k, at(a), at(b)),
        Op::And(a, b) => Op::And(at(a), at(b)),
        Op::Or(a, b) => Op::Or(at(a), at(b)),
        Op::Not(a) => Op::Not(at(a)),
        Op::Select(c, a, b) => Op::Select(at(c), at(a), at(b)),
        Op::Call1(f, a) => Op::Call1(f, at(a)),
        Op::Call2(f, a, b) => Op::Call2(f, at(a), at(b)),
    }
}
