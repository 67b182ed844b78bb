//! What is read behind the code.

use iced_x86::Instruction;

/// The constants behind the code, and where they begin.
pub(crate) struct Pool {
    pub first: u64,
    pub bytes: Vec<u8>,
}

impl Pool {
    /// What an instruction reads of them.
    pub fn of(&self, i: &Instruction) -> Option<&[u8]> {
        let start = i.ip_rel_memory_address().checked_sub(self.first)? as usize;
        self.bytes.get(start..start.checked_add(i.memory_size().size())?)
    }
}

/// What a check comes to, or the rule that was broken.
pub(super) type Checked<T> = Result<T, &'static str>;
