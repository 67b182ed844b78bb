//! The constant pool behind the code.

use iced_x86::Instruction;

/// The constants behind the code, and their start.
pub(crate) struct Pool {
    pub first: u64,
    pub bytes: Vec<u8>,
}

impl Pool {
    /// The constant that an instruction reads.
    pub fn of(&self, i: &Instruction) -> Option<&[u8]> {
        let start = i.ip_rel_memory_address().checked_sub(self.first)? as usize;
        self.bytes.get(start..start.checked_add(i.memory_size().size())?)
    }
}

/// The result of a check, or the violated rule.
pub(super) type Checked<T> = Result<T, &'static str>;
