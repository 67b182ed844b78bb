//! Cache of parts elaborated inside sums: a part that reads no index of the enclosing sums is valid for the whole
//! formula, one that reads the outermost index until that index advances, and so on.

use std::collections::HashMap;

use super::Worked;
use isophote_syntax::parser::Expr;

/// How a part of a formula is evaluated.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub(crate) enum Task {
    Value,
    /// Its sum, or product, over the innermost index.
    Total,
}

/// A part of a formula: its call context, its bytes, its task.
type Key = (u32, usize, usize, Task);

#[derive(Default)]
pub(crate) struct Cache {
    /// First parts that read no index, then for each enclosing sum (outermost first) those that read its index and no
    /// inner one.
    frames: Vec<HashMap<Key, (Worked, u64)>>,
    /// The sums whose index was read since [`Cache::begin`], one bit each.
    read: u64,
    /// The call whose body is being elaborated; 0 is the formula itself.
    context: u32,
    contexts: HashMap<(u32, usize, usize), u32>,
}

impl Cache {
    /// Number of enclosing sums.
    pub fn depth(&self) -> usize {
        self.frames.len().saturating_sub(1)
    }

    /// Records that indices of these sums were read.
    pub fn reads(&mut self, levels: u64) {
        self.read |= levels;
    }

    /// The cached value of a part.
    pub fn get(&mut self, task: Task, at: &Expr) -> Option<Worked> {
        let key = (self.context, at.start, at.end, task);
        let (value, levels) = self.frames.iter().find_map(|frame| frame.get(&key))?;
        self.read |= levels;
        Some(value.clone())
    }

    /// Starts recording index reads; returns the earlier ones, for [`Cache::end`].
    pub fn begin(&mut self) -> u64 {
        std::mem::take(&mut self.read)
    }

    /// Stores the value elaborated since `begin`, unless it read the innermost index.
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

    /// Returns the reads since `begin`; recording continues.
    pub fn resume(&mut self, outer: u64) -> u64 {
        let read = self.read;
        self.read |= outer;
        read
    }

    /// Enters a sum; returns its bit.
    pub fn enter_sum(&mut self) -> u64 {
        if self.frames.is_empty() {
            self.frames.push(HashMap::new());
        }
        self.frames.push(HashMap::new());
        1 << (self.depth() - 1)
    }

    /// Advances the innermost index.
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

    /// Enters the body of the function called at `at`; returns the context to restore.
    pub fn enter_call(&mut self, at: &Expr) -> u32 {
        let next = self.contexts.len() as u32 + 1;
        let inner = *self.contexts.entry((self.context, at.start, at.end)).or_insert(next);
        std::mem::replace(&mut self.context, inner)
    }

    pub fn leave_call(&mut self, outer: u32) {
        self.context = outer;
    }
}
