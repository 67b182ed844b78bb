//! Peephole pass: division instead of a lone reciprocal, FMA, dead code, order by level.

use crate::program::{Instruction, Level, LoopNest, Opcode, PixelSet, Sink, Value};

/// Improves the instructions in place, contracts products and sums of a fused program, and sorts by level.
pub(crate) fn improve(program: &mut LoopNest) {
    // Dead instructions count as no use.
    let live = live(program);
    let mut uses = count_uses(program, &live);
    for i in (0..program.instructions.len()).filter(|i| live[*i]) {
        let Instruction { op, level, .. } = program.instructions[i];
        let &[a, b] = op.parts().1 else { continue };
        let same_level = |v: Value| program.instructions[v.index()].level == level;
        let lone = |v: Value| uses[v.index()] == 1 && same_level(v);
        let new = match op.code {
            // x · (1 / d), the reciprocal used here only.
            Opcode::Mul => [(a, b), (b, a)].into_iter().find_map(|(x, reciprocal)| {
                match program.instructions[reciprocal.index()].op.parts() {
                    (Opcode::Div, &[one, d]) if lone(reciprocal) && is_one(program, one) => {
                        Some(Opcode::Div.of([x, d]))
                    }
                    _ => None,
                }
            }),
            Opcode::Add if program.fused && level == Level::Pixel => {
                [(a, b), (b, a)].into_iter().find_map(|(product, c)| {
                    let (x, y) = factors(program, product).filter(|_| lone(product))?;
                    Some(Opcode::Fma.of([x, y, c]))
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
    if program.fused {
        contract_differences(program);
    }
    arrange(program);
}

/// c − x·y and x·y − c as FMA of a negated operand (a sign costs no flop).
fn contract_differences(program: &mut LoopNest) {
    let uses = count_uses(program, &live(program));
    let mut negated: Vec<Instruction> = Vec::new();
    let count = program.instructions.len();
    for i in 0..count {
        let Instruction { op, level: Level::Pixel, span } = program.instructions[i] else { continue };
        let (Opcode::Sub, &[a, b]) = op.parts() else { continue };
        let is_lone = |v: Value| uses[v.index()] == 1 && program.instructions[v.index()].level == Level::Pixel;
        let product = |v: Value| factors(program, v).filter(|_| is_lone(v));
        let level = |v: Value| program.instructions[v.index()].level;
        let value = Value((count + negated.len()) as u32);
        // c may also be a factor: the position decides which operand is negated, not the value.
        let (turned, contracted) = match (product(b), product(a)) {
            // Negates the factor of the earlier level.
            (Some((x, y)), _) if level(y) < level(x) => (y, [x, value, a]),
            (Some((x, y)), _) => (x, [value, y, a]),
            (None, Some((x, y))) => (b, [x, y, value]),
            _ => continue,
        };
        negated.push(Instruction { op: Opcode::Neg.of([turned]), level: level(turned), span });
        program.instructions[i].op = Opcode::Fma.of(contracted);
    }
    program.instructions.extend(negated);
}

fn is_one(program: &LoopNest, value: Value) -> bool {
    program.instructions[value.index()].op.constant() == Some(1.0)
}

fn factors(program: &LoopNest, value: Value) -> Option<(Value, Value)> {
    match program.instructions[value.index()].op.parts() {
        (Opcode::Mul, &[x, y]) => Some((x, y)),
        _ => None,
    }
}

/// Values read by the pixel set and the sink.
pub(super) fn roots(set: &PixelSet, sink: &Sink) -> Vec<Value> {
    let mut roots: Vec<Value> =
        set.bounds.into_iter().flat_map(|(a, b)| [a, b]).chain(set.mask).chain(set.saturated).collect();
    match sink {
        Sink::Sums { accumulators, totals, outputs } => roots.extend(accumulators.iter().chain(totals).chain(outputs)),
        Sink::Plane(value) => roots.push(*value),
    }
    roots
}

fn live(program: &LoopNest) -> Vec<bool> {
    let mut live = vec![false; program.instructions.len()];
    let mut stack = roots(&program.pixel_set, &program.sink);
    while let Some(value) = stack.pop() {
        if !std::mem::replace(&mut live[value.index()], true) {
            stack.extend(program.instructions[value.index()].op.operands());
        }
    }
    live
}

fn count_uses(program: &LoopNest, live: &[bool]) -> Vec<u32> {
    let mut uses = vec![0; program.instructions.len()];
    roots(&program.pixel_set, &program.sink).iter().for_each(|v| uses[v.index()] += 1);
    for (instruction, _) in program.instructions.iter().zip(live).filter(|(_, live)| **live) {
        instruction.op.operands().for_each(|v| uses[v.index()] += 1);
    }
    uses
}

/// Drops dead instructions; sorts the rest by level, operands first, otherwise in emission order.
pub(crate) fn arrange(program: &mut LoopNest) {
    let live = live(program);
    // Depth-first order within a level, because contraction may have appended operands behind their users.
    let mut order: Vec<usize> = Vec::with_capacity(live.len());
    let mut placed = vec![false; live.len()];
    let mut stack = Vec::new();
    for start in (0..live.len()).filter(|i| live[*i]) {
        stack.push(start);
        while let Some(i) = stack.last().copied() {
            let waiting = stack.len();
            if !placed[i] {
                let operands = program.instructions[i].op.operands().map(Value::index);
                stack.extend(operands.filter(|operand| !placed[*operand]));
            }
            if stack.len() == waiting {
                stack.pop();
                if !std::mem::replace(&mut placed[i], true) {
                    order.push(i);
                }
            }
        }
    }
    order.sort_by_key(|i| program.instructions[*i].level);
    let mut new = vec![Value(u32::MAX); live.len()];
    order.iter().enumerate().for_each(|(position, i)| new[*i] = Value(position as u32));
    program.instructions = order.iter().map(|i| program.instructions[*i]).collect();
    program.rename(|v| new[v.index()]);
}
