//! Native code for the fused pixel loop.
//!
//! What comes in: a [`Program`](isophote_symbolic::Program) of `symbolic`, and pixels in memory. What goes out: a
//! [`Kernel`] that runs the whole loop nest in one call and equals the interpreter bit for bit.
//! ```text
//! Program ─► check ─► plan ─► lower ─► audit ─► Cranelift ─► runner (executable memory) ─► Kernel
//! bytes ─► PlaneView ─► Region (window inside plane) ─────────────────────────────────────► Sums
//! ```
//! Native code imports no names, has no instruction that traps and is freed when its kernel is dropped. Every address
//! that it touches is inside a slice whose bounds a type has proven before; `unsafe` stands in `runner.rs` alone.
//!
//! It must never know: models, parameters' meaning, solvers, files, threads, clocks.

#![deny(unsafe_code)]

mod abi;
mod audit;
mod check;
mod compile;
mod host;
mod kernel;
mod lower;
mod plan;
mod plane;
mod runner;

pub use compile::{Explained, explain};
pub use host::has_fma;
pub use kernel::{CompileError, Kernel, KernelOptions, RunError, Sums};
pub use plane::{PixelFormat, PlaneError, PlaneView, Window};
