//! Work budget of a document, in counted units: symbolic has no clock.
//!
//! Counts units of work and operations kept against [`LIMITS`] while a document is read and all its stages are derived,
//! on any thread.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use isophote_syntax::limits::LIMITS;

/// Units that a holder may spend before it publishes them.
const UNTOLD: usize = 1024;

/// Spent part of a document's budget.
#[derive(Debug, Default)]
struct Spent {
    work: AtomicUsize,
    kept: AtomicUsize,
}

/// A document's budget, shared by its clones.
#[derive(Debug, Default)]
pub(crate) struct Budget {
    spent: Arc<Spent>,
    /// That of [`Budget::for_options`].
    options: Arc<Spent>,
    untold: usize,
}

impl Budget {
    /// The budget of a document whose reading took `work` units.
    pub fn after(work: usize) -> Budget {
        let budget = Budget::default();
        budget.spent.work.store(work, Relaxed);
        budget
    }

    /// A budget of `units`, which the document has paid for already.
    pub fn with(units: usize) -> Budget {
        Budget::after(LIMITS.work.saturating_sub(units))
    }

    /// A second budget of the document for optional work, as large and shared in the same way.
    pub fn for_options(&self) -> Budget {
        Budget { spent: self.options.clone(), options: self.options.clone(), untold: 0 }
    }

    /// Charges units of work; false when the budget is known to be spent.
    pub fn charge(&mut self, units: usize) -> bool {
        self.untold += units;
        self.untold < UNTOLD || self.tell() <= LIMITS.work
    }

    /// Charges memory that stays in use, in operations; false beyond the limit.
    pub fn keep(&self, operations: usize) -> bool {
        self.spent.kept.fetch_add(operations, Relaxed) + operations <= LIMITS.kept
    }

    /// Units spent so far: those published by all holders, and its own.
    pub fn work(&self) -> usize {
        self.spent.work.load(Relaxed) + self.untold
    }

    /// True when all holders together exceed the limit: results may be truncated.
    pub fn is_spent(&self) -> bool {
        self.work() > LIMITS.work
    }

    fn tell(&mut self) -> usize {
        let units = std::mem::take(&mut self.untold);
        self.spent.work.fetch_add(units, Relaxed) + units
    }
}

impl Clone for Budget {
    fn clone(&self) -> Budget {
        Budget { spent: self.spent.clone(), options: self.options.clone(), untold: 0 }
    }
}

impl Drop for Budget {
    fn drop(&mut self) {
        self.tell();
    }
}

#[cfg(test)]
#[path = "budget_tests.rs"]
mod tests;
