//! The controller: estimates in, the exposure to set out.
//!
//! A camera applies a change some frames late. A frame's advice is about the exposure with which it was taken, so after a
//! change the controller waits until its effect has been seen. Nothing oscillates, because no advice is followed twice: who asks
//! again for what was just done has not got it yet, and a camera that is later than said is waited for, for some frames. A large
//! change is made at once, and put right once or twice; small ones are asked for by flickering light as well, so then the mean
//! of many frames has to ask for one: whoever follows flicker some frames late makes it worse. Where no target is seen it looks
//! for light, then for darkness, unless the frame says which, or there was no time to look.

use std::collections::VecDeque;

use crate::estimate::{Ending, Estimate, TrackState};

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
/// A change by more than this factor is made at once: flicker of ±20 % asks for no more than half as much, at its worst.
const SUDDEN: f64 = 2.0;
/// So many smaller ones after it, too.
const TOUCHES: u32 = 2;
/// A camera may be so many frames later than it says.
const LATER: u64 = 8;
/// What differs by less than this share of a change, in e-folds, is asked for again.
const SAME: f64 = 0.1;
/// A smaller one is what so many frames ask for in the mean: a second of a common camera.
const STEADY: usize = 64;
/// The factor of a change where no target is seen.
const BLIND: f64 = 4.0;
/// So many frames in a row whose looks ended with their time say that it is the light after all.
const CUT_OFF: u32 = 8;
/// A target that was saturated to this share when it was last seen is lost to light, not to darkness.
const TOO_BRIGHT: f64 = 0.3;

/// Sets an exposure.
#[derive(Clone, Debug)]
pub struct ExposureController {
    options: ControllerOptions,
    factor: f64,
    /// The first frame whose advice may be followed.
    next: u64,
    /// ln of what was asked for when the exposure was last changed, and of that change.
    followed: Option<[f64; 2]>,
    /// Where to look for a target that is not seen.
    direction: f64,
    /// Small changes that are made at once.
    touches: u32,
    /// Frames in a row in which nothing was found before the time for it had passed.
    cut_off: u32,
    /// ln of what frames have asked for since the last change.
    asked: VecDeque<f64>,
}

impl ExposureController {
    /// From the exposure as it is, which is 1.
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
        // Who had no time to look does not know that there is nothing to be seen.
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
        // This frame's successor is on its way already; the change shows `latency` frames after that.
        self.next = estimate.sequence + self.options.latency + 2;
        Some(factor)
    }

    /// A frame asks for the same as before the last change: it was taken without it.
    fn is_awaited(&self, sequence: u64, asked: f64) -> bool {
        let is_early = sequence < self.next + LATER;
        is_early && self.followed.is_some_and(|[was, change]| (asked.ln() - was).abs() < SAME * change.abs())
    }

    /// What of a change that a frame asks for is made now.
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
        // What is in the middle counts most: so flicker leaves next to nothing in the mean, though its periods end anywhere.
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
