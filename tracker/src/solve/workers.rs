//! Runs independent pieces of work: this crate has no threads, so callers supply them.

/// Calls a function once with each number below a count, in any order, perhaps concurrently, and returns when all calls are
/// done.
pub trait Workers {
    /// Calls `work` with each number below `count`.
    fn each(&self, count: usize, work: &(dyn Fn(usize) + Sync));
}

/// Runs sequentially on the calling thread.
#[derive(Clone, Copy, Debug, Default)]
pub struct InTurn;

impl Workers for InTurn {
    fn each(&self, count: usize, work: &(dyn Fn(usize) + Sync)) {
        (0..count).for_each(work);
    }
}
