//! Vector code before a backend turns it into instructions: blocks of vector operations, and integer operations between them.
//!
//! It knows no registers. [`VectorCode`] is a list of pieces in the order of execution; a value of a block is assigned once,
//! variables outlive blocks.

mod block;
mod code;
mod integers;
mod operation;
mod place;

pub(crate) use block::{Act, Block, Given, Id, Resident};
pub(crate) use code::{Constants, Piece, VectorCode};
pub(crate) use integers::{Condition, Integer, Integers, Label, Operand, Step};
pub(crate) use operation::{Element, Operation, Portion, comparison, pieces};
pub(crate) use place::{Anchor, MemoryPlace, StackFrame, arg};
