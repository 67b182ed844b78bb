//! Counters and histograms, read by `http/routes/metrics.rs`.
//!
//! Counting never blocks: every number is an atomic. A session's counters are dropped with it.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use isophote_tracker::{Estimate, TrackState};

/// Times, s: from a fit of a small spot to an abandoned fit.
const TIMES_S: [f64; 14] = [5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.25, 1.0, 5.0];
/// Iterations of all stages of a fit.
const ITERATIONS: [f64; 9] = [1.0, 2.0, 3.0, 5.0, 8.0, 13.0, 21.0, 34.0, 55.0];
/// χ²/ν; 1 is best.
const CHI_SQUARES: [f64; 11] = [0.25, 0.5, 0.8, 0.9, 1.0, 1.1, 1.25, 1.5, 2.0, 5.0, 20.0];
/// Shares.
const SHARES: [f64; 8] = [0.0, 0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9];

/// A counter.
#[derive(Debug, Default)]
pub struct Tally(AtomicU64);

impl Tally {
    /// Adds to the count.
    pub fn add(&self, more: u64) {
        self.0.fetch_add(more, Ordering::Relaxed);
    }

    /// The count.
    pub fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// A histogram of values.
#[derive(Debug)]
pub struct Histogram {
    /// Inclusive upper bounds of all buckets but the last.
    bounds: &'static [f64],
    counts: Box<[AtomicU64]>,
    /// The bits of the sum.
    sum: AtomicU64,
}

/// A histogram at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct Distribution {
    /// Upper bounds, each with the number of values up to it.
    pub up_to: Vec<(f64, u64)>,
    /// Number of values.
    pub count: u64,
    /// Their sum.
    pub sum: f64,
}

impl Histogram {
    fn new(bounds: &'static [f64]) -> Histogram {
        let counts = (0..=bounds.len()).map(|_| AtomicU64::new(0)).collect();
        Histogram { bounds, counts, sum: AtomicU64::new(0.0f64.to_bits()) }
    }

    /// Adds a value; ignores one that is not finite.
    pub fn observe(&self, value: f64) {
        if !value.is_finite() {
            return;
        }
        let part = self.bounds.partition_point(|bound| *bound < value);
        self.counts[part].fetch_add(1, Ordering::Relaxed);
        let add = |bits| Some((f64::from_bits(bits) + value).to_bits());
        // Cannot fail: `add` always returns `Some`.
        self.sum.fetch_update(Ordering::Relaxed, Ordering::Relaxed, add).ok();
    }

    /// The values observed so far.
    pub fn distribution(&self) -> Distribution {
        let counts = self.counts.iter().map(|count| count.load(Ordering::Relaxed));
        let mut cumulative = counts.scan(0, |total, count| {
            *total += count;
            Some(*total)
        });
        let up_to = self.bounds.iter().copied().zip(cumulative.by_ref()).collect::<Vec<_>>();
        let below = up_to.last().map_or(0, |(_, count)| *count);
        let count = cumulative.last().unwrap_or(below);
        Distribution { up_to, count, sum: f64::from_bits(self.sum.load(Ordering::Relaxed)) }
    }
}

/// Counters of the service.
#[derive(Debug)]
pub struct ServiceCounters {
    /// From documents to native code, s: for models, sessions and swaps.
    pub compile_s: Histogram,
    /// Fits of single images, s.
    pub image_fit_s: Histogram,
}

impl Default for ServiceCounters {
    fn default() -> ServiceCounters {
        ServiceCounters { compile_s: Histogram::new(&TIMES_S), image_fit_s: Histogram::new(&TIMES_S) }
    }
}

/// Counters of a session, written by its fit thread.
#[derive(Debug)]
pub struct SessionCounters {
    /// Time of a frame's fits, s.
    pub fit_s: Histogram,
    /// The same of frames that searched for a target because it was not tracked, s.
    pub search_s: Histogram,
    /// From a frame's capture to its estimates, s.
    pub age_s: Histogram,
    /// Iterations of a fit, of all stages.
    pub iterations: Histogram,
    /// χ²/ν of targets that are tracked.
    pub chi_square: Histogram,
    /// Share of a target's pixels that are saturated, of those that are tracked.
    pub saturated: Histogram,
    /// Frames that were fitted.
    pub frames: Tally,
    /// Frames of the source that were not fitted.
    pub dropped: Tally,
    /// Estimates, in the order of [`STATES`].
    pub estimates: [Tally; STATES.len()],
    /// Fits that were cancelled or ran out of budget.
    pub unfinished: Tally,
    /// Model swaps.
    pub swaps: Tally,
    /// Whether the next frame needs a search.
    is_searching: AtomicBool,
}

/// The states of a target, with their names.
pub const STATES: [(TrackState, &str); 4] = [
    (TrackState::Searching, "searching"),
    (TrackState::Tracking, "tracking"),
    (TrackState::Coasting, "coasting"),
    (TrackState::Lost, "lost"),
];

impl Default for SessionCounters {
    fn default() -> SessionCounters {
        SessionCounters {
            fit_s: Histogram::new(&TIMES_S),
            search_s: Histogram::new(&TIMES_S),
            age_s: Histogram::new(&TIMES_S),
            iterations: Histogram::new(&ITERATIONS),
            chi_square: Histogram::new(&CHI_SQUARES),
            saturated: Histogram::new(&SHARES),
            frames: Tally::default(),
            dropped: Tally::default(),
            estimates: Default::default(),
            unfinished: Tally::default(),
            swaps: Tally::default(),
            is_searching: AtomicBool::new(true),
        }
    }
}

impl SessionCounters {
    /// Counts a fitted frame, after `dropped` frames that were not fitted. Times in ns; `age_ns` since its capture.
    pub fn fitted(&self, estimates: &[Estimate], fit_ns: u64, age_ns: u64, dropped: u64) {
        let fit_s = fit_ns as f64 / 1e9;
        self.frames.add(1);
        self.dropped.add(dropped);
        self.fit_s.observe(fit_s);
        self.age_s.observe(age_ns as f64 / 1e9);
        let is_unfollowed = |one: &Estimate| matches!(one.state, TrackState::Searching | TrackState::Lost);
        if self.is_searching.swap(estimates.iter().any(is_unfollowed), Ordering::Relaxed) {
            self.search_s.observe(fit_s);
        }
        for estimate in estimates {
            self.estimated(estimate);
        }
    }

    fn estimated(&self, estimate: &Estimate) {
        for ((state, _), counter) in STATES.iter().zip(&self.estimates) {
            counter.add(u64::from(estimate.state == *state));
        }
        self.unfinished.add(u64::from(estimate.ending.is_unfinished()));
        if estimate.state != TrackState::Tracking {
            return;
        }
        self.iterations.observe(f64::from(estimate.iterations.iter().sum::<u32>()));
        self.saturated.observe(estimate.saturated);
        estimate.reduced_chi_square.iter().for_each(|value| self.chi_square.observe(*value));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn upper_bounds_are_inclusive() {
        let histogram = Histogram::new(&SHARES);
        for value in [0.0, 0.01, 0.011, 0.9, 1.0, f64::NAN, f64::INFINITY] {
            histogram.observe(value);
        }
        let Distribution { up_to, count, sum } = histogram.distribution();
        let counts: Vec<u64> = up_to.iter().map(|(_, count)| *count).collect();
        assert_eq!(counts, [1, 2, 3, 3, 3, 3, 3, 4]);
        assert_eq!((count, sum), (5, 0.0 + 0.01 + 0.011 + 0.9 + 1.0));
    }

    #[test]
    fn bounds_are_ascending() {
        for bounds in [&TIMES_S[..], &ITERATIONS, &CHI_SQUARES, &SHARES] {
            assert!(bounds.windows(2).all(|pair| pair[0] < pair[1]), "{bounds:?}");
        }
    }
}
