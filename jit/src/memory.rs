//! `CodeMemory`: what has a say before memory is taken for machine code.
//!
//! What comes in: each step on a kernel's way into memory. What goes out: whether it may be taken. The memory itself is the
//! system's, which may refuse as well; either way there is no kernel, nothing stays behind, and those that are there run on.

use std::fmt::Debug;

/// What a kernel asks of the system, in order.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum CodeStep {
    /// Pages to write its code to.
    Map,
    /// That they become executable, and are no longer writable.
    Protect,
}

/// Asked before each step.
pub trait CodeMemory: Debug + Send + Sync {
    /// Whether the step may be taken.
    ///
    /// # Errors
    /// Why not; the kernel's compilation then ends with [`CompileError::NoCodeMemory`](crate::CompileError::NoCodeMemory).
    fn permit(&self, step: CodeStep) -> Result<(), String>;
}
