//! Is this code what it should be? Decoded from its bytes, and checked whoever wrote them, before anyone runs it.
//!
//! What comes in: machine code of a kernel, and how long the lists behind its argument are. What goes out: nothing, or the
//! first instruction that is not proved to keep the rules:
//! - every instruction is on the list: none traps, none is an import;
//! - memory is read in the frame, in the constants, in the argument block and its lists, and in pixels of the window;
//!   it is written in the frame, in the two counts, in the outputs, and in the window's rows of the output plane;
//! - a pixel's address is the window's first plus products of strides and numbers that have just been bounded by the window's
//!   size, so that no arithmetic before that matters;
//! - functions are called through the table, with addresses of vectors in the frame;
//! - the caller's registers and stack are as they were on return.
//!
//! It must never know: programs, or how the code was made. The walk goes over the basic blocks until nothing new is known of
//! any register; what is known only ever becomes less.

mod known;
mod rules;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use iced_x86::{Code, Decoder, DecoderOptions, Instruction, OpKind};

use self::rules::{Check, State};
use super::assembler::Assembled;
use crate::plane::PixelFormat;

/// What the code may touch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Permitted<'a> {
    /// How many numbers there are.
    pub inputs: usize,
    pub outputs: usize,
    /// Of each channel.
    pub formats: &'a [PixelFormat],
    /// Pixels of a group.
    pub lanes: usize,
}

/// Checks machine code; says which instruction breaks which rule.
pub(crate) fn verify(code: &Assembled, reach: Permitted<'_>) -> Result<(), String> {
    let pool = code.pool_start as u64..code.bytes.len() as u64;
    check(&decoded(code)?, &pool, reach)
}

/// The same of decoded instructions, with constants at `pool`.
fn check(instructions: &[Instruction], pool: &Range<u64>, reach: Permitted<'_>) -> Result<(), String> {
    if let Some(stranger) = instructions.iter().find(|instruction| !rules::is_allowed(instruction)) {
        return Err(said(stranger, "is not on the list"));
    }
    let places: BTreeMap<u64, usize> = instructions.iter().enumerate().map(|(i, x)| (x.ip(), i)).collect();
    let mut leaders = BTreeSet::from([0]);
    for (at, instruction) in instructions.iter().enumerate() {
        if let Some(target) = target(instruction) {
            let place = places.get(&target).ok_or_else(|| said(instruction, "jumps into an instruction"))?;
            leaders.extend([*place, at + 1]);
        }
    }
    let mut known: BTreeMap<usize, State> = BTreeMap::from([(0, State::at_entry())]);
    let mut open = BTreeSet::from([0]);
    while let Some(leader) = open.pop_first() {
        let Some(mut state) = known.get(&leader).cloned() else { continue };
        let mut at = leader;
        loop {
            let instruction = instructions.get(at).ok_or("the code has no end")?;
            let before = (at > leader).then(|| &instructions[at - 1]);
            let step = Check { instruction, before, reach, pool };
            step.run(&mut state).map_err(|rule| said(instruction, rule))?;
            let mut learn = |place: usize, state: &State| {
                let joined = known.get(&place).map_or_else(|| state.clone(), |before| before.or(state));
                if known.get(&place) != Some(&joined) {
                    known.insert(place, joined);
                    open.insert(place);
                }
            };
            if let Some(place) = target(instruction).and_then(|target| places.get(&target)) {
                learn(*place, &state);
            }
            match instruction.code() {
                Code::Retnq | Code::Jmp_rel32_64 => break,
                _ => step.refine(&mut state),
            }
            at += 1;
            if leaders.contains(&at) {
                learn(at, &state);
                break;
            }
        }
    }
    Ok(())
}

/// The instructions, one behind the other.
pub(super) fn decoded(code: &Assembled) -> Result<Vec<Instruction>, String> {
    let bytes = code.bytes.get(..code.code_end).ok_or("the code ends behind its end")?;
    let mut instructions = Vec::new();
    for instruction in Decoder::with_ip(64, bytes, 0, DecoderOptions::NONE) {
        if instruction.code() == Code::INVALID {
            return Err(said(&instruction, "is no instruction"));
        }
        instructions.push(instruction);
    }
    Ok(instructions)
}

fn target(instruction: &Instruction) -> Option<u64> {
    (instruction.op_count() == 1 && instruction.op0_kind() == OpKind::NearBranch64).then(|| instruction.near_branch64())
}

fn said(instruction: &Instruction, rule: &str) -> String {
    format!("{:#x}, {:?}: it {rule}", instruction.ip(), instruction.code())
}
