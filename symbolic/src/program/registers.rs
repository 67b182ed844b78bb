//! Register pressure of a pixel loop: counts spill stores and reloads.
//!
//! Walks the pixel instructions in order with a register file of a given size; a full one evicts the value whose next
//! use is furthest away (Belady). Values of pass or row level are memory operands of the instruction that needs them,
//! and an accumulator is added to in memory as soon as its value exists.

use crate::program::{Level, LoopNest, Opcode, Value};

/// Vector registers available of 16 (x86-64), one being reserved for the accumulators.
pub(crate) const OF_16: usize = 15;
/// The same of 32 (aarch64, AVX-512).
pub(crate) const OF_32: usize = 31;

/// Spill stores and reloads of the pixel loop.
pub(crate) fn spills(program: &LoopNest, registers: usize) -> u32 {
    let instructions = program.instructions();
    let is_pixel = |v: &Value| instructions[v.index()].level == Level::Pixel;
    let pixels: Vec<Value> = (0..instructions.len() as u32).map(Value).filter(is_pixel).collect();
    let operands = |v: Value| instructions[v.index()].op.operands().filter(is_pixel);
    // Concatenated users of each value: those of v start at next[v] and end where those of v + 1 start.
    let mut next = vec![0_usize; instructions.len() + 1];
    pixels.iter().for_each(|v| operands(*v).for_each(|operand| next[operand.index()] += 1));
    let mut total = 0;
    next.iter_mut().for_each(|count| total += std::mem::replace(count, total));
    let mut ends = next.clone();
    let mut users = vec![0_u32; total];
    for value in &pixels {
        for operand in operands(*value) {
            users[ends[operand.index()]] = value.0;
            ends[operand.index()] += 1;
        }
    }
    let carried = pixels.iter().filter(|v| instructions[v.index()].op.code == Opcode::Offset).count();
    let room = registers.saturating_sub(carried).max(3);
    let (mut held, mut stored, mut count) = (Vec::<Value>::new(), vec![false; instructions.len()], 0);
    for value in pixels {
        for operand in operands(value) {
            if !held.contains(&operand) {
                count += 1;
                held.push(operand);
            }
            let at = &mut next[operand.index()];
            while *at < ends[operand.index()] && users[*at] <= value.0 {
                *at += 1;
            }
        }
        held.push(value);
        held.retain(|v| next[v.index()] < ends[v.index()]);
        while held.len() > room {
            let furthest = (0..held.len()).max_by_key(|i| users[next[held[*i].index()]]).unwrap_or(0);
            let gone = held.swap_remove(furthest);
            count += u32::from(!std::mem::replace(&mut stored[gone.index()], true));
        }
    }
    count
}

#[cfg(test)]
#[path = "registers_tests.rs"]
mod tests;
