//! `Status`: a session's state and counters.

use std::collections::VecDeque;
use std::time::Duration;

use isophote_tracker::Frame;
use isophote_wire::{ExposureControl, SessionState};

use super::swap::Active;
use super::watch::{FrameTimes, FrameUse};
use crate::service::capacity::mean_cost;
use crate::source::{FrameShape, Source};

/// Number of estimates over which the rate is measured.
const RATE_WINDOW: usize = 32;
/// A steady source has stalled after both this long, ns, and `STALL_PERIODS` periods without a frame.
const STALL_NS: u64 = 2_000_000_000;
const STALL_PERIODS: u64 = 8;

/// Written by the fit thread, read by everybody.
#[derive(Clone)]
pub struct Status {
    /// The last requested model.
    pub requested_model: String,
    /// The active model.
    pub active: Active,
    /// The first frame fitted with it.
    pub active_since_frame: u64,
    /// Frames fitted.
    pub frames: u64,
    /// Frames of the source that were not fitted.
    pub dropped: u64,
    /// Time limits of a fit around a prediction and of a search of the whole frame, if frames do not wait.
    pub budgets: Option<[Duration; 2]>,
    /// Frames whose fits or searches exceeded their limit.
    pub over_budget: u64,
    /// Frames with a search of the whole frame, and frames whose search was postponed by the search quota.
    pub searches: [u64; 2],
    /// Mean processor time of recent frames without a search, ns.
    pub cost_ns: Option<u64>,
    /// The same as measured before the first frame.
    pub expected_ns: Option<u64>,
    /// Whether the session may set its source's exposure, if it controls that.
    pub control: Option<ExposureControl>,
    /// The reason if it does not run.
    pub reason: Option<String>,
    /// Shape of the frames, after the first one.
    pub shape: Option<FrameShape>,
    has_other_sizes: bool,
    ended: Option<SessionState>,
    times_ns: VecDeque<u64>,
}

impl Status {
    /// The status before the first frame.
    pub fn new(active: Active, requested_model: String) -> Status {
        Status {
            requested_model,
            active,
            active_since_frame: 0,
            frames: 0,
            dropped: 0,
            budgets: None,
            over_budget: 0,
            searches: [0; 2],
            cost_ns: None,
            expected_ns: None,
            control: None,
            reason: None,
            shape: None,
            has_other_sizes: false,
            ended: None,
            times_ns: VecDeque::with_capacity(RATE_WINDOW),
        }
    }

    /// Counts a fitted frame, after `lost` that were not fitted.
    pub fn fitted(&mut self, frame: &Frame, now_ns: u64, lost: u64) {
        self.frames += 1;
        self.dropped += lost;
        if self.times_ns.len() == RATE_WINDOW {
            self.times_ns.pop_front();
        }
        self.times_ns.push_back(now_ns);
        let shape = self.shape.get_or_insert_with(|| FrameShape::of(frame));
        if shape.size.as_deref() != Some(frame.size()) {
            if !std::mem::replace(&mut self.has_other_sizes, true) {
                tracing::warn!(frame = frame.sequence, before = ?shape.size, now = ?frame.size(), "frame of another size");
            }
            *shape = FrameShape::of(frame);
        }
    }

    /// Counts how the frame's time was used.
    pub fn spent(&mut self, outcome: &FrameUse, times: Option<&FrameTimes>) {
        self.over_budget += u64::from(outcome.is_over);
        self.searches[0] += u64::from(outcome.has_searched);
        self.searches[1] += u64::from(outcome.is_postponed);
        self.budgets = times.map(|times| [times.fit, times.search]);
    }

    /// Adds the processor time of a frame to the mean.
    pub fn cost(&mut self, frame_ns: u64) {
        self.cost_ns = Some(mean_cost(self.load_ns(), frame_ns));
    }

    /// The mean cost, else the expected one.
    pub fn load_ns(&self) -> Option<u64> {
        self.cost_ns.or(self.expected_ns)
    }

    /// Marks the session as ended; it exists but does not fit.
    pub fn end(&mut self, state: SessionState, reason: String) {
        self.ended = Some(state);
        self.reason = Some(reason);
    }

    /// Its state at `now_ns` with frames from `source`, and the reason if it does not run.
    pub fn state(&self, now_ns: u64, source: &Source) -> (SessionState, Option<String>) {
        let Some(last_ns) = self.times_ns.back() else {
            return (self.ended.unwrap_or(SessionState::Starting), self.reason.clone());
        };
        let first_ns = self.times_ns.front().unwrap_or(last_ns);
        let seen_ns = (last_ns - first_ns) / (self.times_ns.len() as u64 - 1).max(1);
        // The source may have become slower.
        let period_ns = seen_ns.max(source.interval().map_or(0, |interval| interval.as_nanos() as u64));
        if let Some(ended) = self.ended {
            return (ended, self.reason.clone());
        }
        let Some(since_ns) = source.steady_since_ns() else { return (SessionState::Running, self.reason.clone()) };
        let silence_ns = now_ns.saturating_sub(since_ns.max(*last_ns));
        if silence_ns <= STALL_NS.max(STALL_PERIODS * period_ns) {
            return (SessionState::Running, self.reason.clone());
        }
        let reason = format!("no picture was fitted for {:.0} s", silence_ns as f64 * 1e-9);
        (SessionState::Stalled, Some(reason))
    }

    /// Estimates per second; falls while none arrive.
    pub fn rate_hz(&self, now_ns: u64) -> f64 {
        let (Some(first_ns), Some(last_ns)) = (self.times_ns.front(), self.times_ns.back()) else { return 0.0 };
        let periods = self.times_ns.len() as u64 - 1;
        if periods == 0 || self.ended.is_some() {
            return 0.0;
        }
        let period_ns = (last_ns - first_ns) / periods;
        let silence_ns = now_ns.saturating_sub(*last_ns);
        let span_ns = last_ns - first_ns + silence_ns.saturating_sub(period_ns);
        if span_ns == 0 { 0.0 } else { periods as f64 * 1e9 / span_ns as f64 }
    }
}
