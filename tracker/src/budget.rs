//! `FrameBudget`: the work limit of a frame, and its cancellation by a [`Watch`].
//!
//! It has no clock: deadlines are checked in the watch.
//!
//! A unit is one pixel of one pass of a usual document. Other work is charged by the pixels that take about as long.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

/// Why work stops early.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// The work limit is exhausted.
    Budget,
    /// Cancelled by the caller.
    Cancelled,
    /// A full search is needed but postponed: other searches are running.
    Postponed,
}

/// Decides when to stop working on a frame. A closure is a watch that allows every search.
pub trait Watch: Sync {
    /// Called before every pass and every step of a search; `None`: continue.
    fn stop(&self) -> Option<Stop>;

    /// Called before a full search, which takes longer than anything else; `None`: continue.
    fn search(&self) -> Option<Stop> {
        None
    }

    /// Whether stages record their trial points, see [`Estimate::trace`](crate::Estimate::trace).
    fn is_traced(&self) -> bool {
        false
    }
}

impl<F: Fn() -> Option<Stop> + Sync> Watch for F {
    fn stop(&self) -> Option<Stop> {
        self()
    }
}

/// Charges units before the work is done, or returns why to stop.
pub(crate) type Spend<'a> = &'a dyn Fn(u64) -> Result<(), Stop>;

/// Default work limit of a frame: minutes of one processor.
pub const WORK_MAX: u64 = 1 << 38;

/// The work limit of one frame.
pub(crate) struct FrameBudget<'a> {
    watch: &'a dyn Watch,
    left: AtomicU64,
    stopped: OnceLock<Stop>,
    /// The enclosing budget.
    whole: Option<&'a FrameBudget<'a>>,
}

impl<'a> FrameBudget<'a> {
    /// `work` units, until `watch` stops.
    pub fn new(work: u64, watch: &'a dyn Watch) -> FrameBudget<'a> {
        FrameBudget { watch, left: AtomicU64::new(work), stopped: OnceLock::new(), whole: None }
    }

    /// `work` units of another budget, as long as it lasts.
    pub fn part(work: u64, whole: Option<&'a FrameBudget<'a>>) -> FrameBudget<'a> {
        FrameBudget { whole, ..FrameBudget::new(work, &|| None::<Stop>) }
    }

    /// Charges units before the work is done.
    ///
    /// # Errors
    /// The reason to stop; the first one is repeated by every later call.
    pub fn spend(&self, units: u64) -> Result<(), Stop> {
        if let Some(stop) = self.stopped() {
            return Err(stop);
        }
        self.whole.map_or(Ok(()), |whole| whole.spend(units))?;
        let enough = self.left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(units));
        let stop = if enough.is_err() { Some(Stop::Budget) } else { self.watch.stop() };
        match stop {
            Some(stop) => Err(*self.stopped.get_or_init(|| stop)),
            None => Ok(()),
        }
    }

    /// Requests a full search.
    ///
    /// # Errors
    /// The reason to refuse; of a stopped budget its own reason.
    pub fn search(&self) -> Result<(), Stop> {
        self.stopped().or_else(|| self.watch.search()).map_or(Ok(()), Err)
    }

    /// True when the frame's own limit is exhausted, not only that of a part.
    pub fn is_over(&self) -> bool {
        match self.whole {
            Some(whole) => whole.is_over(),
            None => self.stopped.get() == Some(&Stop::Budget),
        }
    }

    /// Whether stages record their trial points.
    pub fn is_traced(&self) -> bool {
        self.whole.map_or_else(|| self.watch.is_traced(), FrameBudget::is_traced)
    }

    /// The reason it stopped, if it did.
    pub fn stopped(&self) -> Option<Stop> {
        self.stopped.get().copied().or_else(|| self.whole?.stopped())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn budget_stops_at_its_last_unit_permanently() {
        for (work, third) in [(29, Err(Stop::Budget)), (30, Ok(())), (31, Ok(()))] {
            let budget = FrameBudget::new(work, &|| None::<Stop>);
            assert_eq!((budget.spend(10), budget.spend(10), budget.spend(10)), (Ok(()), Ok(()), third), "{work}");
        }
        let budget = FrameBudget::new(5, &|| None::<Stop>);
        assert_eq!((budget.spend(6), budget.spend(1)), (Err(Stop::Budget), Err(Stop::Budget)));
    }

    #[test]
    fn part_stops_alone_and_with_the_whole() {
        let whole = FrameBudget::new(30, &|| None::<Stop>);
        let part = FrameBudget::part(10, Some(&whole));
        assert_eq!((part.spend(10), part.spend(1)), (Ok(()), Err(Stop::Budget)));
        assert_eq!((whole.spend(19), whole.stopped()), (Ok(()), None), "11 units were asked for");
        let part = FrameBudget::part(10, Some(&whole));
        assert_eq!((part.spend(1), part.stopped()), (Err(Stop::Budget), Some(Stop::Budget)));
    }

    #[test]
    fn watch_stops_a_budget_permanently() {
        let asked = AtomicU64::new(0);
        let once = || (asked.fetch_add(1, Ordering::Relaxed) == 1).then_some(Stop::Cancelled);
        let budget = FrameBudget::new(100, &once);
        assert_eq!(budget.spend(1), Ok(()));
        assert_eq!((budget.spend(1), budget.spend(1)), (Err(Stop::Cancelled), Err(Stop::Cancelled)));
        assert_eq!(budget.stopped(), Some(Stop::Cancelled));
    }
}
