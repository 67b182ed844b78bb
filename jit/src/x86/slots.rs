//! Slots of the stack frame for values that registers do not hold.

use crate::vector::{MemoryPlace, StackFrame};

/// The stack frame, with slots for blocks.
#[derive(Default, Debug)]
pub(super) struct Slots {
    pub frame: StackFrame,
    /// Spill slots, which every block reuses.
    spills: Vec<MemoryPlace>,
    /// A slot for each register during calls.
    saved: Vec<MemoryPlace>,
    /// Two vectors passed to a called function; it leaves its result in the first.
    arguments: Option<[MemoryPlace; 2]>,
}

impl Slots {
    pub fn of(frame: StackFrame) -> Slots {
        Slots { frame, ..Slots::default() }
    }

    /// The n-th spill slot.
    pub fn spill(&mut self, n: usize, vector_bytes: usize) -> MemoryPlace {
        while self.spills.len() <= n {
            let place = self.frame.take(vector_bytes, vector_bytes);
            self.spills.push(place);
        }
        self.spills[n]
    }

    /// The slot of a register during calls.
    pub fn saved(&mut self, register: u8, vector_bytes: usize) -> MemoryPlace {
        while self.saved.len() <= register.into() {
            let place = self.frame.take(vector_bytes, vector_bytes);
            self.saved.push(place);
        }
        self.saved[usize::from(register)]
    }

    pub fn arguments(&mut self, vector_bytes: usize) -> [MemoryPlace; 2] {
        if let Some(arguments) = self.arguments {
            return arguments;
        }
        let arguments = [self.frame.take(vector_bytes, vector_bytes), self.frame.take(vector_bytes, vector_bytes)];
        *self.arguments.insert(arguments)
    }
}
