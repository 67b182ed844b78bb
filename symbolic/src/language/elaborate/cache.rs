//! What was worked out inside sums, kept as long as it holds: a part that reads no index of the sums around it holds for the
//! whole formula, one that reads the outermost index until that index moves on, and so on.

use std::collections::HashMap;

use super::Worked;
use isophote_syntax::parser::Expr;

/// What is done with a part of a formula.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub(crate) enum Task {
    Value,
    /// Its sum, or product, over the innermost index.
    Total,
}

/// A part of a formula: the call that it is worked out for, its bytes, what is done with it.
type Key = (u32, usize, usize, Task);

#[derive(Default)]
pub(crate) struct Cache {
    /// First what reads no index, then for each sum around (outermost first) what reads its index and no inner one.
    frames: Vec<HashMap<Key, (Worked, u64)>>,
    /// The sums whose index was read since [`Cache::begin`], one bit each.
    read: u64,
    /// Which call's body is worked out; 0 is the formula itself.
    context: u32,
    contexts: HashMap<(u32, usize, usize), u32>,
}

impl Cache {
    /// Sums around.
    pub fn depth(&self) -> usize {
        self.frames.len().saturating_sub(1)
    }

    /// An index of these sums was read.
    pub fn reads(&mut self, levels: u64) {
        self.read |= levels;
    }

    /// What the part is known to be.
    pub fn get(&mut self, task: Task, at: &Expr) -> Option<Worked> {
        let key = (self.context, at.start, at.end, task);
        let (value, levels) = self.frames.iter().find_map(|frame| frame.get(&key))?;
        self.read |= levels;
        Some(value.clone())
    }

    /// Starts to note which indices are read; what was read so far goes to [`Cache::end`].
    pub fn begin(&mut self) -> u64 {
        std::mem::take(&mut self.read)
    }

    /// Keeps what was worked out since `begin`, unless the innermost index was read.
    pub fn end(&mut self, outer: u64, task: Task, at: &Expr, value: Option<&Worked>) {
        let level = (u64::BITS - self.read.leading_zeros()) as usize;
        if let Some(value) = value
            && level < self.depth()
        {
            let key = (self.context, at.start, at.end, task);
            self.frames[level].insert(key, (value.clone(), self.read));
        }
        self.read |= outer;
    }

    /// What was read since `begin`; noting goes on.
    pub fn resume(&mut self, outer: u64) -> u64 {
        let read = self.read;
        self.read |= outer;
        read
    }

    /// Enters a sum; its bit.
    pub fn enter_sum(&mut self) -> u64 {
        if self.frames.is_empty() {
            self.frames.push(HashMap::new());
        }
        self.frames.push(HashMap::new());
        1 << (self.depth() - 1)
    }

    /// The innermost index moves on.
    pub fn step(&mut self) {
        if let Some(frame) = self.frames.last_mut() {
            frame.clear();
        }
    }

    /// Leaves the sum of that bit.
    pub fn leave_sum(&mut self, bit: u64) {
        self.frames.pop();
        self.read &= !bit;
    }

    /// Enters the body of the function that is called at `at`; the context to go back to.
    pub fn enter_call(&mut self, at: &Expr) -> u32 {
        let next = self.contexts.len() as u32 + 1;
        let inner = *self.contexts.entry((self.context, at.start, at.end)).or_insert(next);
        std::mem::replace(&mut self.context, inner)
    }

    pub fn leave_call(&mut self, outer: u32) {
        self.context = outer;
    }
}
