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
    let is_pixel = |v: &Value| program.instruction(*v).level == Level::Pixel;
    let loop_of = || (0..program.instructions().len() as u32).map(Value).filter(is_pixel);
    let operands = |v: Value| program.instruction(v).op.operands().filter(is_pixel);
    // The uses of each value, the next one last.
    let mut uses: Vec<Vec<u32>> = vec![Vec::new(); program.instructions().len()];
    for value in loop_of().collect::<Vec<_>>().into_iter().rev() {
        operands(value).for_each(|v| uses[v.index()].push(value.0));
    }
    let carried = loop_of().filter(|v| program.instruction(*v).op.code == Opcode::Offset).count();
    let room = registers.saturating_sub(carried).max(3);
    let (mut held, mut stored, mut count) = (Vec::<Value>::new(), vec![false; program.instructions().len()], 0);
    for value in loop_of() {
        for operand in operands(value) {
            if !held.contains(&operand) {
                count += 1;
                held.push(operand);
            }
            let rest = &mut uses[operand.index()];
            while rest.last().is_some_and(|user| *user <= value.0) {
                rest.pop();
            }
        }
        held.push(value);
        held.retain(|v| !uses[v.index()].is_empty());
        while held.len() > room {
            let furthest = (0..held.len()).max_by_key(|i| uses[held[*i].index()].last()).unwrap_or(0);
            let gone = held.swap_remove(furthest);
            count += u32::from(!std::mem::replace(&mut stored[gone.index()], true));
        }
    }
    count
}

#[cfg(test)]
#[path = "registers_tests.rs"]
mod tests;
