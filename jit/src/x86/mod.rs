//! Backend for x86-64 with vectors of 256 and 512 bits, which Cranelift lacks.
//! ```text
//! VectorCode ─► acts on registers ─► assembler ─► bytes ─► verify
//!               allocation, checker   labels
//! ```
//! [`crate::verify`] checks the bytes before they run.

mod acts;
mod allocation;
mod assembler;
mod calls;
mod checker;
#[cfg(test)]
mod checker_tests;
#[cfg(test)]
pub(crate) mod emulation_tests;
#[cfg(test)]
pub(crate) mod emulator_tests;
mod instructions;
mod integers;
mod slots;

use iced_x86::{Code, Instruction, MemoryOperand, Register};
use isophote_symbolic::Program;

use self::acts::{Vectors, allocate};
use self::assembler::{Assembler, Section};
use self::slots::Slots;
use crate::error::CompileError;
use crate::nest;
use crate::options::KernelOptions;
use crate::vector::{Integer, Piece};
pub(crate) use assembler::{ALIGNMENT, Assembled};
pub(crate) use instructions::every_code;

/// Callee-saved registers.
const SAVED: [Register; 6] = [Register::RBX, Register::RBP, Register::R12, Register::R13, Register::R14, Register::R15];
/// A page of stack; each is touched before the next.
const PAGE_BYTES: usize = 4096;
/// Frame alignment, so that vectors do not cross a cache line.
const FRAME_ALIGNMENT: usize = 64;

/// Machine code of a program, and the bytes of stack per call.
///
/// # Errors
/// If an instruction cannot be encoded (a bug).
pub(crate) fn code(program: &Program, options: &KernelOptions) -> Result<(Assembled, usize), CompileError> {
    let (code, frame) = nest::code(program, options);
    let (mut slots, mut assembler) = (Slots::of(frame), Assembler::new(code.labels));
    for piece in code.pieces {
        match piece {
            Piece::Integers(integers) => assembler.write(|i| i.integers(&integers)),
            Piece::Vectors { acts, givens, reserved } => {
                let block = Vectors { width: options.width, acts, givens, reserved };
                allocate(block, &mut slots, &mut assembler);
            }
        }
    }
    leave(&mut assembler);
    let frame_bytes = slots.frame.bytes().next_multiple_of(FRAME_ALIGNMENT);
    enter(&mut assembler, frame_bytes);
    let saved = (SAVED.len() + 1) * size_of::<usize>() + FRAME_ALIGNMENT;
    Ok((assembler.assemble(code.constants)?, frame_bytes + saved))
}

/// Writes the prologue, now that the frame's size is known.
fn enter(assembler: &mut Assembler, frame_bytes: usize) {
    assembler.switch_to(Section::Entry);
    assembler.write(|i| {
        SAVED.iter().for_each(|register| i.add(Instruction::with1(Code::Push_r64, *register)));
        i.add(Instruction::with2(Code::Mov_r64_rm64, Register::RBP, Register::RSP));
        i.add(Instruction::with2(Code::And_rm64_imm32, Register::RSP, -(FRAME_ALIGNMENT as i32)));
        i.add(Instruction::with2(Code::Sub_rm64_imm32, Register::RSP, frame_bytes as i32));
        for page in 1..=frame_bytes / PAGE_BYTES {
            let touched = MemoryOperand::with_base_displ(Register::RSP, (frame_bytes - page * PAGE_BYTES) as i64);
            i.add(Instruction::with2(Code::Mov_rm64_r64, touched, Register::RAX));
        }
        let args = integers::register(Integer::Args);
        i.add(Instruction::with2(Code::Mov_r64_rm64, args, Register::RDI));
    });
}

fn leave(assembler: &mut Assembler) {
    assembler.write(|i| {
        i.add(Ok(Instruction::with(Code::VEX_Vzeroupper)));
        i.add(Instruction::with2(Code::Mov_r64_rm64, Register::RSP, Register::RBP));
        SAVED.iter().rev().for_each(|register| i.add(Instruction::with1(Code::Pop_r64, *register)));
        i.add(Ok(Instruction::with(Code::Retnq)));
    });
}
