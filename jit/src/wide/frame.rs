//! The stack frame: memory for values that registers do not hold.

use super::assembler::{Anchor, MemoryPlace};

/// Allocates the stack frame, from its lower end on.
#[derive(Default, Debug)]
pub(super) struct StackFrame {
    bytes: usize,
    /// Spill slots, which every block reuses.
    spills: Vec<MemoryPlace>,
    /// A slot for each register during calls.
    saved: Vec<MemoryPlace>,
    /// Two vectors passed to a called function; it leaves its result in the first.
    arguments: Option<[MemoryPlace; 2]>,
    /// A slot for the mask register during calls.
    mask: Option<MemoryPlace>,
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

    /// The n-th spill slot.
    pub fn spill(&mut self, n: usize, vector_bytes: usize) -> MemoryPlace {
        while self.spills.len() <= n {
            let place = self.take(vector_bytes, vector_bytes);
            self.spills.push(place);
        }
        self.spills[n]
    }

    /// The slot of a register during calls.
    pub fn saved(&mut self, register: u8, vector_bytes: usize) -> MemoryPlace {
        while self.saved.len() <= register.into() {
            let place = self.take(vector_bytes, vector_bytes);
            self.saved.push(place);
        }
        self.saved[usize::from(register)]
    }

    pub fn arguments(&mut self, vector_bytes: usize) -> [MemoryPlace; 2] {
        if let Some(arguments) = self.arguments {
            return arguments;
        }
        let arguments = [self.take(vector_bytes, vector_bytes), self.take(vector_bytes, vector_bytes)];
        *self.arguments.insert(arguments)
    }

    pub fn mask(&mut self) -> MemoryPlace {
        if let Some(mask) = self.mask {
            return mask;
        }
        let mask = self.scalar();
        *self.mask.insert(mask)
    }

    pub fn bytes(&self) -> usize {
        self.bytes
    }
}
