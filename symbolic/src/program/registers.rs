//! What a pixel loop asks of the registers: how often a value has to be stored and fetched again.
//!
//! What comes in: a program. What goes out: a count, found by going through the pixel instructions in order with a register
//! file of a given size; where it is full, the value whose next use is furthest away leaves (Belady). Values known per pass
//! or row are read from memory by the instruction that needs them, and an accumulator is added to in memory as soon as its
//! value is there.

use crate::program::{Level, Opcode, Program, Value};

/// Vector registers that code may use where there are 16 (x86-64), one being needed for the accumulators.
pub(crate) const OF_16: usize = 15;
/// The same where there are 32 (aarch64, AVX-512).
pub(crate) const OF_32: usize = 31;

/// Stores and fetches of the pixel loop beyond those that it is made of.
pub(crate) fn spills(program: &Program, registers: usize) -> u32 {
    let instructions = program.instructions();
    let is_pixel = |v: &Value| instructions[v.index()].level == Level::Pixel;
    let pixels: Vec<Value> = (0..instructions.len() as u32).map(Value).filter(is_pixel).collect();
    let operands = |v: Value| instructions[v.index()].op.operands().filter(is_pixel);
    // The users of each value, one after another: those of value v begin at next[v], and end where those of v + 1 begin.
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
