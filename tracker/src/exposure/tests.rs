#![allow(clippy::unwrap_used)]
use std::collections::VecDeque;
use std::sync::Arc;

use isophote_symbolic::{Model, Precision};

use super::*;
use crate::estimate::Ending;
use crate::picture::{Falloff, Spot, TestPicture};
use crate::{Compiled, Estimate, Frame, TrackState, Tracker, TrackerOptions};

const SPOT: &str = include_str!("../../../models/spot.toml");
const DISC: &str = include_str!("../../../models/bright-disc.toml");

fn tracker(document: &str, goal: ExposureGoal) -> Tracker {
    let noise = "saturated  = \"dropped\"\nnoise = \"0.668 + 0.051 * max(intensity, 0)\"";
    let model = Model::from_toml(&document.replace("saturated  = \"dropped\"", noise));
    let model = model.unwrap_or_else(|d| panic!("{}", d[0].render("test")));
    let options = TrackerOptions { exposure: Some(goal), ..TrackerOptions::default() };
    Tracker::new(Arc::new(Compiled::new(Arc::new(model), Precision::F32).unwrap()), options).unwrap()
}

/// A spot of 20 × 14 px over a background of a twentieth of its height, both proportional to the exposure.
fn frame(number: u64, profile: Falloff, amplitude: f64, exposure: f64) -> Frame {
    let spot = Spot { centre: [80.4, 60.3], half: [20.0, 14.0], angle: 0.4, amplitude: amplitude * exposure, profile };
    let ground = GROUND * amplitude * exposure;
    let picture =
        TestPicture { ground, noise: 1.2, seed: number, samples: 2, ..TestPicture::new(160, 120, vec![spot]) };
    picture.frame().with_sequence(number)
}

const GROUND: f64 = 0.05;
const CUBIC: Falloff = Falloff::Cubic(-0.5, -0.3);

/// The share of the spot that an amplitude saturates, by its profile.
fn share(amplitude: f64) -> f64 {
    let f = |s: f64| 1.0 - 0.5 * s - 0.3 * s * s - 0.2 * s * s * s;
    (0..1000).filter(|k| amplitude * (f(f64::from(*k) / 1000.0) + GROUND) >= 255.0).count() as f64 / 1000.0
}

#[test]
fn best_saturation_is_a_tenth_to_a_third_for_centre_and_little_for_brightness() {
    for (goal, least, most) in [(ExposureGoal::Centre, 0.1, 0.3), (ExposureGoal::Brightness, 0.0, 0.08)] {
        let mut bests = Vec::new();
        for amplitude in [40.0, 150.0, 400.0] {
            let estimate = tracker(SPOT, goal).track(&frame(1, CUBIC, amplitude, 1.0));
            let advice = estimate.exposure_advice.clone().unwrap_or_else(|| panic!("no advice: {estimate:?}"));
            assert_eq!(advice.goal, goal);
            let then = share(amplitude * advice.factor);
            assert!((least..=most).contains(&then), "{amplitude}: {then} {advice:?}");
            bests.push(amplitude * advice.factor);
        }
        assert!(bests[2] / bests[0] > 0.7 && bests[2] / bests[0] < 1.4, "whatever it was before: {bests:?}");
    }
}

#[test]
fn an_even_disc_is_not_overexposed() {
    let estimate = tracker(DISC, ExposureGoal::Centre).track(&frame(1, Falloff::Disc, 90.0, 1.0));
    let advice = estimate.exposure_advice.clone().unwrap_or_else(|| panic!("no advice: {estimate:?}"));
    let peak = 90.0 * (1.0 + GROUND) * advice.factor;
    assert!((150.0..=256.0).contains(&peak), "{peak} {advice:?}");
}

/// Simulates a camera that applies an exposure `latency` frames after the frame that requested it, plus the one in between.
fn run(amplitude: f64, frames: u64, latency: usize, goal: ExposureGoal) -> Vec<(f64, Estimate)> {
    let mut tracker = tracker(SPOT, goal);
    let mut controller = ExposureController::new(ControllerOptions::default());
    let mut pipeline: VecDeque<f64> = vec![1.0; latency].into();
    let mut run = Vec::new();
    for number in 0..frames {
        let exposure = pipeline.pop_front().unwrap();
        let estimate = tracker.track(&frame(number, CUBIC, amplitude, exposure));
        controller.step(&estimate);
        pipeline.push_back(controller.factor());
        run.push((exposure, estimate));
    }
    run
}

#[test]
fn controller_settles_within_fifteen_frames() {
    for amplitude in [560.0, 1.2, 8.0, 2000.0, 250.0] {
        for latency in [2, 3] {
            let run = run(amplitude, 36, latency, ExposureGoal::Centre);
            for (number, (exposure, estimate)) in run.iter().enumerate().skip(15) {
                let now = share(amplitude * exposure);
                assert_eq!(estimate.state, TrackState::Tracking, "{amplitude}, frame {number}: {estimate:?}");
                assert!((0.1..=0.32).contains(&now), "{amplitude}, frame {number}: {now} at {exposure}");
            }
            let settled: Vec<f64> = run[15..].iter().map(|(exposure, _)| *exposure).collect();
            let changes = settled.windows(2).filter(|pair| pair[0] != pair[1]).count();
            assert!(changes <= 2, "it holds still: {settled:?}");
        }
    }
}

#[test]
fn camera_later_than_its_latency_settles() {
    let run = run(560.0, 36, 7, ExposureGoal::Centre);
    let exposures: Vec<f64> = run.iter().map(|(exposure, _)| *exposure).collect();
    for exposure in &exposures[15..] {
        assert!((0.1..=0.32).contains(&share(560.0 * exposure)), "{exposures:?}");
    }
}

#[test]
fn controller_without_target_tries_both_directions_within_range() {
    let mut tracker = tracker(SPOT, ExposureGoal::Centre);
    let options = ControllerOptions { latency: 2, range: [0.25, 16.0] };
    let mut controller = ExposureController::new(options);
    let blank = |number: u64| TestPicture { noise: 1.2, seed: number, ..TestPicture::new(160, 120, vec![]) }.frame();
    let mut factors = Vec::new();
    for number in 0..60 {
        if let Some(factor) = controller.step(&tracker.track(&blank(number).with_sequence(number))) {
            factors.push(factor);
        }
    }
    assert!(factors.contains(&16.0) && factors.contains(&0.25), "{factors:?}");
    assert!(factors.iter().all(|factor| (0.25..=16.0).contains(factor)), "{factors:?}");
}

#[test]
fn frames_cut_off_by_budget_delay_the_search_for_light() {
    let mut tracker = tracker(SPOT, ExposureGoal::Centre);
    let mut controller = ExposureController::new(ControllerOptions::default());
    let blank = TestPicture { noise: 1.2, seed: 1, ..TestPicture::new(160, 120, vec![]) }.frame();
    let mut hasty = tracker.track(&blank);
    hasty.ending = Ending::Budget;
    let changes: Vec<u64> = (0..12)
        .filter(|number| {
            hasty.sequence = *number;
            controller.step(&hasty).is_some()
        })
        .collect();
    assert_eq!(changes, [7, 11], "a processor that is too slow for every frame looks for light in the end");
    // Frames that track the target, however late, do not count towards those that miss it.
    let mut controller = ExposureController::new(ControllerOptions::default());
    let mut followed = Estimate { state: TrackState::Tracking, ..hasty.clone() };
    for number in 0..20 {
        followed.sequence = number;
        controller.step(&followed);
    }
    hasty.sequence = 20;
    assert_eq!(controller.step(&hasty), None);
}
