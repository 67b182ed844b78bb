//! `FitCost`: measures the processor time of a frame with a new model, off the session's fit thread, which it never delays.
//!
//! Forks a tracker that carries the session's state and fits the second of two consecutive frames that the session has just
//! fitted: the median of `RUNS` fits, or of those that decide the comparison with a bound.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use isophote_machine::thread_ns;
use isophote_tracker::{Frame, Stop, TrackState, Tracker, Watch};

use super::inbox::{Delivery, Inbox, SampleFrame};
use crate::limits::LIMITS;
use crate::service::turns::FairWorkers;
use crate::source::Source;

/// Number of timed fits.
const RUNS: usize = 5;
/// So many fits on one side of a bound decide the side of the median.
const MAJORITY: usize = RUNS / 2 + 1;

/// Processor time of a fit.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct FitCost(Duration);

/// Frames to measure on.
pub struct TrialPair {
    /// A frame that the session has fitted.
    first: Arc<Delivery>,
    /// The next frame, if one arrived.
    next: Option<Arc<Delivery>>,
}

impl TrialPair {
    /// Takes `first`, as the session with that inbox has fitted it, and waits for the next frame. Called before any
    /// measurement: that may take so long that the target moves on.
    pub fn of(source: &Source, inbox: &Inbox, first: Arc<Delivery>) -> TrialPair {
        let interval = source.interval().filter(|_| !source.is_still());
        let next =
            interval.and_then(|interval| inbox.sample(SampleFrame::Next, (2 * interval).min(LIMITS.frame_budget)));
        TrialPair { first, next: next.map(|sample| sample.delivery) }
    }

    /// The frame to search for the target, and the one to track it to.
    fn both(&self) -> [&Frame; 2] {
        let next = self.next.as_ref().unwrap_or(&self.first);
        [&self.first, next].map(|delivery| &delivery.captured.frame)
    }
}

impl FitCost {
    /// Measures a fit, after a search if the target is not near its prediction: the search is not part of every frame. Returns
    /// the search instead if it takes longer than `LIMITS.settle_time`: each frame would start it again. With `most`, stops
    /// once the comparison is decided, limits each fit to `most`, and adds the search time to a fit that loses the target which
    /// the search had found.
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

    /// Whether it is more than `budget`.
    pub fn exceeds(self, budget: Duration) -> bool {
        self.0 > budget
    }

    /// In ms; a lower bound for a fit that was cut short.
    pub fn milliseconds(self) -> f64 {
        self.0.as_secs_f64() * 1e3
    }
}

/// Whether it is certain on which side of `most` the median of all fits lies.
fn is_decided(costs: &[FitCost], most: Duration) -> bool {
    let over = costs.iter().filter(|cost| cost.exceeds(most)).count();
    over.max(costs.len() - over) >= MAJORITY
}

/// The median of all fits, or of those until the decision: then the value nearest to `most` that it can have.
fn median(mut costs: Vec<FitCost>, most: Option<Duration>) -> FitCost {
    costs.sort_by_key(|cost| cost.0);
    let over = most.map_or(0, |most| costs.iter().filter(|cost| cost.exceeds(most)).count());
    let place = if over >= MAJORITY { costs.len() - MAJORITY } else { MAJORITY - 1 };
    costs.get(place).copied().unwrap_or(FitCost(Duration::ZERO))
}

/// The measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TrialResult {
    /// The median of fits around the target or its prediction.
    Fit(FitCost),
    /// A search for the target that was cut short.
    Search(FitCost),
}

/// Limits of one fit.
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

    /// Whether the fit asked for a search of the whole frame.
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
    fn three_of_five_fits_decide() {
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
    fn median_lies_on_the_decided_side() {
        let of = |all_ms: &[u64], most| median(costs(all_ms), most).milliseconds();
        assert_eq!(of(&[5, 1, 4, 2, 3], None), 3.0);
        assert_eq!(of(&[500, 101, 300], Some(MOST)), 101.0);
        assert_eq!(of(&[1, 500, 300, 200], Some(MOST)), 200.0);
        assert_eq!(of(&[1, 2, 500, 3], Some(MOST)), 3.0);
        assert_eq!(of(&[101, 1, 102, 2, 103], Some(MOST)), 101.0);
    }
}
