//! Exposure controller: estimates in, the exposure to set out.
//!
//! A camera applies a change some frames late, and a frame's advice refers to the exposure of that frame, so after a
//! change the controller waits until its effect is visible. It does not oscillate, because no advice is followed twice:
//! a frame that repeats the last request was taken before the change, and late cameras get some extra frames. A large
//! change is made at once, with one or two corrections. Small changes may come from flickering light, and following
//! flicker with a delay amplifies it, so they need the mean of many frames. Without a target it tries more light, then
//! less, unless the frame advises a direction or the frame's budget ran out.

use std::collections::VecDeque;

use crate::estimate::{Ending, Estimate, TrackState};

/// Limits of a controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControllerOptions {
    /// Frames from setting an exposure to the first frame that has it.
    pub latency: u64,
    /// Least and largest exposure, relative to the initial one.
    pub range: [f64; 2],
}

impl Default for ControllerOptions {
    fn default() -> ControllerOptions {
        ControllerOptions { latency: 2, range: [1.0 / 256.0, 256.0] }
    }
}

/// Advice closer to 1 than this share is ignored.
const DEAD_BAND: f64 = 0.07;
/// Largest factor of one change.
const CHANGE_MAX: f64 = 8.0;
/// A change by more than this factor is made at once: flicker of ±20 % requests at most half of it.
const SUDDEN: f64 = 2.0;
/// Smaller changes that are made at once after a large one.
const TOUCHES: u32 = 2;
/// Extra frames that a camera may be late.
const LATER: u64 = 8;
/// A request within this share of the last change, in e-folds, repeats the request before it.
const SAME: f64 = 0.1;
/// Frames whose mean decides on small changes: a second of a common camera.
const STEADY: usize = 64;
/// Factor of a change without a target.
const BLIND: f64 = 4.0;
/// After this many frames in a row that ran out of budget, exposure is assumed to be the cause.
const CUT_OFF: u32 = 8;
/// A target that was saturated to this share when last seen is assumed lost to too much light.
const TOO_BRIGHT: f64 = 0.3;

/// Sets an exposure.
#[derive(Clone, Debug)]
pub struct ExposureController {
    options: ControllerOptions,
    factor: f64,
    /// The first frame whose advice may be followed.
    next: u64,
    /// ln of the advice at the last change, and of that change.
    followed: Option<[f64; 2]>,
    /// Factor to try while no target is seen.
    direction: f64,
    /// Small changes still to be made at once.
    touches: u32,
    /// Consecutive frames that ran out of budget without a target.
    cut_off: u32,
    /// ln of the advice since the last change.
    asked: VecDeque<f64>,
}

impl ExposureController {
    /// Starts at the current exposure, which is 1.
    pub fn new(options: ControllerOptions) -> ExposureController {
        let (touches, asked) = (TOUCHES, VecDeque::with_capacity(STEADY));
        ExposureController {
            options,
            factor: 1.0,
            next: 0,
            followed: None,
            direction: BLIND,
            touches,
            cut_off: 0,
            asked,
        }
    }

    /// The last requested exposure.
    pub fn factor(&self) -> f64 {
        self.factor
    }

    /// Corrects the exposure to the one that the camera applied, which has steps and limits. Non-positive and
    /// non-finite values are ignored.
    pub fn took(&mut self, factor: f64) {
        if factor > 0.0 && factor.is_finite() {
            self.factor = factor;
        }
    }

    /// Processes a frame's estimate; returns the new exposure when it changes.
    pub fn step(&mut self, estimate: &Estimate) -> Option<f64> {
        // A frame that ran out of budget is no evidence that there is no target.
        let is_cut_off = estimate.ending == Ending::Budget && estimate.state != TrackState::Tracking;
        self.cut_off = if is_cut_off { self.cut_off + 1 } else { 0 };
        if estimate.sequence < self.next {
            return None;
        }
        let change = match (estimate.state, &estimate.exposure_advice) {
            (TrackState::Tracking, Some(advice)) => {
                if self.is_awaited(estimate.sequence, advice.factor) {
                    return None;
                }
                self.direction = if estimate.saturated > TOO_BRIGHT { 1.0 / BLIND } else { BLIND };
                self.steadied(advice.factor)?
            }
            (TrackState::Tracking, None) | (TrackState::Coasting, None) => return None,
            (_, Some(advice)) => self.at_once(advice.factor),
            (TrackState::Searching | TrackState::Lost, None) if (1..CUT_OFF).contains(&self.cut_off) => return None,
            (TrackState::Searching | TrackState::Lost, None) => self.at_once(self.direction),
        };
        let [least, most] = self.options.range;
        let wanted = self.factor * change.clamp(1.0 / CHANGE_MAX, CHANGE_MAX);
        let factor = wanted.clamp(least, most);
        if wanted != factor && estimate.state != TrackState::Tracking {
            self.direction = 1.0 / self.direction; // not this way
        }
        if factor == self.factor {
            return None;
        }
        let asked = estimate.exposure_advice.as_ref().filter(|_| estimate.state == TrackState::Tracking);
        self.followed = asked.map(|advice| [advice.factor.ln(), (factor / self.factor).ln()]);
        self.factor = factor;
        self.asked.clear();
        // The next frame is already being exposed; the change shows `latency` frames after it.
        self.next = estimate.sequence + self.options.latency + 2;
        Some(factor)
    }

    /// True for a frame that repeats the request before the last change: it was taken without it.
    fn is_awaited(&self, sequence: u64, asked: f64) -> bool {
        let is_early = sequence < self.next + LATER;
        is_early && self.followed.is_some_and(|[was, change]| (asked.ln() - was).abs() < SAME * change.abs())
    }

    /// The part of a requested change to make now.
    fn steadied(&mut self, change: f64) -> Option<f64> {
        let asked = change.ln();
        if asked.abs() > SUDDEN.ln() {
            return Some(self.at_once(change));
        }
        let is_right = (change - 1.0).abs() < DEAD_BAND;
        if self.touches > 0 && !is_right {
            self.touches -= 1;
            return Some(change);
        }
        self.touches = 0;
        self.asked.push_back(asked);
        if self.asked.len() < STEADY {
            return None;
        }
        // Triangular weights: flicker nearly cancels in the mean, wherever its periods end.
        let weighted = self.asked.iter().enumerate().map(|(i, asked)| asked * (i + 1).min(STEADY - i) as f64);
        let weights = (STEADY / 2 * (STEADY / 2 + 1)) as f64;
        let mean = (weighted.sum::<f64>() / weights).exp();
        self.asked.pop_front();
        ((mean - 1.0).abs() >= DEAD_BAND).then_some(mean)
    }

    fn at_once(&mut self, change: f64) -> f64 {
        self.touches = TOUCHES;
        change
    }
}
