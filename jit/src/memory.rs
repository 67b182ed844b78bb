//! `CodeMemory`: a hook that permits or refuses memory for machine code.
//!
//! The memory itself is the system's, which may refuse as well; either way compilation fails, nothing leaks, and existing
//! kernels keep running.

use std::fmt::Debug;

/// The system calls of loading a kernel, in order.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum CodeStep {
    /// Map writable pages for its code.
    Map,
    /// Make them executable and read-only.
    Protect,
}

/// Called before each step.
pub trait CodeMemory: Debug + Send + Sync {
    /// Whether the step may be taken.
    ///
    /// # Errors
    /// The reason for a refusal; compilation returns [`CompileError::NoCodeMemory`](crate::CompileError::NoCodeMemory).
    fn permit(&self, step: CodeStep) -> Result<(), String>;
}
