//! A program that nobody has checked: what scheduling makes, and what must not leave the crate as it is.

use crate::program::{Cost, Instruction, Program};

/// A loop nest before its check. Only [`crate::proof::referee::Referee::proved`] and [`crate::proof::plane::proved`] make a
/// [`Program`] of it.
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

    /// As it is, for tests of what made it.
    #[cfg(test)]
    pub fn unproved(self) -> Program {
        self.0
    }
}
