//! Shaken targets: every frame shifts them by up to a pixel.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use isophote_symbolic::{Model, Precision};

use super::TrackingFit;
use crate::picture::{Falloff, Noise, Spot, TestPicture};
use crate::{Ahead, Compiled, PredictOptions, TrackState, Tracker, TrackerOptions};

/// Statistics of a sequence.
#[derive(Debug, Default)]
struct Tally {
    tracking: usize,
    /// Frames in which the fit around the prediction was not accepted.
    searched: usize,
    /// Frames tracked more than a pixel off.
    wrong: usize,
    /// The largest error of a tracked frame, px.
    worst_px: f64,
    /// Mean squared error over the variance, of each coordinate, for predictions 0.1 s and 0.5 s ahead.
    nees: [[f64; 2]; 2],
}

/// Follows a spot along a path with jitter of up to `jitter_px`.
fn shaken(document: &str, half: [f64; 2], jitter_px: f64, frames: u64, path: &dyn Fn(f64) -> [f64; 2]) -> Tally {
    let model = Model::from_toml(document).unwrap_or_else(|d| panic!("{}", d[0].render("test")));
    let compiled = Arc::new(Compiled::new(Arc::new(model), Precision::F32).unwrap());
    let predict = Some(PredictOptions { horizon_s: 0.5, steps: 5 });
    let mut tracker = Tracker::new(compiled, TrackerOptions { predict, ..TrackerOptions::default() }).unwrap();
    let (mut centres, mut predictions) = (Vec::new(), Vec::new());
    let mut noise = Noise(0xC0FFEE);
    let mut tally = Tally::default();
    for number in 0..frames {
        let [x, y] = path(number as f64 / 60.0);
        let centre = [x, y].map(|at| at + jitter_px * (2.0 * noise.uniform() - 1.0));
        let spot = Spot { centre, half, angle: 0.3, amplitude: 120.0, profile: Falloff::Cubic(-0.5, -0.3) };
        let picture = TestPicture { noise: 1.5, seed: number + 1, ..TestPicture::new(280, 140, vec![spot]) };
        let frame = picture.frame().with_sequence(number);
        centres.push(centre);
        if number > 0 {
            let context = tracker.solver.context(&frame).unwrap();
            let followed = tracker.tracks[0].follow(&tracker.solver, &context, number as f64 / 60.0).unwrap();
            tally.searched += usize::from(matches!(followed, TrackingFit::Uncertain(_)));
        }
        let estimate = tracker.track(&frame);
        if estimate.state == TrackState::Tracking {
            let off = (estimate.parameters[0] - centre[0]).hypot(estimate.parameters[1] - centre[1]);
            tally.tracking += 1;
            tally.wrong += usize::from(off > 1.0);
            tally.worst_px = tally.worst_px.max(off);
        }
        predictions.push(estimate.ahead);
    }
    for (row, (frames, step)) in [(6, 0), (30, 4)].into_iter().enumerate() {
        // The filters learn in the first 40 frames.
        let pairs: Vec<_> = predictions.iter().zip(&centres[frames..]).skip(40).collect();
        for axis in 0..2 {
            let one = |ahead: &Ahead, truth: &[f64; 2]| {
                (ahead.centre[axis] - truth[axis]).powi(2) / ahead.covariance[axis][axis]
            };
            let sum: f64 = pairs.iter().map(|(ahead, truth)| one(&ahead[step], truth)).sum();
            tally.nees[row][axis] = sum / pairs.len() as f64;
        }
    }
    tally
}

const PLAIN: &str = include_str!("../../../tests/documents/plain-spot.toml");
const SPOT: &str = include_str!("../../../models/spot.toml");

#[test]
fn a_shaken_target_is_followed_without_searching() {
    let still = |_: f64| [150.3, 70.6];
    let swing = |t: f64| [140.0 + 80.0 * (std::f64::consts::TAU * 0.2 * t).sin(), 70.6];
    for (document, half, path) in [
        (PLAIN, [5.0, 4.0], &still as &dyn Fn(f64) -> [f64; 2]),
        (SPOT, [5.0, 4.0], &still),
        (SPOT, [5.0, 4.0], &swing),
        (SPOT, [20.0, 14.0], &swing),
    ] {
        let tally = shaken(document, half, 1.0, 120, path);
        eprintln!("{half:?}: {tally:?}");
        assert!(tally.tracking == 120 && tally.wrong == 0 && tally.worst_px < 0.2, "{half:?}: {tally:?}");
        assert!(tally.searched <= 4, "{half:?}: {tally:?}");
    }
}

/// From pixels to predictions: the filters use the covariance of the fits.
#[test]
fn predictions_from_pixels_are_consistent() {
    type Path<'a> = (&'a str, f64, &'a dyn Fn(f64) -> [f64; 2]);
    let paths: [Path; 4] = [
        ("shaken", 1.0, &|_| [150.3, 70.6]),
        ("steady", 0.0, &|t| [20.0 + 50.0 * t, 40.0 + 15.0 * t]),
        ("swinging", 0.0, &|t| [140.0 + 80.0 * (std::f64::consts::TAU * 0.2 * t).sin(), 70.6]),
        ("accelerated", 0.0, &|t| [20.0 + 14.0 * t * t, 30.0 + 4.0 * t * t]),
    ];
    let mut sums = [[0.0; 2]; 2];
    for (name, jitter, path) in paths {
        let Tally { nees, wrong, searched, .. } = shaken(SPOT, [8.0, 6.0], jitter, 240, path);
        eprintln!("{name}: NEES {nees:.2?}, searched {searched}");
        assert!(wrong == 0 && searched <= 4, "{name}: {wrong} {searched}");
        for (sum, one) in sums.iter_mut().flatten().zip(nees.iter().flatten()) {
            *sum += one / 4.0;
        }
    }
    assert!(sums.iter().flatten().all(|nees| (0.5..=2.0).contains(nees)), "{sums:?}");
}

/// A wrong prediction, as after a step, costs a second fit from the last estimate, but no search.
#[test]
fn a_wrong_prediction_needs_no_search() {
    let model = Model::from_toml(SPOT).unwrap_or_else(|d| panic!("{}", d[0].render("test")));
    let compiled = Arc::new(Compiled::new(Arc::new(model), Precision::F32).unwrap());
    let mut tracker = Tracker::new(compiled, TrackerOptions::default()).unwrap();
    // 15 px per frame, then still.
    let at = |number: u64| [40.0 + 15.0 * number.min(10) as f64, 110.6];
    let mut searched = 0;
    for number in 0..16 {
        let (centre, half) = (at(number), [6.0, 5.0]);
        let spot = Spot { centre, half, angle: 0.3, amplitude: 120.0, profile: Falloff::Cubic(-0.5, -0.3) };
        let picture = TestPicture { noise: 1.5, seed: number + 1, ..TestPicture::new(320, 240, vec![spot]) };
        let frame = picture.frame().with_sequence(number);
        if number > 10 {
            let context = tracker.solver.context(&frame).unwrap();
            let attempt = tracker.tracks[0].follow(&tracker.solver, &context, number as f64 / 60.0).unwrap();
            let candidate = match attempt {
                TrackingFit::Accepted(candidate) => candidate,
                TrackingFit::Uncertain(candidate) => {
                    searched += 1;
                    candidate.unwrap()
                }
            };
            let fit = candidate.attempt.fit.unwrap();
            assert!((fit.parameters[0] - centre[0]).abs() < 0.2, "{number}: {fit:?}");
        }
        let estimate = tracker.track(&frame);
        assert_eq!(estimate.state, TrackState::Tracking, "{number}");
        assert!((estimate.parameters[0] - centre[0]).abs() < 0.2, "{number}: {estimate:?}");
    }
    assert!(searched <= 1, "{searched}");
}

/// A robust fit around the prediction would take a part of the target for the target, and the rest for background.
#[test]
fn a_target_that_jumps_by_its_radius_is_followed() {
    type Path<'a> = &'a dyn Fn(f64) -> [f64; 2];
    let jump = |by: [f64; 2]| move |t: f64| if t < 0.19 { [150.0, 100.0] } else { [150.0 + by[0], 100.0 + by[1]] };
    let swing = |size: f64| move |t: f64| [150.0 + size * (1e3 * t).sin(), 100.0 + size * (777.0 * t).cos()];
    let jumps = [[5.0, 11.0], [-9.0, 6.0], [12.0, 1.0], [2.0, -13.0]].map(jump);
    let swings = [10.0, 12.0].map(swing);
    let all = jumps.iter().map(|path| (path as Path, 40_u64)).chain(swings.iter().map(|path| (path as Path, 80)));
    let quick = SPOT.replace("quadrature = \"auto\"", "quadrature = 1");
    for (number, (path, frames)) in all.enumerate() {
        let tally = shaken(&quick, [10.0, 7.0], 0.0, frames, path);
        eprintln!("{number}: {tally:?}");
        assert!(tally.wrong == 0 && tally.tracking as u64 == frames, "{number}: {tally:?}");
    }
}
