//! A loop nest that computes its document's formulas.

use crate::program::LoopNest;
use crate::program::check::Malformed;
use crate::program::peephole::improve;

/// A loop nest that passed its check, or one that no document states ([`Program::of`]).
#[derive(Clone, PartialEq, Debug)]
pub struct Program(LoopNest);

impl Program {
    /// The nest of a passed check.
    pub(super) fn passed(nest: LoopNest) -> Program {
        Program(nest)
    }

    /// A program that no document states.
    ///
    /// # Errors
    /// When [`LoopNest::check`] fails.
    pub fn of(nest: LoopNest) -> Result<Program, Malformed> {
        nest.check().map(|()| Program(nest))
    }

    /// The same from instructions in any order of levels, operands first: sorts them by level, drops unread ones and
    /// turns products with a lone reciprocal into divisions.
    ///
    /// # Panics
    /// When an operand, or a value of the sink, is not an instruction.
    ///
    /// # Errors
    /// When [`LoopNest::check`] fails.
    pub fn arranged(mut nest: LoopNest) -> Result<Program, Malformed> {
        let fused = std::mem::take(&mut nest.fused);
        improve(&mut nest);
        Program::of(LoopNest { fused, ..nest })
    }
}

impl std::ops::Deref for Program {
    type Target = LoopNest;

    fn deref(&self) -> &LoopNest {
        &self.0
    }
}

impl std::fmt::Display for Program {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(f)
    }
}
