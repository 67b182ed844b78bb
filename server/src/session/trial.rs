//! `FitCost`: what a frame would cost with a model, measured beside the session that the model is for.
//!
//! What comes in: a tracker that remembers what the session's does, and a frame that the session has just fitted. What goes out:
//! the time of a processor that a fit takes, the median of five. It never delays a fit of the session: all of it happens on
//! another thread, in its turn.

use std::time::Duration;

use isophote_machine::thread_ns;
use isophote_tracker::{Frame, Stop, TrackState, Tracker, Watch};

use crate::limits::LIMITS;
use crate::turns::FairWorkers;

/// Fits that are timed.
const RUNS: usize = 5;

/// What a fit takes.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct FitCost(Duration);

impl FitCost {
    /// With a search before it where the target is not near where it is expected: that is not part of every frame. A search
    /// that takes too long is what it says instead: each frame would begin one anew.
    pub fn measured(tracker: &Tracker, frame: &Frame, workers: &FairWorkers) -> TrialResult {
        let (settled, spent) = workers.piece(|| {
            let (mut tracker, trial) = (tracker.fork(), Trial::begin(LIMITS.settle_time, true));
            let estimates = tracker.track_all_while(frame, &trial);
            let is_there = estimates.iter().any(|estimate| estimate.state == TrackState::Tracking);
            (is_there.then_some(tracker), trial.worked())
        });
        if settled.is_none() && spent > LIMITS.settle_time {
            return TrialResult::Search(FitCost(spent));
        }
        let tracker = settled.as_ref().unwrap_or(tracker);
        let run = |_| {
            workers.piece(|| {
                let (mut tracker, trial) = (tracker.fork(), Trial::begin(LIMITS.trial_time, false));
                tracker.track_all_while(frame, &trial);
                FitCost(trial.worked())
            })
        };
        let mut costs: Vec<FitCost> = (0..RUNS).map(run).collect();
        costs.sort_by_key(|cost| cost.0);
        TrialResult::Fit(costs[RUNS / 2])
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
}

impl Trial {
    fn begin(within: Duration, may_search: bool) -> Trial {
        Trial { begin_ns: thread_ns(), within, may_search }
    }

    fn worked(&self) -> Duration {
        Duration::from_nanos(thread_ns().saturating_sub(self.begin_ns))
    }
}

impl Watch for Trial {
    fn stop(&self) -> Option<Stop> {
        (self.worked() > self.within).then_some(Stop::Budget)
    }

    fn search(&self) -> Option<Stop> {
        (!self.may_search).then_some(Stop::Postponed)
    }
}
