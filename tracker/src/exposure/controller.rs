//! The controller: estimates in, the exposure to set out.
//!
//! A camera applies a change some frames late. A frame's advice is about the exposure with which it was taken, so after a
//! change the controller waits until its effect has been seen; then the advice is followed at once. Nothing oscillates,
//! because no advice is followed twice. Where no target is seen it looks for light, then for darkness.

use crate::estimate::{Estimate, TrackState};

/// What a controller may do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControllerOptions {
    /// Frames from setting an exposure to the first frame that has it.
    pub latency: u64,
    /// The least and the largest exposure, relative to that of the beginning.
    pub range: [f64; 2],
}

impl Default for ControllerOptions {
    fn default() -> ControllerOptions {
        ControllerOptions { latency: 2, range: [1.0 / 256.0, 256.0] }
    }
}

/// Advice nearer to 1 than this share is not followed.
const DEAD_BAND: f64 = 0.07;
/// One change is by no more than this factor.
const CHANGE_MAX: f64 = 8.0;
/// The factor of a change where no target is seen.
const BLIND: f64 = 4.0;
/// A target that was saturated to this share when it was last seen is lost to light, not to darkness.
const TOO_BRIGHT: f64 = 0.3;

/// Sets an exposure.
#[derive(Clone, Debug)]
pub struct ExposureController {
    options: ControllerOptions,
    factor: f64,
    /// The first frame whose advice may be followed.
    next: u64,
    /// Where to look for a target that is not seen.
    direction: f64,
}

impl ExposureController {
    /// From the exposure as it is, which is 1.
    pub fn new(options: ControllerOptions) -> ExposureController {
        ExposureController { options, factor: 1.0, next: 0, direction: BLIND }
    }

    /// The exposure that was asked for last.
    pub fn factor(&self) -> f64 {
        self.factor
    }

    /// What the camera made of the exposure that was asked for: it has steps and ends. What is not a positive number is left
    /// alone.
    pub fn took(&mut self, factor: f64) {
        if factor > 0.0 && factor.is_finite() {
            self.factor = factor;
        }
    }

    /// After each frame: the exposure to set from now on, when it changes.
    pub fn step(&mut self, estimate: &Estimate) -> Option<f64> {
        let change = match (estimate.state, &estimate.exposure_advice) {
            (TrackState::Tracking, Some(advice)) => {
                self.direction = if estimate.saturated > TOO_BRIGHT { 1.0 / BLIND } else { BLIND };
                advice.factor
            }
            (TrackState::Tracking | TrackState::Coasting, _) => return None,
            (TrackState::Searching | TrackState::Lost, _) => self.direction,
        };
        if estimate.sequence < self.next || (change - 1.0).abs() < DEAD_BAND {
            return None;
        }
        let [least, most] = self.options.range;
        let wanted = self.factor * change.clamp(1.0 / CHANGE_MAX, CHANGE_MAX);
        let factor = wanted.clamp(least, most);
        if wanted != factor && estimate.state != TrackState::Tracking {
            self.direction = 1.0 / self.direction; // not this way
        }
        if factor == self.factor {
            return None;
        }
        self.factor = factor;
        // This frame's successor is on its way already; the change shows `latency` frames after that.
        self.next = estimate.sequence + self.options.latency + 2;
        Some(factor)
    }
}
