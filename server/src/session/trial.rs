//! `FitCost`: what a frame would cost with a model, measured beside the session that the model is for.
//!
//! What comes in: a tracker that remembers what the session's does, two frames that the session has just fitted, one after the
//! other, and what may be too much. What goes out: the time of a processor that a frame takes, the median of five, or that
//! of those which decide it. It never delays a fit of the session: all of it happens on another thread, in its turn.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use isophote_machine::thread_ns;
use isophote_tracker::{Frame, Stop, TrackState, Tracker, Watch};

use super::inbox::{Delivery, Inbox, SampleFrame};
use crate::limits::LIMITS;
use crate::source::Source;
use crate::turns::FairWorkers;

/// Fits that are timed.
const RUNS: usize = 5;
/// So many of them on one side of a bound are the median's.
const MAJORITY: usize = RUNS / 2 + 1;

/// What a fit takes.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct FitCost(Duration);

/// Frames that something is tried on.
pub struct TrialPair {
    /// The session has fitted it.
    first: Arc<Delivery>,
    /// The one that came next, if one did.
    next: Option<Arc<Delivery>>,
}

impl TrialPair {
    /// Of a source, as a session of it that has that inbox has fitted them: the first is there, the next is waited for. It is
    /// asked for before anything is tried, which may take as long as a target needs to be somewhere else.
    pub fn of(source: &Source, inbox: &Inbox, first: Arc<Delivery>) -> TrialPair {
        let interval = source.interval().filter(|_| !source.is_still());
        let next =
            interval.and_then(|interval| inbox.sample(SampleFrame::Next, (2 * interval).min(LIMITS.frame_budget)));
        TrialPair { first, next: next.map(|sample| sample.delivery) }
    }

    /// The one to search for the target, and the one to follow it to.
    fn both(&self) -> [&Frame; 2] {
        let next = self.next.as_ref().unwrap_or(&self.first);
        [&self.first, next].map(|delivery| &delivery.captured.frame)
    }
}

impl FitCost {
    /// With a search before it where the target is not near where it is expected: that is not part of every frame. A search
    /// that takes too long is what it says instead: each frame would begin one anew. Where it is asked what takes more than `most`,
    /// so does a search that has found the target where the fit of the next frame loses it again, and nothing is looked at for
    /// longer than that.
    pub fn measured(
        tracker: &Tracker,
        frames: &TrialPair,
        workers: &FairWorkers,
        most: Option<Duration>,
    ) -> TrialResult {
        let [first, next] = frames.both();
        let (settled, spent) = workers.piece(|| {
            let (mut tracker, trial) = (tracker.fork(), Trial::begin(LIMITS.settle_time, true));
            let estimates = tracker.track_all_while(first, &trial);
            let is_there = estimates.iter().any(|estimate| estimate.state == TrackState::Tracking);
            (is_there.then_some(tracker), trial.worked())
        });
        if settled.is_none() && spent > LIMITS.settle_time {
            return TrialResult::Search(FitCost(spent));
        }
        let is_found = settled.is_some();
        let tracker = settled.as_ref().unwrap_or(tracker);
        let within = most.unwrap_or(LIMITS.trial_time).min(LIMITS.trial_time);
        let mut costs = Vec::with_capacity(RUNS);
        while costs.len() < RUNS && most.is_none_or(|most| !is_decided(&costs, most)) {
            costs.push(workers.piece(|| {
                let (mut tracker, trial) = (tracker.fork(), Trial::begin(within, false));
                tracker.track_all_while(next, &trial);
                let has_lost = most.is_some() && is_found && trial.has_lost();
                FitCost(trial.worked() + if has_lost { spent } else { Duration::ZERO })
            }));
        }
        tracing::debug!(?costs, is_found, ?spent, "model tried");
        TrialResult::Fit(median(costs, most))
    }

    /// More than this.
    pub fn exceeds(self, budget: Duration) -> bool {
        self.0 > budget
    }

    /// ms; of what was left before it was done, so much at least.
    pub fn milliseconds(self) -> f64 {
        self.0.as_secs_f64() * 1e3
    }
}

/// Whether the median of all is known to be over it, or not.
fn is_decided(costs: &[FitCost], most: Duration) -> bool {
    let over = costs.iter().filter(|cost| cost.exceeds(most)).count();
    over.max(costs.len() - over) >= MAJORITY
}

/// Of all, or of those that were enough: the nearest to `most` that it can be.
fn median(mut costs: Vec<FitCost>, most: Option<Duration>) -> FitCost {
    costs.sort_by_key(|cost| cost.0);
    let over = most.map_or(0, |most| costs.iter().filter(|cost| cost.exceeds(most)).count());
    let place = if over >= MAJORITY { costs.len() - MAJORITY } else { MAJORITY - 1 };
    costs.get(place).copied().unwrap_or(FitCost(Duration::ZERO))
}

/// What was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TrialResult {
    /// Fits around the target, or where it should be: the median.
    Fit(FitCost),
    /// A search for it that was left.
    Search(FitCost),
}

/// One run.
struct Trial {
    begin_ns: u64,
    within: Duration,
    may_search: bool,
    has_lost: AtomicBool,
}

impl Trial {
    fn begin(within: Duration, may_search: bool) -> Trial {
        Trial { begin_ns: thread_ns(), within, may_search, has_lost: AtomicBool::new(false) }
    }

    fn worked(&self) -> Duration {
        Duration::from_nanos(thread_ns().saturating_sub(self.begin_ns))
    }

    /// The whole frame was to be searched.
    fn has_lost(&self) -> bool {
        self.has_lost.load(Ordering::Relaxed)
    }
}

impl Watch for Trial {
    fn stop(&self) -> Option<Stop> {
        (self.worked() > self.within).then_some(Stop::Budget)
    }

    fn search(&self) -> Option<Stop> {
        self.has_lost.store(true, Ordering::Relaxed);
        (!self.may_search).then_some(Stop::Postponed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOST: Duration = Duration::from_millis(100);

    fn costs(all_ms: &[u64]) -> Vec<FitCost> {
        all_ms.iter().map(|ms| FitCost(Duration::from_millis(*ms))).collect()
    }

    #[test]
    fn three_of_five_decide() {
        for (all_ms, is_known) in [
            (&[][..], false),
            (&[101, 101][..], false),
            (&[101, 1, 101, 1][..], false),
            (&[101, 101, 101][..], true),
            (&[1, 100, 101, 2][..], true),
            (&[101, 1, 101, 1, 101][..], true),
        ] {
            assert_eq!(is_decided(&costs(all_ms), MOST), is_known, "{all_ms:?}");
        }
    }

    #[test]
    fn the_median_is_on_the_side_that_was_decided() {
        let of = |all_ms: &[u64], most| median(costs(all_ms), most).milliseconds();
        assert_eq!(of(&[5, 1, 4, 2, 3], None), 3.0);
        assert_eq!(of(&[500, 101, 300], Some(MOST)), 101.0);
        assert_eq!(of(&[1, 500, 300, 200], Some(MOST)), 200.0);
        assert_eq!(of(&[1, 2, 500, 3], Some(MOST)), 3.0);
        assert_eq!(of(&[101, 1, 102, 2, 103], Some(MOST)), 101.0);
    }
}
