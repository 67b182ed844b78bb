//! Tracks over time: blackouts, several targets, distractors.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use isophote_jit::PixelFormat;
use isophote_symbolic::{Model, Precision};

use crate::picture::{Falloff, Spot, TestPicture};
use crate::{Compiled, Estimate, Frame, MotionOptions, Plane, TrackState, Tracker, TrackerOptions};

const SPOT: &str = include_str!("../../../tests/documents/plain-spot.toml");

fn tracker(options: TrackerOptions) -> Tracker {
    let model = Model::from_toml(SPOT).unwrap_or_else(|d| panic!("{}", d[0].render("test")));
    Tracker::new(Arc::new(Compiled::new(Arc::new(model), Precision::F32).unwrap()), options).unwrap()
}

fn spot([x, y]: [f64; 2], half: [f64; 2], amplitude: f64) -> Spot {
    Spot { centre: [x, y], half, angle: 0.3, amplitude, profile: Falloff::Cubic(-0.5, -0.3) }
}

fn frame(number: u64, spots: Vec<Spot>) -> Frame {
    TestPicture { noise: 1.5, seed: number, ..TestPicture::new(320, 240, spots) }.frame().with_sequence(number)
}

fn off(estimate: &Estimate, centre: [f64; 2]) -> f64 {
    (estimate.parameters[0] - centre[0]).hypot(estimate.parameters[1] - centre[1])
}

/// A swinging target at 60 Hz.
fn swing(number: u64) -> [f64; 2] {
    let t = number as f64 / 60.0;
    [160.0 + 70.0 * (2.5 * t).sin(), 120.0 + 40.0 * (1.7 * t).cos()]
}

#[test]
fn a_target_is_found_within_three_frames_after_a_blackout_of_two_seconds() {
    let mut tracker = tracker(TrackerOptions::default());
    let mut states = Vec::new();
    for number in 0..190 {
        let dark = (30..150).contains(&number);
        let spots = if dark { vec![] } else { vec![spot(swing(number), [16.0, 12.0], 120.0)] };
        let estimate = tracker.track(&frame(number, spots));
        if estimate.state == TrackState::Tracking {
            assert!(off(&estimate, swing(number)) < 0.2, "frame {number}: {estimate:?}");
        }
        states.push(estimate.state);
    }
    let count = |state: TrackState, from: usize, to: usize| states[from..to].iter().filter(|s| **s == state).count();
    assert_eq!(count(TrackState::Tracking, 0, 30), 30);
    assert_eq!(count(TrackState::Coasting, 30, 60), 30, "half a second: {states:?}");
    assert_eq!(count(TrackState::Lost, 60, 150), 90, "{states:?}");
    assert!(count(TrackState::Tracking, 150, 153) >= 1 && count(TrackState::Tracking, 153, 190) == 37, "{states:?}");
}

#[test]
fn coasting_follows_the_motion_with_growing_covariance() {
    let mut tracker = tracker(TrackerOptions::default());
    let path = |number: u64| [60.0 + 2.0 * number as f64, 200.0 - 1.0 * number as f64];
    let mut before = 0.0;
    for number in 0..40 {
        let hidden = number >= 25;
        let spots = if hidden { vec![] } else { vec![spot(path(number), [16.0, 12.0], 120.0)] };
        let estimate = tracker.track(&frame(number, spots));
        if hidden {
            assert_eq!(estimate.state, TrackState::Coasting, "{estimate:?}");
            let deviation = estimate.covariance.as_ref().unwrap()[0][0].sqrt();
            assert!(off(&estimate, path(number)) < 4.0 * deviation && deviation > before, "{number} {estimate:?}");
            assert!(estimate.log_likelihood.is_none() && estimate.confidence.is_none() && !estimate.converged);
            before = deviation;
        }
    }
    let estimate = tracker.track(&frame(40, vec![spot(path(40), [16.0, 12.0], 120.0)]));
    assert!(estimate.state == TrackState::Tracking && off(&estimate, path(40)) < 0.1, "{estimate:?}");
}

#[test]
fn predictions_match_the_future_path() {
    let predict = Some(crate::PredictOptions { horizon_s: 0.5, steps: 10 });
    let mut tracker = tracker(TrackerOptions { predict, ..TrackerOptions::default() });
    let path = |number: f64| [60.0 + 2.0 * number, 200.0 - 1.0 * number];
    let mut last = None;
    for number in 0..30 {
        let estimate = tracker.track(&frame(number, vec![spot(path(number as f64), [16.0, 12.0], 120.0)]));
        assert_eq!(estimate.ahead.len(), 10, "{estimate:?}");
        last = Some(estimate);
    }
    let mut before = 0.0;
    for (step, ahead) in last.unwrap().ahead.iter().enumerate() {
        assert!((ahead.after_s - 0.05 * (step + 1) as f64).abs() < 1e-12);
        let [x, y] = path(29.0 + 60.0 * ahead.after_s);
        let deviation = ahead.covariance[0][0].sqrt();
        assert!((ahead.centre[0] - x).hypot(ahead.centre[1] - y) < 4.0 * deviation, "{ahead:?}");
        assert!((ahead.velocity[0] - 120.0).abs() < 10.0 && (ahead.velocity[1] + 60.0).abs() < 10.0, "{ahead:?}");
        assert!(deviation > before && ahead.covariance.len() == 4);
        before = deviation;
    }
    let blank =
        tracker.track(&TestPicture { noise: 1.5, ..TestPicture::new(320, 240, vec![]) }.frame().with_sequence(30));
    assert!(blank.state == TrackState::Coasting && blank.ahead.len() == 10, "{blank:?}");
}

#[test]
fn a_distractor_is_not_taken_while_the_target_is_hidden() {
    let options = TrackerOptions { motion: MotionOptions { coast_s: 0.2, ..Default::default() }, ..Default::default() };
    let mut tracker = tracker(options);
    for number in 0..40 {
        let hidden = (20..30).contains(&number);
        let target = spot([80.0 + 0.5 * number as f64, 120.0], [16.0, 12.0], 120.0);
        let other = spot([250.0, 60.0], [6.0, 5.0], 200.0);
        let estimate = tracker.track(&frame(number, if hidden { vec![other] } else { vec![target, other] }));
        let state = if hidden { TrackState::Coasting } else { TrackState::Tracking };
        assert_eq!(estimate.state, state, "frame {number}: {estimate:?}");
        assert!(off(&estimate, target.centre) < 3.0, "frame {number}: {estimate:?}");
    }
}

#[test]
fn several_targets_keep_their_names_when_they_pass_and_hide() {
    let mut tracker = tracker(TrackerOptions { targets: 3, ..TrackerOptions::default() });
    let at = |number: u64| {
        let t = number as f64;
        [[40.0 + 2.0 * t, 70.0 + 0.3 * t], [280.0 - 2.0 * t, 120.0 - 0.1 * t], [160.0, 190.0 - 0.4 * t]]
    };
    let mut names: Vec<Option<usize>> = vec![None; 3];
    for number in 0..100 {
        let mut spots: Vec<Spot> = at(number).iter().map(|centre| spot(*centre, [12.0, 9.0], 110.0)).collect();
        if (40..46).contains(&number) {
            spots.remove(2);
        }
        let estimates = tracker.track_all(&frame(number, spots));
        assert_eq!(estimates.iter().map(|one| one.target.as_str()).collect::<Vec<_>>(), ["0", "1", "2"]);
        for (name, estimate) in estimates.iter().enumerate() {
            let nearest = (0..3).find(|&k| off(estimate, at(number)[k]) < 3.0);
            let nearest = nearest.unwrap_or_else(|| panic!("frame {number}: {estimate:?}"));
            assert_eq!(*names[name].get_or_insert(nearest), nearest, "frame {number}: {estimate:?}");
            let hidden = nearest == 2 && (40..46).contains(&number);
            let state = if hidden { TrackState::Coasting } else { TrackState::Tracking };
            assert_eq!(estimate.state, state, "frame {number}: {estimate:?}");
        }
        assert!((0..3).all(|k| names.contains(&Some(k))), "each has one: {names:?}");
    }
}

#[test]
fn an_absent_target_keeps_searching_and_takes_no_other() {
    let mut tracker = tracker(TrackerOptions { targets: 2, ..TrackerOptions::default() });
    let (first, second) = (spot([90.0, 100.0], [16.0, 12.0], 120.0), spot([220.0, 140.0], [14.0, 12.0], 100.0));
    for number in 0..10 {
        let spots = if number < 5 { vec![first] } else { vec![first, second] };
        let estimates = tracker.track_all(&frame(number, spots));
        assert!(estimates[0].state == TrackState::Tracking && off(&estimates[0], first.centre) < 0.1);
        let state = if number < 5 { TrackState::Searching } else { TrackState::Tracking };
        assert_eq!(estimates[1].state, state, "frame {number}: {:?}", estimates[1]);
    }
}

#[test]
fn a_faint_target_is_distinguished_from_bright_objects_of_other_shapes() {
    let disc = |x: f64, y: f64, half: [f64; 2]| Spot { profile: Falloff::Disc, ..spot([x, y], half, 200.0) };
    let clutter = vec![disc(50.0, 50.0, [18.0, 14.0]), disc(260.0, 60.0, [30.0, 4.0]), disc(60.0, 190.0, [3.0, 3.0])];
    for (number, amplitude) in [150.0, 60.0, 25.0].into_iter().enumerate() {
        let target = spot([190.0, 150.0], [20.0, 14.0], amplitude);
        let spots = [clutter.clone(), vec![target]].concat();
        let estimate = tracker(TrackerOptions::default()).track(&frame(number as u64, spots));
        assert!(estimate.state == TrackState::Tracking && off(&estimate, target.centre) < 0.5, "{estimate:?}");
    }
}

#[test]
fn the_expected_one_of_two_similar_targets_is_taken() {
    let (small, large) = (spot([80.0, 100.0], [9.0, 7.0], 120.0), spot([220.0, 140.0], [24.0, 18.0], 120.0));
    let extent = |spot: &Spot| {
        let [a1, a2, a3] = spot.extent();
        [("a1".to_string(), a1), ("a2".to_string(), a2), ("a3".to_string(), a3)].into()
    };
    for wanted in [small, large] {
        let options = TrackerOptions { start: extent(&wanted), ..TrackerOptions::default() };
        let estimate = tracker(options).track(&frame(1, vec![small, large]));
        assert!(off(&estimate, wanted.centre) < 0.2, "{estimate:?}");
    }
}

#[test]
fn a_small_target_is_found_near_its_given_position() {
    let (target, other) = (spot([80.3, 100.4], [3.0, 2.2], 120.0), spot([220.0, 140.0], [3.0, 2.2], 150.0));
    let [a1, a2, a3] = target.extent();
    let shape = [("a1", a1), ("a2", a2), ("a3", a3), ("v0", 20.0), ("v1", 100.0)];
    for (dx, dy) in [(0.5, 0.5), (4.5, 1.0), (-3.0, 5.0), (1.0, -7.0)] {
        let position = [("bx", target.centre[0] + dx), ("by", target.centre[1] + dy)];
        let start = shape.into_iter().chain(position).map(|(name, value)| (name.to_string(), value)).collect();
        let estimate =
            tracker(TrackerOptions { start, ..TrackerOptions::default() }).track(&frame(1, vec![target, other]));
        assert!(
            estimate.state == TrackState::Tracking && off(&estimate, target.centre) < 0.2,
            "{dx}, {dy}: {estimate:?}"
        );
    }
}

#[test]
fn two_targets_in_a_small_frame_are_no_rivals() {
    let two = vec![spot([25.0, 30.0], [8.0, 8.0], 150.0), spot([65.0, 34.0], [8.0, 8.0], 130.0)];
    let picture = TestPicture { noise: 0.0, ..TestPicture::new(96, 64, two) };
    let estimates = tracker(TrackerOptions { targets: 2, ..TrackerOptions::default() }).track_all(&picture.frame());
    assert!(estimates.iter().all(|estimate| estimate.state == TrackState::Tracking), "{estimates:?}");
}

#[test]
fn an_object_of_another_shape_is_not_taken_beside_the_target() {
    let bar = Spot { profile: Falloff::Disc, ..spot([150.0, 100.0], [50.0, 5.0], 150.0) };
    let sure = TrackerOptions { confidence_min: 0.7, ..TrackerOptions::default() };
    let estimate = tracker(sure.clone()).track(&frame(1, vec![bar]));
    let confidence = estimate.confidence.unwrap();
    assert!(estimate.state == TrackState::Tracking && confidence < 0.1, "a lone thing, no target: {estimate:?}");
    let target = spot([150.0, 180.0], [20.0, 14.0], 120.0);
    let estimate = tracker(sure).track(&frame(1, vec![bar, target]));
    assert!(estimate.state == TrackState::Tracking && off(&estimate, target.centre) < 0.2, "{estimate:?}");
    assert!(estimate.confidence.unwrap() > 0.9, "{estimate:?}");
}

#[test]
fn a_tracked_target_is_fitted_in_a_window_of_its_own() {
    let target = spot([160.0, 120.0], [16.0, 12.0], 120.0);
    let mut tracker = tracker(TrackerOptions::default());
    let whole = tracker.track(&frame(0, vec![target]));
    let solver = &tracker.solver;
    let frame = frame(1, vec![target]);
    let context = solver.context(&frame).unwrap();
    let window = solver.window(&context, &whole.parameters, super::window::Margin::even(0.1, 3.0));
    assert!(window.width < 70 && window.height < 60, "{window:?}");
    let followed = tracker.track(&frame);
    let domain = 2.2 * std::f64::consts::PI * 16.0 * 12.0;
    assert!((followed.pixels as f64 / domain - 1.0).abs() < 0.01, "{followed:?}");
}

#[test]
fn lost_and_found_again() {
    let motion = MotionOptions { coast_s: 1.5 / 60.0, ..Default::default() };
    let options = TrackerOptions { motion, ..TrackerOptions::default() };
    let mut tracker = tracker(options);
    let frame = |x: f64, amplitude: f64, sequence: u64| {
        let spots = if amplitude > 0.0 { vec![spot([x, 60.0], [16.0, 12.0], amplitude)] } else { vec![] };
        TestPicture { noise: 2.0, seed: sequence, ..TestPicture::new(160, 120, spots) }.frame().with_sequence(sequence)
    };
    use TrackState::{Coasting, Lost, Searching, Tracking};
    let script = [
        (0.0, 0.0, Searching),
        (50.0, 120.0, Tracking),
        (53.0, 120.0, Tracking),
        (56.0, 20.0, Tracking), // fainter
        (59.0, 0.0, Coasting),
        (62.0, 0.0, Lost),
        (110.0, 120.0, Tracking), // elsewhere
        (40.0, 120.0, Tracking),  // a jump: the warm fit fails, a cold one finds it
        (43.0, 600.0, Tracking),  // overexposed
        (46.0, 120.0, Tracking),
    ];
    for (sequence, (x, amplitude, state)) in script.into_iter().enumerate() {
        let estimate = tracker.track(&frame(x, amplitude, sequence as u64));
        assert_eq!(estimate.state, state, "frame {sequence}: {estimate:?}");
        assert_eq!(estimate.sequence, sequence as u64);
        if state == Tracking {
            let bx = estimate.parameters[0];
            assert!((bx - x).abs() < 0.5, "frame {sequence}: {bx}");
            assert_eq!(estimate.saturated > 0.0, amplitude > 240.0);
        }
        if state == Lost {
            assert!((estimate.parameters[0] - 56.0).abs() < 0.5, "the last good one: {estimate:?}");
            assert!(estimate.objective.is_none() && !estimate.converged);
        }
        if state == Coasting {
            assert!((estimate.parameters[0] - 59.0).abs() < 0.5, "predicted: {estimate:?}");
            assert!(estimate.objective.is_none() && estimate.covariance.is_some() && !estimate.converged);
        }
    }
}

/// Pixels of the same light in other units, as floats.
fn in_units(frame: &Frame, unit: f32) -> Frame {
    let at = |pixel: usize| frame.plane_view(0).pixel_at([pixel % frame.width(), pixel / frame.width(), 0, 0]) as f32;
    let values = (0..frame.width() * frame.rows()).map(|pixel| at(pixel) / unit);
    let plane = Plane::owned(PixelFormat::F32, values.flat_map(f32::to_ne_bytes).collect(), frame.width());
    Frame::new(frame.size(), vec![plane]).unwrap().with_sequence(frame.sequence)
}

#[test]
fn a_frame_of_floats_divided_by_255_gives_the_same_answer_divided_by_255() {
    let (mut whole, mut share) = (tracker(TrackerOptions::default()), tracker(TrackerOptions::default()));
    for number in 0..20 {
        let frame = frame(number, vec![spot(swing(number), [16.0, 12.0], 120.0)]);
        let whole = whole.track(&in_units(&frame, 1.0));
        let share = share.track(&in_units(&frame, 255.0));
        assert_eq!([whole.state, share.state], [TrackState::Tracking; 2], "frame {number}: {whole:?} {share:?}");
        let covariance = whole.covariance.as_ref().unwrap();
        for (row, id) in whole.order.iter().enumerate() {
            let unit = if row < 5 { 1.0 } else { 255.0 };
            let [one, other] = [&whole, &share].map(|estimate| estimate.parameters[id.index()]);
            let off = (one - unit * other) / covariance[row][row].sqrt();
            assert!(off.abs() < 0.05, "frame {number}, parameter {row}: {off} standard deviations");
        }
    }
}
