//! Swaps carry over the state that both models share.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use isophote_symbolic::{Model, Precision};

use crate::picture::{Falloff, Spot, TestPicture};
use crate::{Compiled, Estimate, Frame, TrackState, Tracker, TrackerOptions};

const PLAIN: &str = include_str!("../../../tests/documents/plain-spot.toml");
const GAUSSIAN: &str = include_str!("../../../models/gaussian.toml");
/// Without a centre.
const CURVE: &str = r#"
name        = "curve"
coordinates = ["i"]
channels    = ["px", "py"]
[parameters]
b1 = { start = 250 }
b2 = { start = 5e-4 }
[model]
observed  = "py"
intensity = "b1 * (1 - exp(-b2 * px))"
[[stages]]
parameters = ["b1", "b2"]
method     = "levenberg-marquardt"
"#;

fn compiled(document: &str) -> Arc<Compiled> {
    let model = Model::from_toml(document).unwrap_or_else(|d| panic!("{}", d[0].render("test")));
    Arc::new(Compiled::new(Arc::new(model), Precision::F32).unwrap())
}

/// The same model with other parameter names.
fn renamed(document: &str) -> String {
    let names = [("bx", "east"), ("by", "north"), ("a1", "wide"), ("a2", "skew"), ("a3", "high")];
    let mut text = String::new();
    let mut word = String::new();
    for letter in document.chars().chain(['\n']) {
        if letter.is_ascii_alphanumeric() {
            word.push(letter);
            continue;
        }
        text += names.iter().find(|(old, _)| *old == word).map_or(word.as_str(), |(_, new)| new);
        word.clear();
        text.push(letter);
    }
    text
}

fn frame(number: u64, centres: &[[f64; 2]]) -> Frame {
    let spot = |centre: &[f64; 2]| Spot {
        centre: *centre,
        half: [16.0, 12.0],
        angle: 0.3,
        amplitude: 120.0,
        profile: Falloff::Cubic(-0.5, -0.3),
    };
    let spots = centres.iter().map(spot).collect();
    TestPicture { noise: 1.5, seed: number + 1, ..TestPicture::new(320, 240, spots) }.frame().with_sequence(number)
}

/// A fast target: a start at its last position does not reach the next one.
fn path(number: u64) -> [f64; 2] {
    [40.0 + 9.0 * number as f64, 200.0 - 6.0 * number as f64]
}

fn off(tracker: &Tracker, estimate: &Estimate, truth: [f64; 2]) -> f64 {
    let centre = &tracker.compiled().model().roles()[0].centre;
    (0..2).map(|axis| (estimate.parameters[centre[axis].index()] - truth[axis]).powi(2)).sum::<f64>().sqrt()
}

/// Follows the path for some frames.
fn followed(options: &TrackerOptions, frames: u64) -> Tracker {
    let mut tracker = Tracker::new(compiled(PLAIN), options.clone()).unwrap();
    for number in 0..frames {
        let estimate = tracker.track(&frame(number, &[path(number)]));
        assert_eq!(estimate.state, TrackState::Tracking, "{number}: {estimate:?}");
    }
    tracker
}

#[test]
fn a_coasting_target_keeps_coasting() {
    // A background without a role is not carried over: it is unknown until the target is seen again.
    let strange = PLAIN.replace("background = \"v0\"\n", "").replace("v0", "ground");
    for document in [PLAIN.to_string(), renamed(PLAIN), GAUSSIAN.to_string(), strange.clone()] {
        let mut tracker = followed(&TrackerOptions::default(), 10);
        for number in 10..13 {
            assert_eq!(tracker.track(&frame(number, &[])).state, TrackState::Coasting);
        }
        let carried = tracker.swap(compiled(&document), TrackerOptions::default());
        assert_eq!(carried.moving, ["0"], "{carried:?}");
        for number in 13..16 {
            let estimate = tracker.track(&frame(number, &[]));
            assert_eq!(estimate.state, TrackState::Coasting, "{number}: {estimate:?}");
            assert!(off(&tracker, &estimate, path(number)) < 1.0, "{number}: {estimate:?}");
            assert_eq!(estimate.covariance.is_some(), document != strange);
            assert_eq!(estimate.parameters.iter().all(|value| value.is_finite()), document != strange);
        }
        let estimate = tracker.track(&frame(16, &[path(16)]));
        assert_eq!(estimate.state, TrackState::Tracking, "{estimate:?}");
        assert!(off(&tracker, &estimate, path(16)) < 0.2, "{estimate:?}");
    }
}

#[test]
fn velocity_and_its_learned_covariance_are_carried_over() {
    let predict = Some(crate::PredictOptions { horizon_s: 0.1, steps: 1 });
    let options = TrackerOptions { predict, ..TrackerOptions::default() };
    let renamed = renamed(PLAIN);
    for document in [PLAIN, &renamed] {
        let mut swapped = followed(&options, 12);
        let mut kept = followed(&options, 12);
        swapped.swap(compiled(document), options.clone());
        let next = frame(12, &[path(12)]);
        let (swapped, kept) = (swapped.track(&next), kept.track(&next));
        assert_eq!(swapped.state, TrackState::Tracking);
        let (one, other) = (&swapped.ahead[0], &kept.ahead[0]);
        for axis in 0..2 {
            assert!((one.velocity[axis] - other.velocity[axis]).abs() < 1e-3, "{one:?} {other:?}");
            let ratio = one.covariance[axis][axis] / other.covariance[axis][axis];
            assert!((ratio - 1.0).abs() < 1e-3, "{one:?} {other:?}");
        }
    }
}

#[test]
fn several_targets_keep_their_identities() {
    let options = TrackerOptions { targets: 2, ..TrackerOptions::default() };
    let mut tracker = Tracker::new(compiled(PLAIN), options.clone()).unwrap();
    let at = |number: u64| [[60.0 + 4.0 * number as f64, 90.0], [250.0 - 4.0 * number as f64, 150.0]];
    let mut first = None;
    for number in 0..24 {
        if number == 10 {
            // While one of them is hidden.
            let carried = tracker.swap(compiled(GAUSSIAN), options.clone());
            assert_eq!(carried.moving, ["0", "1"], "{carried:?}");
        }
        let is_hidden = (8..13).contains(&number);
        let positions = at(number);
        let estimates = tracker.track_all(&frame(number, if is_hidden { &positions[..1] } else { &positions }));
        let of = |estimate: &Estimate| (0..2).find(|&n| off(&tracker, estimate, positions[n]) < 3.0);
        let which = [of(&estimates[0]), of(&estimates[1])];
        assert!(which[0] != which[1] && which.iter().all(Option::is_some), "{number}: {estimates:?}");
        assert_eq!(*first.get_or_insert(which), which, "{number}: {estimates:?}");
        let states =
            which.map(|which| if is_hidden && which == Some(1) { TrackState::Coasting } else { TrackState::Tracking });
        assert_eq!([estimates[0].state, estimates[1].state], states, "{number}");
    }
}

#[test]
fn a_model_without_a_centre_resets_all_parameters() {
    let mut tracker = followed(&TrackerOptions::default(), 5);
    let curve = compiled(CURVE);
    let names: Vec<String> = curve.model().parameters().iter().map(|one| one.name.clone()).collect();
    let carried = tracker.swap(curve, TrackerOptions::default());
    assert!(carried.carried.is_empty() && carried.moving.is_empty(), "{carried:?}");
    assert_eq!(carried.reset, names);
    // And back: only the target's existence is known.
    let carried = tracker.swap(compiled(PLAIN), TrackerOptions::default());
    assert!(carried.carried.is_empty() && carried.moving.is_empty(), "{carried:?}");
    assert_eq!(tracker.track(&frame(5, &[])).state, TrackState::Lost);
    assert_eq!(tracker.track(&frame(6, &[path(6)])).state, TrackState::Tracking);
}

#[test]
fn a_target_never_found_carries_nothing_over() {
    let mut tracker = Tracker::new(compiled(PLAIN), TrackerOptions::default()).unwrap();
    let carried = tracker.swap(compiled(GAUSSIAN), TrackerOptions::default());
    assert!(carried.carried.is_empty() && carried.moving.is_empty(), "{carried:?}");
    assert_eq!(tracker.track(&frame(0, &[])).state, TrackState::Searching);
}

/// A target that was dropped by `lose` is searched for everywhere, and keeps its name.
#[test]
fn a_target_is_found_after_the_picture_jumps() {
    let mut tracker = Tracker::new(compiled(PLAIN), TrackerOptions::default()).unwrap();
    for number in 0..8 {
        assert_eq!(tracker.track(&frame(number, &[path(number)])).state, TrackState::Tracking, "{number}");
    }
    let elsewhere = frame(8, &[[250.0, 40.0]]);
    tracker.lose();
    let estimate = tracker.track(&elsewhere);
    assert_eq!((estimate.state, estimate.target.as_str()), (TrackState::Tracking, "0"));
    assert!(off(&tracker, &estimate, [250.0, 40.0]) < 0.5);
    // No prediction is left: without a target in the frame, nothing coasts.
    tracker.lose();
    let nothing = frame(9, &[]);
    assert_eq!(tracker.track(&nothing).state, TrackState::Lost);
}
