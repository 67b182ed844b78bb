//! Frames that are stopped early: the tracker stops promptly, reports the ending, and keeps its tracks.

#![allow(clippy::unwrap_used)]
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use super::*;
use crate::budget::Stop;
use crate::picture::{Falloff, Spot, TestPicture};
use isophote_symbolic::Precision;

const SPOT: &str = include_str!("../../../tests/documents/plain-spot.toml");

fn compiled() -> Arc<Compiled> {
    Arc::new(Compiled::new(Arc::new(Model::from_toml(SPOT).unwrap()), Precision::F32).unwrap())
}

fn tracker(compiled: &Arc<Compiled>, work_max: u64) -> Tracker {
    Tracker::new(compiled.clone(), TrackerOptions { work_max, ..TrackerOptions::default() }).unwrap()
}

/// The target moves 2 px a frame.
fn frame(number: u64) -> Frame {
    let profile = Falloff::Cubic(-0.5, -0.3);
    let centre = [60.3 + 2.0 * number as f64, 50.8];
    let spot = Spot { centre, half: [20.0, 14.0], angle: 0.4, amplitude: 150.0, profile };
    let mut frame = TestPicture { noise: 1.0, seed: number, ..TestPicture::new(160, 100, vec![spot]) }.frame();
    frame.sequence = number;
    frame
}

/// Fits a frame and stops it at the `asks`th call of the watch; returns the number of calls and the estimate.
fn stopped_at(tracker: &mut Tracker, frame: &Frame, asks: u64, stop: Stop) -> (u64, Estimate) {
    let asked = AtomicU64::new(0);
    let watch = || (asked.fetch_add(1, Ordering::Relaxed) + 1 >= asks).then_some(stop);
    let estimate = tracker.track_all_while(frame, &watch).swap_remove(0);
    (asked.load(Ordering::Relaxed), estimate)
}

fn is_honest(estimate: &Estimate, ending: Ending) -> bool {
    match estimate.state {
        TrackState::Tracking => {
            let is_best_so_far = ending == Ending::Budget && !estimate.converged && estimate.covariance.is_some();
            estimate.rejection.is_none() && (estimate.ending != ending || is_best_so_far)
        }
        _ => estimate.ending == ending && !estimate.converged,
    }
}

#[test]
fn a_cold_frame_can_be_cancelled_at_any_pass() {
    let compiled = compiled();
    let (all, whole) = stopped_at(&mut tracker(&compiled, u64::MAX), &frame(0), u64::MAX, Stop::Cancelled);
    assert!(all >= 8 && whole.converged, "{all}: {whole:?}");
    for asks in 1..=all {
        let mut tracker = tracker(&compiled, u64::MAX);
        let (asked, estimate) = stopped_at(&mut tracker, &frame(0), asks, Stop::Cancelled);
        assert_eq!(asked, asks, "asked again after the end");
        assert_eq!(estimate.state, TrackState::Searching, "{estimate:?}");
        assert!(is_honest(&estimate, Ending::Cancelled), "{asks} of {all}: {estimate:?}");
        // The next frame is found normally.
        assert!(tracker.track(&frame(1)).converged);
    }
}

#[test]
fn a_stopped_frame_leaves_the_track_warm() {
    let compiled = compiled();
    let followed = || {
        let mut tracker = tracker(&compiled, u64::MAX);
        (0..5).for_each(|number| assert!(tracker.track(&frame(number)).converged));
        tracker
    };
    let (warm, _) = stopped_at(&mut followed(), &frame(5), u64::MAX, Stop::Cancelled);
    for asks in 1..=warm {
        for stop in [Stop::Cancelled, Stop::Budget] {
            let mut tracker = followed();
            let started = Instant::now();
            let (_, left) = stopped_at(&mut tracker, &frame(5), asks, stop);
            eprintln!("left after {asks} of {warm} passes: {:?}", started.elapsed());
            assert!(is_honest(&left, stop.into()), "{left:?}");
            assert!(matches!(left.state, TrackState::Coasting | TrackState::Tracking), "{left:?}");
            // Warm: it makes no more passes than without the stop, far fewer than a search.
            let (asked, next) = stopped_at(&mut tracker, &frame(6), u64::MAX, stop);
            assert!(next.converged && asked <= warm + 3, "{asked} {warm} {next:?}");
        }
    }
}

/// A fit that is stopped in any stage returns the best parameters so far; a rejected one coasts.
#[test]
fn a_fit_out_of_budget_returns_the_best_so_far() {
    let document = format!("{SPOT}\n[[stages]]\nparameters = [\"bx\", \"by\"]\n[[stages]]\nparameters = {ALL}\n");
    for text in [SPOT, &document] {
        let model = Arc::new(Model::from_toml(text).unwrap());
        let compiled = Arc::new(Compiled::new(model, Precision::F32).unwrap());
        let mut followed = tracker(&compiled, u64::MAX);
        (0..3).for_each(|_| assert!(followed.track(&still(0.0)).converged));
        let (all, _) = stopped_at(&mut followed.fork(), &still(1.0), u64::MAX, Stop::Budget);
        let mut errors = Vec::new();
        for asks in 2..=all {
            let mut tracker = followed.fork();
            let (_, left) = stopped_at(&mut tracker, &still(1.0), asks, Stop::Budget);
            assert!(is_honest(&left, Ending::Budget), "{left:?}");
            if left.ending == Ending::Budget && left.state == TrackState::Tracking {
                assert!(left.iterations.iter().sum::<u32>() > 0 && left.reduced_chi_square.is_some(), "{left:?}");
                let (x, y) = (left.parameters[0] - 61.3, left.parameters[1] - 50.8);
                let covariance = left.covariance.as_ref().unwrap();
                assert!(x * x < 16.0 * covariance[0][0] && y * y < 16.0 * covariance[1][1], "{x} {y}: {left:?}");
                errors.push(x.hypot(y));
                let next = tracker.track(&still(1.0));
                assert!(next.converged && (next.parameters[0] - 61.3).abs() < 0.05, "{next:?}");
            }
        }
        eprintln!("px off, of the fits that were cut short, from 1 px: {errors:.4?}");
        assert!(!errors.is_empty() && errors.iter().all(|error| *error < 0.3), "{errors:?}");
    }
}

const ALL: &str = "[\"bx\", \"by\", \"a1\", \"a2\", \"a3\", \"v0\", \"v1\"]";

/// A still target, `right_px` to the right.
fn still(right_px: f64) -> Frame {
    let profile = Falloff::Cubic(-0.5, -0.3);
    let spot = Spot { centre: [60.3 + right_px, 50.8], half: [20.0, 14.0], angle: 0.4, amplitude: 150.0, profile };
    TestPicture { noise: 1.0, ..TestPicture::new(160, 100, vec![spot]) }.frame()
}

/// Postpones every search.
struct NoSearch;

impl Watch for NoSearch {
    fn stop(&self) -> Option<Stop> {
        None
    }
    fn search(&self) -> Option<Stop> {
        Some(Stop::Postponed)
    }
}

/// While searches are postponed, a target that moved farther than a fit reaches is found near its last position, one that is
/// not nearby is remembered, and one that was never found waits.
#[test]
fn a_postponed_search_keeps_the_target() {
    let wide = |x: f64, number: u64| {
        let profile = Falloff::Cubic(-0.5, -0.3);
        let spot = Spot { centre: [x, 120.0], half: [9.0, 7.0], angle: 0.4, amplitude: 150.0, profile };
        let mut frame = TestPicture { noise: 1.0, ..TestPicture::new(400, 240, vec![spot]) }.frame();
        frame.sequence = number;
        frame
    };
    let mut tracker = tracker(&compiled(), u64::MAX);
    let waiting = tracker.track_all_while(&wide(60.0, 0), &NoSearch).swap_remove(0);
    assert_eq!((waiting.state, waiting.ending), (TrackState::Searching, Ending::Postponed));
    assert!(tracker.track(&wide(60.0, 1)).converged);
    let near = tracker.track_all_while(&wide(85.0, 2), &NoSearch).swap_remove(0);
    assert_eq!((near.state, near.ending), (TrackState::Tracking, Ending::SmallStep), "{near:?}");
    assert!((near.parameters[0] - 85.0).abs() < 0.1, "{near:?}");
    let far = tracker.track_all_while(&wide(330.0, 3), &NoSearch).swap_remove(0);
    assert_eq!((far.state, far.ending), (TrackState::Lost, Ending::Postponed), "{far:?}");
    let found = tracker.track(&wide(330.0, 4));
    assert!(found.converged && (found.parameters[0] - 330.0).abs() < 0.1, "{found:?}");
}

#[test]
fn work_is_counted_and_bounded() {
    let compiled = compiled();
    let enough = (1..40).map(|power| 1u64 << power).find(|work| tracker(&compiled, *work).track(&frame(0)).converged);
    let (mut low, mut high) = (enough.unwrap() / 2, enough.unwrap());
    while high - low > 1 {
        let work = low.midpoint(high);
        let is_enough = tracker(&compiled, work).track(&frame(0)).converged;
        if is_enough { high = work } else { low = work }
    }
    eprintln!("a cold spot of 160 × 100 px costs {high} units");
    for (work, ending) in [(high - 1, Ending::Budget), (high, Ending::SmallStep), (high + 1, Ending::SmallStep)] {
        let estimate = tracker(&compiled, work).track(&frame(0));
        assert_eq!(estimate.ending, ending, "{work}: {estimate:?}");
        assert!(is_honest(&estimate, Ending::Budget));
    }
}

/// Crossing bars fit badly, in many passes of many pixels each; this does not reduce the target's budget.
#[test]
fn large_objects_leave_enough_budget_for_the_target() {
    let spot = |centre: [f64; 2], half: [f64; 2], angle: f64, amplitude: f64, profile: Falloff| Spot {
        centre,
        half,
        angle,
        amplitude,
        profile,
    };
    let target = [201.7, 368.6];
    let spots = vec![
        spot([179.9, 110.8], [120.1, 21.5], 0.819, 111.0, Falloff::Disc),
        spot([278.4, 132.3], [152.9, 16.8], 2.421, 109.0, Falloff::Disc),
        spot([267.6, 424.8], [17.2, 29.5], 2.285, 80.0, Falloff::Disc),
        spot(target, [20.0, 14.0], 1.79, 180.0, Falloff::Cubic(-0.5, -0.3)),
    ];
    let frame = TestPicture { noise: 1.5, ..TestPicture::new(640, 480, spots) }.frame();
    let model = Model::from_toml(include_str!("../../../models/spot.toml")).unwrap();
    let compiled = Arc::new(Compiled::new(Arc::new(model), Precision::F32).unwrap());
    let found = tracker(&compiled, u64::MAX).track(&frame);
    assert_eq!(found.state, TrackState::Tracking, "{found:?}");
    let off = (found.parameters[0] - target[0]).hypot(found.parameters[1] - target[1]);
    assert!(off < 0.2, "{found:?}");
}
