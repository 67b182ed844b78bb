//! Frames that are left before they are done: promptly, honestly, and with nothing lost.

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

/// Fits a frame and ends it when it asks for the `asks`th time; how often it asked, and the estimate.
fn stopped_at(tracker: &mut Tracker, frame: &Frame, asks: u64, stop: Stop) -> (u64, Estimate) {
    let asked = AtomicU64::new(0);
    let watch = || (asked.fetch_add(1, Ordering::Relaxed) + 1 >= asks).then_some(stop);
    let estimate = tracker.track_all_while(frame, &watch).swap_remove(0);
    (asked.load(Ordering::Relaxed), estimate)
}

fn is_honest(estimate: &Estimate, ending: Ending) -> bool {
    match estimate.state {
        TrackState::Tracking => estimate.ending != ending && estimate.rejection.is_none(),
        _ => estimate.ending == ending && !estimate.converged,
    }
}

#[test]
fn a_cold_frame_may_be_left_at_any_pass() {
    let compiled = compiled();
    let (all, whole) = stopped_at(&mut tracker(&compiled, u64::MAX), &frame(0), u64::MAX, Stop::Cancelled);
    assert!(all >= 8 && whole.converged, "{all}: {whole:?}");
    for asks in 1..=all {
        let mut tracker = tracker(&compiled, u64::MAX);
        let (asked, estimate) = stopped_at(&mut tracker, &frame(0), asks, Stop::Cancelled);
        assert_eq!(asked, asks, "asked again after the end");
        assert_eq!(estimate.state, TrackState::Searching, "{estimate:?}");
        assert!(is_honest(&estimate, Ending::Cancelled), "{asks} of {all}: {estimate:?}");
        // The next frame is found as if nothing had been.
        assert!(tracker.track(&frame(1)).converged);
    }
}

#[test]
fn a_frame_that_is_left_takes_nothing_from_a_track() {
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
            let begin = Instant::now();
            let (_, left) = stopped_at(&mut tracker, &frame(5), asks, stop);
            eprintln!("left after {asks} of {warm} passes: {:?}", begin.elapsed());
            assert!(is_honest(&left, stop.into()), "{left:?}");
            assert!(matches!(left.state, TrackState::Coasting | TrackState::Tracking), "{left:?}");
            // Warm: it asks as seldom as it would have, and far less often than a search.
            let (asked, next) = stopped_at(&mut tracker, &frame(6), u64::MAX, stop);
            assert!(next.converged && asked <= warm + 3, "{asked} {warm} {next:?}");
        }
    }
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
