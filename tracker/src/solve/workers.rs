//! Who does independent pieces of work: this crate has no threads, so it is told.

/// Calls a function once with each number below a count, in any order, perhaps several at once, and returns when all are
/// done.
pub trait Workers {
    /// Does it.
    fn each(&self, count: usize, work: &(dyn Fn(usize) + Sync));
}

/// One after the other.
#[derive(Clone, Copy, Debug, Default)]
pub struct InTurn;

impl Workers for InTurn {
    fn each(&self, count: usize, work: &(dyn Fn(usize) + Sync)) {
        (0..count).for_each(work);
    }
}
