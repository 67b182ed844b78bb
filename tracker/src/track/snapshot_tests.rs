//! Trackers restored from a snapshot give the same estimates as the original, bit for bit.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use isophote_symbolic::{Model, Precision};

use crate::picture::{Falloff, Spot, TestPicture};
use crate::{
    Camera, Compiled, Estimate, ExposureGoal, Frame, FrameReadiness, PredictOptions, Preparing, Snapshot,
    SnapshotError, Stop, TrackState, Tracker, TrackerOptions,
};

const SPOT: &str = include_str!("../../../models/spot.toml");
const GAUSSIAN: &str = include_str!("../../../models/gaussian.toml");
const FRAMES: u64 = 24;

fn compiled(document: &str) -> Arc<Compiled> {
    let model = Model::from_toml(document).unwrap_or_else(|d| panic!("{}", d[0].render("test")));
    Arc::new(Compiled::new(Arc::new(model), Precision::F32).unwrap())
}

/// A target that moves, is half hidden in frames 9 to 11, and is elsewhere from frame 20 on; 14 and 15 show nothing.
fn frame(number: u64) -> Frame {
    let t = number as f64;
    let far = if number < 20 { 0.0 } else { 60.0 };
    let centre = [60.0 + 3.0 * t + far, 70.0 + 8.0 * (0.4 * t).sin()];
    let spot = |centre: [f64; 2], amplitude: f64| Spot {
        centre,
        half: [14.0, 11.0],
        angle: 0.3,
        amplitude,
        profile: Falloff::Cubic(-0.5, -0.3),
    };
    let mut spots = Vec::new();
    if (9..12).contains(&number) {
        spots.push(Spot { half: [9.0, 9.0], profile: Falloff::Disc, ..spot([centre[0] + 8.0, centre[1]], 120.0) });
    }
    if !(14..16).contains(&number) {
        spots.extend([spot([200.0, 30.0], 90.0), spot(centre, 120.0)]);
    }
    TestPicture { noise: 1.5, seed: number + 1, ..TestPicture::new(240, 140, spots) }.frame().with_sequence(number)
}

fn options() -> TrackerOptions {
    TrackerOptions {
        exposure: Some(ExposureGoal::Centre),
        camera: Camera { saturation: Some(250.0), ..Camera::default() },
        predict: Some(PredictOptions { horizon_s: 0.1, steps: 2 }),
        ..TrackerOptions::default()
    }
}

fn through_json(snapshot: &Snapshot) -> Snapshot {
    let text = serde_json::to_string(snapshot).unwrap();
    let read: Snapshot = serde_json::from_str(&text).unwrap();
    assert_eq!(serde_json::to_string(&read).unwrap(), text, "it comes back as it was");
    read
}

/// Every number of an estimate, to its last bit.
fn formatted(estimates: &[Estimate]) -> String {
    format!("{estimates:?}")
}

#[test]
fn a_restored_tracker_gives_the_same_estimates() {
    for (document, targets) in [(SPOT, 1), (SPOT, 2)] {
        let compiled = compiled(document);
        let options = TrackerOptions { targets, ..options() };
        let new = || Tracker::new(compiled.clone(), options.clone()).unwrap();
        let mut tracker = new();
        let (mut others, mut states) = (Vec::new(), Vec::new());
        for number in 0..FRAMES {
            let frame = frame(number);
            let estimates = tracker.track_all(&frame);
            for (first_frame, other) in &mut others {
                let other: &mut Tracker = other;
                assert_eq!(
                    formatted(&other.track_all(&frame)),
                    formatted(&estimates),
                    "{number}, from {first_frame} on"
                );
            }
            states.extend(estimates.iter().map(|estimate| estimate.state));
            if number % 4 == 1 || (13..16).contains(&number) {
                let mut other = new();
                other.restore(through_json(&tracker.snapshot())).unwrap();
                others.push((number + 1, other));
            }
        }
        assert!(states.contains(&TrackState::Tracking) && states.contains(&TrackState::Coasting), "{states:?}");
    }
}

/// A trial on a fork costs the same as the frame itself: nothing known is computed again.
#[test]
fn a_fork_has_the_state_of_its_tracker() {
    let mut tracker = Tracker::new(compiled(SPOT), options()).unwrap();
    assert!((0..3).all(|number| tracker.track(&frame(number)).exposure_advice.is_some()));
    let [own, of_fork] = [&tracker, &tracker.fork()].map(|one| serde_json::to_value(one.snapshot()).unwrap());
    assert_eq!(of_fork, own);
}

/// Corrections for a target at rest are reused in later frames; a restored tracker makes the same.
#[test]
fn corrections_are_reused_and_restored() {
    let compiled = compiled(SPOT);
    let new = || Tracker::new(compiled.clone(), options()).unwrap();
    let mut tracker = new();
    let frame = |number: u64| {
        let t = number as f64;
        let spot = Spot {
            centre: [90.0 + 0.01 * t, 70.0],
            half: [40.0, 31.0],
            angle: 0.3,
            amplitude: 120.0,
            profile: Falloff::Cubic(-0.5, -0.3),
        };
        TestPicture { noise: 1.5, seed: number + 1, ..TestPicture::new(180, 140, vec![spot]) }
            .frame()
            .with_sequence(number)
    };
    let made_for = |snapshot: &Snapshot| {
        let value = serde_json::to_value(snapshot).unwrap();
        value["targets"][0]["chosen"]["corrections"]["at"].as_array().unwrap().clone()
    };
    (0..6).for_each(|number| drop(tracker.track(&frame(number))));
    let before = tracker.snapshot();
    let mut other = new();
    other.restore(through_json(&before)).unwrap();
    for number in 6..12 {
        let frame = frame(number);
        let asked = [AtomicU64::new(0), AtomicU64::new(0)];
        let count = |which: usize| {
            asked[which].fetch_add(1, Ordering::Relaxed);
            None::<Stop>
        };
        let estimates = tracker.track_all_while(&frame, &|| count(0));
        assert_eq!(formatted(&other.track_all_while(&frame, &|| count(1))), formatted(&estimates), "{number}");
        assert_eq!(asked[0].load(Ordering::Relaxed), asked[1].load(Ordering::Relaxed), "{number}");
    }
    assert_eq!(made_for(&tracker.snapshot()), made_for(&before));
}

/// A frame that its budget ended, or that was fitted without alternatives, is replayed by the number of polls and the
/// readiness.
#[test]
fn frames_are_replayed_with_their_readiness() {
    let options = TrackerOptions { preparing: Preparing::Beside, ..options() };
    let (first, second) = (compiled(SPOT), compiled(SPOT));
    let mut tracker = Tracker::new(first, options.clone()).unwrap();
    let mut again = Tracker::new(second, options).unwrap();
    let (mut readiness, mut endings) = (Vec::new(), Vec::new());
    for number in 0..FRAMES {
        let frame = frame(number);
        let last = if number % 5 == 3 { 4 } else { u64::MAX };
        let asked = [AtomicU64::new(0), AtomicU64::new(0)];
        let ended = |which: usize| (asked[which].fetch_add(1, Ordering::Relaxed) >= last).then_some(Stop::Budget);
        let estimates = tracker.track_all_while(&frame, &|| ended(0));
        readiness.push(tracker.readiness());
        assert_eq!(
            formatted(&again.track_all_again(&frame, tracker.readiness(), &|| ended(1))),
            formatted(&estimates),
            "{number}"
        );
        assert_eq!(asked[0].load(Ordering::Relaxed), asked[1].load(Ordering::Relaxed), "{number}");
        endings.extend(estimates.iter().map(|estimate| estimate.ending));
        if let Some(preparation) = tracker.wanted().filter(|_| number > 8) {
            preparation.run(&|| true).unwrap();
        }
    }
    let had = |is_so: fn(&FrameReadiness) -> bool| readiness.iter().any(is_so);
    assert!(
        had(|ready| ready.alternatives.is_none()) && had(|ready| ready.alternatives == Some(false)),
        "{readiness:?}"
    );
    assert!(had(|ready| ready.sampling == Some(false)) && had(|ready| ready.sampling == Some(true)), "{readiness:?}");
    assert!(endings.iter().any(|ending| ending.is_unfinished()), "{endings:?}");
}

#[test]
fn unsuited_snapshots_are_rejected() {
    let mut tracker = Tracker::new(compiled(SPOT), options()).unwrap();
    tracker.track(&frame(0));
    let snapshot = tracker.snapshot();
    let mut value = serde_json::to_value(&snapshot).unwrap();
    let mut refused =
        |value: &serde_json::Value| tracker.restore(serde_json::from_value(value.clone()).unwrap()).unwrap_err();
    value["version"] = 1.into();
    assert_eq!(refused(&value), SnapshotError::Version { found: 1 });
    let mut short = serde_json::to_value(&snapshot).unwrap();
    short["targets"][0]["last"].as_array_mut().unwrap().pop();
    assert!(matches!(refused(&short), SnapshotError::Unsuited(_)));
    let mut short = serde_json::to_value(&snapshot).unwrap();
    short["targets"][0]["chosen"]["corrections"]["at"].as_array_mut().unwrap().pop();
    assert!(matches!(refused(&short), SnapshotError::Unsuited(_)));
    short["targets"] = serde_json::json!([]);
    assert!(matches!(refused(&short), SnapshotError::Unsuited(_)));
    let mut other = Tracker::new(compiled(GAUSSIAN), options()).unwrap();
    assert!(matches!(other.restore(snapshot).unwrap_err(), SnapshotError::Model { .. }));
}
