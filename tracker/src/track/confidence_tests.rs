//! Confidence in a target among look-alikes, and in one that the model no longer describes.
#![allow(clippy::unwrap_used)]
use std::sync::Arc;

use isophote_frame::{Frame, Plane};
use isophote_jit::PixelFormat;
use isophote_symbolic::{Model, Precision};

use crate::picture::Noise;
use crate::{Compiled, Estimate, Rejection, TrackState, Tracker, TrackerOptions};

const SIZE: [usize; 2] = [240, 180];

fn tracker(targets: usize) -> Tracker {
    tracker_with(TrackerOptions { targets, ..TrackerOptions::default() })
}

fn tracker_with(options: TrackerOptions) -> Tracker {
    let model = Model::from_toml(include_str!("../../../tests/documents/plain-spot.toml")).unwrap();
    let compiled = Compiled::new(Arc::new(model), Precision::F32).unwrap();
    Tracker::new(Arc::new(compiled), options).unwrap()
}

/// Spots at `centres` with stripes of relative amplitude `depth`, in noise of standard deviation `noise`.
fn frame(number: u64, centres: &[[f64; 2]], depth: f64, noise: f64) -> Frame {
    frame_of(number, &[(centres, 1.0)], depth, noise)
}

/// The same with several sizes.
fn frame_of(number: u64, spots: &[(&[[f64; 2]], f64)], depth: f64, noise: f64) -> Frame {
    let mut random = Noise(number + 1);
    let value = |i: usize| {
        let (x, y) = ((i % SIZE[0]) as f64, (i / SIZE[0]) as f64);
        let spot = |[bx, by]: &[f64; 2], size: f64| {
            let s = ((x - bx) / (17.0 * size)).powi(2) + ((y - by) / (12.0 * size)).powi(2);
            if s < 1.0 { 120.0 * (1.0 - s * (0.5 + s * (0.3 + 0.2 * s))) } else { 0.0 }
        };
        let stripes = 1.0 + depth * (std::f64::consts::TAU * (x + y) / 8.0).sin();
        let of = |(centres, size): &(&[[f64; 2]], f64)| centres.iter().map(|centre| spot(centre, *size)).sum::<f64>();
        let light = stripes * spots.iter().map(of).sum::<f64>();
        (20.0 + light + noise * random.normal()).round().clamp(0.0, 255.0) as u8
    };
    let bytes = (0..SIZE[0] * SIZE[1]).map(value).collect();
    Frame::new(&SIZE, vec![Plane::owned(PixelFormat::U8, bytes, SIZE[0])]).unwrap().with_sequence(number)
}

/// Follows a target for ten frames, then shows it with stripes of `depth` in `noise`.
fn after_ten_frames(depth: f64, noise: f64) -> Estimate {
    let mut tracker = tracker(1);
    let centre = [[120.3, 90.6]];
    for number in 0..10 {
        assert_eq!(tracker.track(&frame(number, &centre, 0.0, 1.5)).state, TrackState::Tracking);
    }
    tracker.track(&frame(10, &centre, depth, noise))
}

#[test]
fn one_of_two_look_alikes_has_half_the_confidence() {
    let two = [[70.2, 90.4], [170.7, 88.9]];
    let mut alone = tracker(1);
    let confidence = alone.track(&frame(0, &two[..1], 0.0, 1.5)).confidence.unwrap();
    assert!((0.95..0.98).contains(&confidence), "{confidence}");
    let mut one = tracker(1);
    for number in 0..5 {
        let estimate = one.track(&frame(number, &two, 0.0, 1.5));
        assert!((0.4..0.55).contains(&estimate.confidence.unwrap()), "{estimate:?}");
    }
    let mut both = tracker(2);
    for estimate in both.track_all(&frame(0, &two, 0.0, 1.5)) {
        assert!(estimate.confidence.unwrap() > 0.9, "who wants both is told of both: {estimate:?}");
    }
}

#[test]
fn none_of_three_look_alikes_reaches_the_minimum_confidence() {
    let three = [[40.2, 90.4], [120.4, 89.1], [200.7, 88.9]];
    let mut one = tracker(1);
    for number in 0..5 {
        let estimate = one.track(&frame(number, &three, 0.0, 1.5));
        assert_eq!((estimate.state, estimate.rejection), (TrackState::Searching, Some(Rejection::OneOfSeveral)));
        let confidence = estimate.confidence.unwrap();
        assert!((0.25..0.4).contains(&confidence), "{estimate:?}");
    }
    let start = [("bx".into(), 122.0), ("by".into(), 87.0)].into();
    let mut tracker = tracker_with(TrackerOptions { start, ..TrackerOptions::default() });
    let estimate = tracker.track(&frame(0, &three, 0.0, 1.5));
    assert!(estimate.state == TrackState::Tracking && estimate.confidence.unwrap() > 0.9, "{estimate:?}");
}

#[test]
fn the_largest_of_several_look_alikes_is_the_target() {
    let one = [[120.4, 89.1]];
    let small = [[40.2, 40.4], [200.7, 40.9], [40.3, 140.2], [200.1, 140.8]];
    let mut tracker = tracker(1);
    let estimate = tracker.track(&frame_of(0, &[(&one, 1.0), (&small, 0.25)], 0.0, 1.5));
    assert!((estimate.parameters[0] - one[0][0]).abs() < 1.0, "{estimate:?}");
    assert_eq!(estimate.state, TrackState::Tracking, "nothing else has a tenth of its energy: {estimate:?}");
}

#[test]
fn a_sudden_misfit_lowers_confidence() {
    let [before, after] = [0.0, 0.4].map(|depth| after_ten_frames(depth, 1.5).confidence.unwrap());
    assert!(before > 0.7 && after < 0.9 * before, "{before} {after}");
}

#[test]
fn sudden_noise_keeps_the_target_and_grows_its_covariance() {
    let estimate = after_ten_frames(0.0, 7.5);
    assert!(estimate.state == TrackState::Tracking && estimate.reduced_chi_square.unwrap() > 30.0, "{estimate:?}");
    // Five times the noise: the covariance follows at once.
    let grown = estimate.covariance.unwrap()[0][0].sqrt() / after_ten_frames(0.0, 1.5).covariance.unwrap()[0][0].sqrt();
    assert!((4.5..5.5).contains(&grown), "{grown}");
}

/// A lone flat-topped spot, 1/(1 + s⁴), of semi-axes 17.3 × 14.6 px.
fn lone_pillow(number: u64) -> Frame {
    let (width, height) = (160, 120);
    let mut random = Noise(number + 1);
    let value = |i: usize| {
        let (x, y) = ((i % width) as f64 - 80.2, (i / width) as f64 - 60.6);
        let s = (x / 17.3).powi(2) + (y / 14.6).powi(2);
        let light = 30.0 + 120.0 / (1.0 + s.powi(4));
        (light + (0.5 + light / 32.0).sqrt() * random.normal()).round() as u8
    };
    let bytes = (0..width * height).map(value).collect();
    Frame::new(&[width, height], vec![Plane::owned(PixelFormat::U8, bytes, width)]).unwrap()
}

#[test]
fn a_lone_object_is_tracked_although_fits_of_noise_are_likelier() {
    let model = Model::from_toml(include_str!("../../../models/gaussian.toml")).unwrap();
    let compiled = Arc::new(Compiled::new(Arc::new(model), Precision::F32).unwrap());
    for number in 0..6 {
        let mut tracker = Tracker::new(compiled.clone(), TrackerOptions::default()).unwrap();
        let estimate = tracker.track(&lone_pillow(number));
        let off = (estimate.parameters[0] - 80.2).hypot(estimate.parameters[1] - 60.6);
        assert!(estimate.state == TrackState::Tracking && off < 0.2, "{number}: {:?} {off}", estimate.state);
    }
}
