//! `FrameBudget`: how much work a frame may cost, and whether anybody still wants it.
//!
//! What comes in: units of work as they are spent, and a [`Watch`] that may end it at any time. What goes out: go on, or why
//! not. It never knows what the work is, nor a clock: who has one looks at it in the watch.
//!
//! A unit is one pixel of one pass of a usual document. Whatever else is done is charged by the pixels that take about as long.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

/// Why work ends before it is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// It took too much.
    Budget,
    /// Nobody wants it any more.
    Cancelled,
    /// All that may be looked at is to be searched, and not now: others are at it.
    Postponed,
}

/// Who decides how long a frame is worked at. A closure is one that lets every search begin.
pub trait Watch: Sync {
    /// Asked before every pass and every step of a search; `None`: go on.
    fn stop(&self) -> Option<Stop>;

    /// Asked before all that may be looked at is searched, which takes longer than anything else; `None`: go on.
    fn search(&self) -> Option<Stop> {
        None
    }

    /// Whether the points that stages try are kept, see [`Estimate::trace`](crate::Estimate::trace).
    fn is_traced(&self) -> bool {
        false
    }
}

impl<F: Fn() -> Option<Stop> + Sync> Watch for F {
    fn stop(&self) -> Option<Stop> {
        self()
    }
}

/// Takes units before they are worked, or says why there is to be no more work.
pub(crate) type Spend<'a> = &'a dyn Fn(u64) -> Result<(), Stop>;

/// Units that a frame may cost where nothing else is said: minutes of one processor.
pub const WORK_MAX: u64 = 1 << 38;

/// The bound of one frame.
pub(crate) struct FrameBudget<'a> {
    watch: &'a dyn Watch,
    left: AtomicU64,
    stopped: OnceLock<Stop>,
    /// What this is a part of.
    whole: Option<&'a FrameBudget<'a>>,
}

impl<'a> FrameBudget<'a> {
    /// `work` units, while `watch` goes on.
    pub fn new(work: u64, watch: &'a dyn Watch) -> FrameBudget<'a> {
        FrameBudget { watch, left: AtomicU64::new(work), stopped: OnceLock::new(), whole: None }
    }

    /// `work` units of another one, as long as that has some.
    pub fn part(work: u64, whole: Option<&'a FrameBudget<'a>>) -> FrameBudget<'a> {
        FrameBudget { whole, ..FrameBudget::new(work, &|| None::<Stop>) }
    }

    /// Takes units before they are worked.
    ///
    /// # Errors
    /// Why no more work is to be done; from the first time on always the same.
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

    /// Asks for a search of all that may be looked at.
    ///
    /// # Errors
    /// Why there is to be none. Of what ended already: why it did.
    pub fn search(&self) -> Result<(), Stop> {
        self.stopped().or_else(|| self.watch.search()).map_or(Ok(()), Err)
    }

    /// True where the frame itself has used up what it may cost, not only a part of its work.
    pub fn is_over(&self) -> bool {
        match self.whole {
            Some(whole) => whole.is_over(),
            None => self.stopped.get() == Some(&Stop::Budget),
        }
    }

    /// Whether the points that stages try are kept.
    pub fn is_traced(&self) -> bool {
        self.whole.map_or_else(|| self.watch.is_traced(), FrameBudget::is_traced)
    }

    /// Why it ended, when it did.
    pub fn stopped(&self) -> Option<Stop> {
        self.stopped.get().copied().or_else(|| self.whole?.stopped())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_budget_ends_at_its_last_unit_and_stays_so() {
        for (work, third) in [(29, Err(Stop::Budget)), (30, Ok(())), (31, Ok(()))] {
            let budget = FrameBudget::new(work, &|| None::<Stop>);
            assert_eq!((budget.spend(10), budget.spend(10), budget.spend(10)), (Ok(()), Ok(()), third), "{work}");
        }
        let budget = FrameBudget::new(5, &|| None::<Stop>);
        assert_eq!((budget.spend(6), budget.spend(1)), (Err(Stop::Budget), Err(Stop::Budget)));
    }

    #[test]
    fn a_part_ends_alone_and_with_the_whole() {
        let whole = FrameBudget::new(30, &|| None::<Stop>);
        let part = FrameBudget::part(10, Some(&whole));
        assert_eq!((part.spend(10), part.spend(1)), (Ok(()), Err(Stop::Budget)));
        assert_eq!((whole.spend(19), whole.stopped()), (Ok(()), None), "11 units were asked for");
        let part = FrameBudget::part(10, Some(&whole));
        assert_eq!((part.spend(1), part.stopped()), (Err(Stop::Budget), Some(Stop::Budget)));
    }

    #[test]
    fn a_watch_ends_it_for_good() {
        let asked = AtomicU64::new(0);
        let once = || (asked.fetch_add(1, Ordering::Relaxed) == 1).then_some(Stop::Cancelled);
        let budget = FrameBudget::new(100, &once);
        assert_eq!(budget.spend(1), Ok(()));
        assert_eq!((budget.spend(1), budget.spend(1)), (Err(Stop::Cancelled), Err(Stop::Cancelled)));
        assert_eq!(budget.stopped(), Some(Stop::Cancelled));
    }
}
