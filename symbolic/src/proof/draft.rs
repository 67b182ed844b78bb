//! A program that nobody has checked: what scheduling makes, and what must not leave the crate as it is.

use crate::program::{Cost, Instruction, Program};

/// A loop nest before its check. [`crate::proof::referee::Referee::proved`] and [`crate::proof::plane::proved`] make a
/// [`Program`] of it, and [`Draft::unproved`], which says so.
#[derive(Clone, Debug)]
pub(crate) struct Draft(Program);

impl Draft {
    pub fn new(program: Program) -> Draft {
        Draft(program)
    }

    /// What it would do.
    pub fn instructions(&self) -> &[Instruction] {
        self.0.instructions()
    }

    /// What it would cost.
    pub fn cost(&self) -> Cost {
        self.0.cost()
    }

    /// For the check.
    pub(super) fn program(&self) -> &Program {
        &self.0
    }

    /// Passed.
    pub(super) fn passed(self) -> Program {
        self.0
    }

    /// A program that is as good as its derivation: for loops to count and to compare with, never for a fit.
    pub fn unproved(self) -> Program {
        self.0
    }
}
