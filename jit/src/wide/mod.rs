//! Wide vectors: 256 and 512 bits on x86-64, which the compiler does not have.
//!
//! What comes in: a checked `Program`, and options that ask for them. What goes out: bytes of machine code for the same
//! argument block, checked by [`crate::verify`] before anyone runs them.
//! ```text
//! Program ─► places ─► nest: outer levels, groups ─► block ─► acts on registers ─► assembler ─► bytes ─► verify
//!            frame      select, functions, pixels     SSA     allocation            labels
//! ```
//! Every level is vector code: the pixels' a lane a pixel, the others a lane a row, so that one selection of instructions and one
//! allocation of registers serve them all. It must never know: models, how code gets into memory, the compiler.

mod across;
mod acts;
mod allocation;
mod assembler;
mod block;
mod calls;
mod columns;
#[cfg(test)]
pub(crate) mod emulation_tests;
#[cfg(test)]
pub(crate) mod emulator_tests;
mod frame;
mod functions;
mod group;
mod narrow;
mod nest;
mod operation;
mod outer;
mod pair;
mod pixels;
mod places;
mod select;
mod sums;
mod tables;

use isophote_symbolic::Program;

use crate::error::CompileError;
use crate::options::KernelOptions;
pub(crate) use assembler::{ALIGNMENT, Assembled};
pub(crate) use operation::every_code;

/// Machine code of a program, and the bytes of stack that a call takes.
///
/// # Errors
/// When an instruction cannot be encoded, which only a bug could ask for.
pub(crate) fn code(program: &Program, options: &KernelOptions) -> Result<(Assembled, usize), CompileError> {
    nest::nest(program, options)
}
