//! Code generator for wide vectors on x86-64: 256 and 512 bits, which Cranelift lacks.
//!
//! The code takes the same argument block; [`crate::verify`] checks its bytes before they run.
//! ```text
//! Program ─► places ─► nest: outer levels, groups ─► block ─► acts on registers ─► assembler ─► bytes ─► verify
//!            frame      select, functions, pixels     SSA     allocation, checker   labels
//! ```
//! Every level is vector code, with a pixel per lane in the pixel loop and a row per lane elsewhere, so that one instruction
//! selection and one register allocation serve them all.

mod across;
mod acts;
mod allocation;
mod assembler;
mod block;
mod calls;
mod checker;
#[cfg(test)]
mod checker_tests;
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

/// Machine code of a program, and the bytes of stack per call.
///
/// # Errors
/// If an instruction cannot be encoded (a bug).
pub(crate) fn code(program: &Program, options: &KernelOptions) -> Result<(Assembled, usize), CompileError> {
    nest::nest(program, options)
}
