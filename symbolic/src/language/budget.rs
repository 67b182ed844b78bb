//! What a document may cost, counted: symbolic has no clock.
//!
//! What comes in: units of work, and operations that are kept, where they are spent: while a document is read, and while all
//! of its stages are derived, whatever thread does it. What goes out: whether the document has gone past [`LIMITS`]. It never
//! knows what the work was.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use isophote_syntax::limits::LIMITS;

/// Units that one holder may have spent before all others know.
const UNTOLD: usize = 1024;

/// What is spent of one document's budget.
#[derive(Debug, Default)]
struct Spent {
    work: AtomicUsize,
    kept: AtomicUsize,
}

/// A document's budget. Its clones draw on the same one.
#[derive(Debug, Default)]
pub(crate) struct Budget {
    spent: Arc<Spent>,
    /// That of [`Budget::for_options`].
    options: Arc<Spent>,
    untold: usize,
}

impl Budget {
    /// Of a document whose reading took so much.
    pub fn after(work: usize) -> Budget {
        let budget = Budget::default();
        budget.spent.work.store(work, Relaxed);
        budget
    }

    /// Of so many units, which a document has paid for already.
    pub fn with(units: usize) -> Budget {
        Budget::after(LIMITS.work.saturating_sub(units))
    }

    /// A second budget of the document, as large as this one and shared as this one is, for what it can do without.
    pub fn for_options(&self) -> Budget {
        Budget { spent: self.options.clone(), options: self.options.clone(), untold: 0 }
    }

    /// Takes units of work; false when the budget is known to be spent.
    pub fn charge(&mut self, units: usize) -> bool {
        self.untold += units;
        self.untold < UNTOLD || self.tell() <= LIMITS.work
    }

    /// Takes memory that stays in use, in operations; false when there is no more.
    pub fn keep(&self, operations: usize) -> bool {
        self.spent.kept.fetch_add(operations, Relaxed) + operations <= LIMITS.kept
    }

    /// Units spent so far, by all holders.
    pub fn work(&self) -> usize {
        self.spent.work.load(Relaxed) + self.untold
    }

    /// True when all holders together went past the limit: what was made by then may have been cut short.
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
