//! A target that shakes: each frame puts it somewhere else by a pixel.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use isophote_symbolic::{Model, Precision};

use super::Followed;
use crate::picture::{Noise, Picture, Profile, Spot};
use crate::{Compiled, TrackState, Tracker, TrackerOptions};

/// What became of the frames of a sequence.
#[derive(Debug, Default)]
struct Tally {
    tracking: usize,
    /// Frames that the fit around the prediction did not answer.
    searched: usize,
    /// Frames that were said to be tracked more than a pixel off.
    wrong: usize,
    /// The largest error of a tracked frame, px.
    worst_px: f64,
}

/// Follows a spot along a path that is shaken by up to `jitter_px`.
fn shaken(document: &str, half: [f64; 2], jitter_px: f64, frames: u64, path: &dyn Fn(f64) -> [f64; 2]) -> Tally {
    let model = Model::from_toml(document).unwrap_or_else(|d| panic!("{}", d[0].render("test")));
    let compiled = Arc::new(Compiled::new(Arc::new(model), Precision::F32).unwrap());
    let mut tracker = Tracker::new(compiled, TrackerOptions::default()).unwrap();
    let mut noise = Noise(0xC0FFEE);
    let mut tally = Tally::default();
    for number in 0..frames {
        let [x, y] = path(number as f64 / 60.0);
        let centre = [x, y].map(|at| at + jitter_px * (2.0 * noise.uniform() - 1.0));
        let spot = Spot { centre, half, angle: 0.3, amplitude: 120.0, profile: Profile::Cubic(-0.5, -0.3) };
        let picture = Picture { noise: 1.5, seed: number + 1, ..Picture::new(320, 240, vec![spot]) };
        let frame = picture.frame().with_sequence(number);
        if number > 0 {
            let look = tracker.solver.look(&frame).unwrap();
            let followed = tracker.tracks[0].follow(&tracker.solver, &look, number as f64 / 60.0).unwrap();
            tally.searched += usize::from(matches!(followed, Followed::Doubtful(_)));
        }
        let estimate = tracker.track(&frame);
        if estimate.state == TrackState::Tracking {
            let off = (estimate.parameters[0] - centre[0]).hypot(estimate.parameters[1] - centre[1]);
            tally.tracking += 1;
            tally.wrong += usize::from(off > 1.0);
            tally.worst_px = tally.worst_px.max(off);
        }
    }
    tally
}

const PLAIN: &str = include_str!("../../../tests/documents/plain-spot.toml");
const SPOT: &str = include_str!("../../../models/spot.toml");

#[test]
fn a_shaken_target_is_followed_without_searching() {
    let still = |_: f64| [150.3, 110.6];
    let swing = |t: f64| [160.0 + 80.0 * (std::f64::consts::TAU * 0.2 * t).sin(), 110.6];
    for (document, half, path) in [
        (PLAIN, [5.0, 4.0], &still as &dyn Fn(f64) -> [f64; 2]),
        (SPOT, [5.0, 4.0], &still),
        (SPOT, [5.0, 4.0], &swing),
        (SPOT, [20.0, 14.0], &swing),
    ] {
        let tally = shaken(document, half, 1.0, 150, path);
        println!("{half:?}: {tally:?}");
        assert!(tally.tracking == 150 && tally.wrong == 0 && tally.worst_px < 0.2, "{half:?}: {tally:?}");
        assert!(tally.searched <= 4, "{half:?}: {tally:?}");
    }
}

/// A prediction that is far off, as after a step, costs a second fit from the last estimate, and no search.
#[test]
fn a_prediction_that_leads_astray_is_dropped() {
    let model = Model::from_toml(SPOT).unwrap_or_else(|d| panic!("{}", d[0].render("test")));
    let compiled = Arc::new(Compiled::new(Arc::new(model), Precision::F32).unwrap());
    let mut tracker = Tracker::new(compiled, TrackerOptions::default()).unwrap();
    // 15 px a frame, and then it stands still.
    let at = |number: u64| [40.0 + 15.0 * number.min(10) as f64, 110.6];
    let mut searched = 0;
    for number in 0..16 {
        let (centre, half) = (at(number), [6.0, 5.0]);
        let spot = Spot { centre, half, angle: 0.3, amplitude: 120.0, profile: Profile::Cubic(-0.5, -0.3) };
        let picture = Picture { noise: 1.5, seed: number + 1, ..Picture::new(320, 240, vec![spot]) };
        let frame = picture.frame().with_sequence(number);
        if number > 10 {
            let look = tracker.solver.look(&frame).unwrap();
            let attempt = tracker.tracks[0].follow(&tracker.solver, &look, number as f64 / 60.0).unwrap();
            let candidate = match attempt {
                Followed::Kept(candidate) => candidate,
                Followed::Doubtful(candidate) => {
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
