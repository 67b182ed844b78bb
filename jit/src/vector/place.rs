//! Memory operands, and the stack frame.

use super::integers::Integer;

/// The base of a memory operand.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Anchor {
    /// The frame.
    Frame,
    /// The constants.
    Pool,
    /// An address in a variable.
    At(Integer),
}

/// A memory operand.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct MemoryPlace {
    pub base: Anchor,
    /// Index variable and scale.
    pub index: Option<(Integer, u32)>,
    /// Bytes.
    pub offset: i32,
    /// One element, broadcast to all lanes.
    pub is_spread: bool,
}

impl MemoryPlace {
    pub fn new(base: Anchor, offset: i32) -> MemoryPlace {
        MemoryPlace { base, index: None, offset, is_spread: false }
    }
    pub fn spread(self) -> MemoryPlace {
        MemoryPlace { is_spread: true, ..self }
    }
    pub fn indexed(self, index: Integer, scale: u32) -> MemoryPlace {
        MemoryPlace { index: Some((index, scale)), ..self }
    }
    pub fn plus(self, bytes: usize) -> MemoryPlace {
        MemoryPlace { offset: self.offset + bytes as i32, ..self }
    }
}

/// A field of the argument block.
pub(crate) fn arg(offset: usize) -> MemoryPlace {
    MemoryPlace::new(Anchor::At(Integer::Args), offset as i32)
}

/// Allocates the stack frame, from its lower end on.
#[derive(Default, Debug)]
pub(crate) struct StackFrame {
    bytes: usize,
}

impl StackFrame {
    /// A slot of `bytes` bytes, at a multiple of `alignment`.
    pub fn take(&mut self, bytes: usize, alignment: usize) -> MemoryPlace {
        let start = self.bytes.next_multiple_of(alignment);
        self.bytes = start + bytes;
        MemoryPlace::new(Anchor::Frame, start as i32)
    }

    /// A 64-bit number.
    pub fn scalar(&mut self) -> MemoryPlace {
        self.take(8, 8)
    }

    pub fn bytes(&self) -> usize {
        self.bytes
    }
}
