//! Verifies machine code from its bytes, whichever backend made it, before it runs.
//!
//! [`verify`] fails at the first instruction that is not proved to keep the rules:
//! - every instruction is on the list: none traps, none is an import;
//! - memory is read in the frame, in the constants, in the argument block, its lists and its tables, and in pixels of the window;
//!   it is written in the frame, in the two counts, in the outputs, and in the window's rows of the output plane;
//! - a pixel's address is the window's first plus products of strides and numbers that a comparison has bounded by the window's
//!   size, so that no earlier arithmetic matters;
//! - gathers use indices that the instruction before has bounded by a constant;
//! - functions are called through the table, with addresses of vectors in the frame;
//! - on return, the caller's registers and stack are as they were.
//!
//! It does not check the results of a kernel: tests compare them with the interpreter. Code that is only shown, and never run, is
//! not checked.
//!
//! This is an abstract interpretation: the walk over the basic blocks repeats until no register or frame word changes, and facts
//! only ever weaken. Equal values share a name, so that a comparison of one register also refines its copies and spills.
//!
//! The lattice. A [`Fact`](known::Fact) is a set of 64-bit values: `Number` is all of them, every other fact is contained in it,
//! and no address is taken from a `Number`. A [`State`] has a word, fact and name, for each general register, one for each eight
//! bytes of the frame that were stored whole, one for each pushed register, the size of the frame, the alignment that the stack
//! was rounded down to, and the two words compared last.
//! - An instruction that writes 32 or 64 bits of a register replaces its word; one that writes 8 or 16 leaves a `Number`.
//! - Offsets of `Frame` count from the stack pointer. When that changes, no such fact may remain: a frame grows only while
//!   nothing points into it and nothing is stored there, and facts about it end when it is released.
//! - A frame is at a multiple of the alignment that the stack was rounded down to, or of 16 by the calling convention if its
//!   bytes, the pushed registers and the return address add up to that. An aligned operand must be at a multiple of its own size.
//!
//! Where two states meet, each common word becomes one that contains both: the same fact, the smallest fact that contains both,
//! or `Number`; the same name, or a new one. Frame words remain if both states have them. If the frames differ in size, rounding
//! or number of pushed registers, the stack pointer is a `Number`: no frame, no call and no return is possible.

#[cfg(test)]
mod compiled_tests;
mod gathered;
#[cfg(test)]
mod generated_tests;
mod known;
mod listed;
mod pool;
mod rules;
#[cfg(test)]
mod sequences_tests;
mod state;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};

use iced_x86::{Code, Decoder, DecoderOptions, Instruction, OpKind, Register};
use isophote_symbolic::Program;

pub(crate) use self::pool::Pool;
use self::rules::Check;
use self::state::{Asked, FRAME_BYTES_MAX, State};
use crate::options::KernelOptions;
use crate::plane::PixelFormat;

/// The memory that the code may access.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Permitted<'a> {
    /// Lengths of the lists.
    pub inputs: usize,
    pub outputs: usize,
    pub tables: usize,
    /// The pixel format of each channel.
    pub formats: &'a [PixelFormat],
    /// The pixels of a row are contiguous.
    pub packed: bool,
    /// Pixels per group.
    pub lanes: usize,
}

impl<'a> Permitted<'a> {
    /// The memory that the code of a program may access.
    pub fn of(program: &Program, options: &'a KernelOptions) -> Permitted<'a> {
        Permitted {
            inputs: program.inputs().len(),
            outputs: program.sink().outputs().len(),
            tables: program.tables().numbers().len(),
            formats: &options.formats,
            packed: options.packed,
            lanes: options.lanes().count(),
        }
    }
}

/// Checks machine code whose instructions end at or before `code_end`; names the instruction and the rule that it violates.
pub(crate) fn verify(bytes: &[u8], code_end: usize, reach: Permitted<'_>) -> Result<(), String> {
    let decoded = decode(bytes, code_end)?;
    check(&decoded.instructions, &decoded.pool, reach)
}

/// Machine code, and the constants behind it.
pub(crate) struct Decoded {
    pub instructions: Vec<Instruction>,
    pub pool: Pool,
}

/// Decodes the instructions. The compiler does not record the end of the code: it is the first constant that an instruction
/// reads, or the zero padding before that.
pub(crate) fn decode(bytes: &[u8], code_end: usize) -> Result<Decoded, String> {
    let mut first_constant = code_end as u64;
    let mut instructions = Vec::new();
    let mut decoder = Decoder::with_ip(64, bytes, 0, DecoderOptions::NONE);
    while decoder.ip() < first_constant {
        let gap = bytes.get(decoder.position()..first_constant as usize).unwrap_or_default();
        let is_left = instructions.last().is_none_or(|last: &Instruction| !falls_through(last));
        if is_left && gap.iter().all(|byte| *byte == 0) {
            break;
        }
        let instruction = decoder.decode();
        if instruction.code() == Code::INVALID {
            return Err(said(&instruction, "is no instruction"));
        }
        if instruction.is_ip_rel_memory_operand() {
            first_constant = first_constant.min(instruction.ip_rel_memory_address());
        }
        instructions.push(instruction);
    }
    let pool = Pool { first: decoder.ip(), bytes: bytes.get(decoder.position()..).unwrap_or_default().to_vec() };
    Ok(Decoded { instructions, pool })
}

fn falls_through(instruction: &Instruction) -> bool {
    !matches!(instruction.code(), Code::Retnq | Code::Jmp_rel8_64 | Code::Jmp_rel32_64)
}

/// Checks decoded instructions, with their constants.
fn check(instructions: &[Instruction], pool: &Pool, reach: Permitted<'_>) -> Result<(), String> {
    known(instructions, pool, reach).map(drop)
}

/// Like [`check`]; returns the state before each basic block, by the index of its first instruction among those that affect
/// the state.
fn known(instructions: &[Instruction], pool: &Pool, reach: Permitted<'_>) -> Result<BTreeMap<usize, State>, String> {
    if let Some(stranger) = instructions.iter().find(|instruction| !listed::is_allowed(instruction)) {
        return Err(said(stranger, "is not on the list"));
    }
    for instruction in instructions {
        rules::constant(instruction, pool).map_err(|rule| said(instruction, rule))?;
        let is_there = |ip: u64| instructions.binary_search_by_key(&ip, Instruction::ip).is_ok();
        if target(instruction).is_some_and(|target| !is_there(target)) {
            return Err(said(instruction, "jumps into an instruction"));
        }
    }
    let targets: BTreeSet<u64> = instructions.iter().filter_map(target).collect();
    let mut bounds = BTreeMap::new();
    for (at, gather) in instructions.iter().enumerate().filter(|(_, i)| i.is_vsib()) {
        let before = at.checked_sub(1).filter(|_| !targets.contains(&gather.ip())).map(|before| &instructions[before]);
        let bound = gathered::bound(before, gather, pool).map_err(|rule| said(gather, rule))?;
        bounds.insert(gather.ip(), bound);
    }
    // Instructions that do not affect registers and frame are checked already.
    let instructions: Vec<Instruction> = instructions.iter().filter(|i| !rules::is_settled(i)).copied().collect();
    let place = |ip: u64| instructions.partition_point(|instruction| instruction.ip() < ip);
    let mut leads = vec![false; instructions.len() + 1];
    for (at, target) in instructions.iter().enumerate().filter_map(|(at, instruction)| Some((at, target(instruction)?)))
    {
        (leads[place(target)], leads[at + 1]) = (true, true);
    }
    let mut known: BTreeMap<usize, State> = BTreeMap::from([(0, State::at_entry())]);
    let mut open = BTreeSet::from([0]);
    while let Some(leader) = open.pop_first() {
        let Some(mut state) = known.get(&leader).cloned() else { continue };
        let mut learn = |place: usize, state: &State| {
            let joined = known.get(&place).map_or_else(|| state.before_all(), |before| before.or(state, place));
            if known.get(&place) != Some(&joined) {
                known.insert(place, joined);
                open.insert(place);
            }
        };
        let mut at = leader;
        loop {
            if let Some(behind) = probes(&instructions[at..]).filter(|_| state.has_no_frame()) {
                at += behind;
                state.forget_probe();
            }
            let instruction = instructions.get(at).ok_or("the code has no end")?;
            Check { instruction, reach, bounds: &bounds }.run(&mut state).map_err(|rule| said(instruction, rule))?;
            let asked = Asked::by(instruction.mnemonic());
            if let Some(place) = target(instruction).map(place) {
                let mut there = state.clone();
                asked.iter().for_each(|asked| there.learn(*asked));
                learn(place, &there);
                asked.iter().for_each(|asked| state.learn(asked.otherwise()));
            }
            if !falls_through(instruction) {
                break;
            }
            at += 1;
            if leads[at] {
                learn(at, &state);
                break;
            }
        }
    }
    Ok(known)
}

/// Matches the stack probe of a large frame, page by page down, then back; returns its number of instructions.
/// ```text
/// mov r11, rsp; sub r11, bytes; again: sub rsp, page; mov [rsp], 0; cmp r11, rsp; jne again; add rsp, bytes
/// ```
fn probes(instructions: &[Instruction]) -> Option<usize> {
    let [start, lower, step, touch, compare, again, back, ..] = instructions else { return None };
    let changes = |i: &Instruction, code: Code, register: Register| i.code() == code && i.op0_register() == register;
    let (bytes, page) = (lower.immediate32to64(), step.immediate32to64());
    let is_loop = changes(start, Code::Mov_rm64_r64, Register::R11)
        && start.op1_register() == Register::RSP
        && changes(lower, Code::Sub_rm64_imm32, Register::R11)
        && changes(step, Code::Sub_rm64_imm32, Register::RSP)
        && touch.code() == Code::Mov_rm32_imm32
        && (touch.memory_base(), touch.memory_index()) == (Register::RSP, Register::None)
        && touch.memory_displacement64() == 0
        && changes(compare, Code::Cmp_r64_rm64, Register::R11)
        && compare.op1_register() == Register::RSP
        && again.code() == Code::Jne_rel32_64
        && target(again) == Some(step.ip())
        && changes(back, Code::Add_rm64_imm32, Register::RSP)
        && back.immediate32to64() == bytes
        && page > 0
        && bytes % page == 0
        && (page..=FRAME_BYTES_MAX + page).contains(&bytes);
    is_loop.then_some(7)
}

fn target(instruction: &Instruction) -> Option<u64> {
    (instruction.op_count() == 1 && instruction.op0_kind() == OpKind::NearBranch64).then(|| instruction.near_branch64())
}

fn said(instruction: &Instruction, rule: &str) -> String {
    format!("{:#x}, {:?}: it {rule}", instruction.ip(), instruction.code())
}
