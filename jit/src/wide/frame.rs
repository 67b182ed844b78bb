//! The frame: where on the stack a kernel keeps what registers do not hold.

use super::assembler::{Anchor, MemoryPlace};

/// What is taken of the stack, from its lower end on.
#[derive(Default, Debug)]
pub(super) struct StackFrame {
    bytes: usize,
    /// Places for values that leave their register, which every block uses anew.
    spills: Vec<MemoryPlace>,
    /// A place for each register, while a function is called.
    saved: Vec<MemoryPlace>,
    /// Two vectors that a called function takes; it leaves its result in the first.
    arguments: Option<[MemoryPlace; 2]>,
    /// Mask registers while a function is called.
    masks: Option<[MemoryPlace; 2]>,
}

impl StackFrame {
    /// A place of so many bytes, at a multiple of `alignment`.
    pub fn take(&mut self, bytes: usize, alignment: usize) -> MemoryPlace {
        let start = self.bytes.next_multiple_of(alignment);
        self.bytes = start + bytes;
        MemoryPlace::new(Anchor::Frame, start as i32)
    }

    /// A 64-bit number.
    pub fn scalar(&mut self) -> MemoryPlace {
        self.take(8, 8)
    }

    /// A place for the n-th value that leaves its register.
    pub fn spill(&mut self, n: usize, vector_bytes: usize) -> MemoryPlace {
        while self.spills.len() <= n {
            let place = self.take(vector_bytes, vector_bytes);
            self.spills.push(place);
        }
        self.spills[n]
    }

    /// A place for a register while a function is called.
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

    pub fn masks(&mut self) -> [MemoryPlace; 2] {
        if let Some(masks) = self.masks {
            return masks;
        }
        let masks = [self.scalar(), self.scalar()];
        *self.masks.insert(masks)
    }

    pub fn bytes(&self) -> usize {
        self.bytes
    }
}
