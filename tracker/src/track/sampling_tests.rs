//! Models with automatic quadrature.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use isophote_frame::{Frame, Plane};
use isophote_jit::PixelFormat;
use isophote_symbolic::{Model, Precision};

use crate::picture::{Falloff, Noise, Spot, TestPicture};
use crate::{CONFIDENCE_MIN, Compiled, Estimate, Preparing, Sampled, TrackState, Tracker, TrackerOptions};

const SPOT: &str = include_str!("../../../models/spot.toml");
/// px a frame
const VELOCITY: [f64; 2] = [0.31, 0.17];

fn tracker(text: &str, precision: Precision, preparing: Preparing) -> Tracker {
    let compiled = Arc::new(Compiled::new(Arc::new(Model::from_toml(text).unwrap()), precision).unwrap());
    Tracker::new(compiled, TrackerOptions { precision, preparing, ..TrackerOptions::default() }).unwrap()
}

/// The pixels, and the true centre.
fn pixels_of(half: f64, side: usize, number: u64, noise: f64) -> (Vec<f32>, [f64; 2]) {
    let centre = VELOCITY.map(|velocity| 0.5 * side as f64 - 1.3 + velocity * number as f64);
    let half = [half, 0.72 * half];
    let spot = Spot { centre, half, angle: 0.5, amplitude: 130.0, profile: Falloff::Cubic(-0.5, -0.3) };
    let picture = TestPicture { samples: 12, noise, seed: number + 1, ..TestPicture::new(side, side, vec![spot]) };
    (picture.pixels().into_iter().map(|value| value as f32).collect(), centre)
}

fn frame_of(half: f64, side: usize, number: u64, noise: f64) -> (Frame, [f64; 2]) {
    let (pixels, centre) = pixels_of(half, side, number, noise);
    let bytes = pixels.iter().flat_map(|value| value.to_ne_bytes()).collect();
    let frame = Frame::new(&[side, side], vec![Plane::owned(PixelFormat::F32, bytes, side)]).unwrap();
    (frame.with_sequence(number), centre)
}

fn frame(half: f64, number: u64, noise: f64) -> (Frame, [f64; 2]) {
    frame_of(half, (4.0 * half + 24.0) as usize, number, noise)
}

/// √(eᵀC⁻¹e) of the centre.
fn distance(estimate: &Estimate, centre: [f64; 2]) -> f64 {
    assert_eq!(estimate.state, TrackState::Tracking, "{estimate:?}");
    let covariance = estimate.covariance.as_ref().unwrap();
    let (xx, xy, yy) = (covariance[0][0], covariance[0][1], covariance[1][1]);
    let [x, y] = [0, 1].map(|axis| estimate.parameters[axis] - centre[axis]);
    ((yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)).sqrt()
}

/// The largest distance of some frames without noise, and how the last one was sampled.
fn followed(text: &str, half: f64, confidence_min: f64) -> (f64, Option<Sampled>) {
    let compiled = Arc::new(Compiled::new(Arc::new(Model::from_toml(text).unwrap()), Precision::F32).unwrap());
    let mut tracker = Tracker::new(compiled, TrackerOptions { confidence_min, ..TrackerOptions::default() }).unwrap();
    let mut worst: f64 = 0.0;
    let mut sampled = None;
    for number in 0..6 {
        let (frame, centre) = frame(half, number, 0.0);
        let estimate = tracker.track(&frame);
        worst = worst.max(distance(&estimate, centre));
        sampled = estimate.sampled;
    }
    (worst, sampled)
}

#[test]
fn small_targets_are_sampled_finely_and_large_ones_coarsely() {
    let mut before = u32::MAX;
    for (half, expected) in [(2.5, Some(2)), (20.0, None), (60.0, Some(1))] {
        let (worst, sampled) = followed(SPOT, half, CONFIDENCE_MIN);
        let Sampled { points, slopes } = sampled.unwrap();
        assert!(worst <= 0.2, "{half} px: {worst} σ with {points} points");
        assert!(points < before && expected.is_none_or(|expected| slopes == expected), "{half} px: {points}, {slopes}");
        before = points;
    }
}

#[test]
fn a_small_sharp_spot_in_little_noise_is_sampled_finer_still() {
    let text = SPOT.replace("k1 = { start = -0.5 }", "k1 = { start = 0.0 }");
    assert_ne!(text, SPOT);
    let mut tracker = tracker(&text, Precision::F32, Preparing::AtOnce);
    let squares = (0..12).map(|number| {
        let centre = [12.3 + VELOCITY[0] * number as f64, 12.1 + VELOCITY[1] * number as f64];
        let profile = Falloff::Cubic(0.0, -0.3);
        let spot = Spot { centre, half: [3.0, 2.2], angle: 0.5, amplitude: 3000.0, profile };
        let picture = TestPicture { samples: 48, ..TestPicture::new(28, 28, vec![spot]) };
        let bytes = picture.pixels().into_iter().flat_map(|value| (value as f32).to_ne_bytes()).collect();
        let frame = Frame::new(&[28, 28], vec![Plane::owned(PixelFormat::F32, bytes, 28)]).unwrap();
        let estimate = tracker.track(&frame.with_sequence(number));
        assert!(estimate.sampled.unwrap().points > 6, "{number}: {:?}", estimate.sampled);
        distance(&estimate, centre).powi(2)
    });
    let rms = (squares.sum::<f64>() / 12.0).sqrt();
    assert!(rms <= 0.5, "{rms} σ");
}

/// F has a kink wherever the rim crosses a sample point, and steps may oscillate for ever: the point between them is taken.
#[test]
fn oscillating_steps_do_not_fall_back_to_coarse_sampling() {
    let text = SPOT.replace("k1 = { start = -0.5 }", "k1 = { start = 0.0 }");
    let compiled = Arc::new(Compiled::new(Arc::new(Model::from_toml(&text).unwrap()), Precision::F32).unwrap());
    let coarse: Vec<(u64, f64)> = (0..200)
        .filter_map(|number| {
            let mut random = Noise(number);
            let centre = [12.0 + random.uniform(), 12.0 + random.uniform()];
            let (angle, profile) = (3.0 * random.uniform(), Falloff::Cubic(0.0, -0.3));
            let spot = Spot { centre, half: [3.0, 2.2], angle, amplitude: 3000.0, profile };
            let picture = TestPicture { samples: 24, noise: 3.0, seed: number, ..TestPicture::new(28, 28, vec![spot]) };
            let bytes = picture.pixels().into_iter().flat_map(|value| (value as f32).to_ne_bytes()).collect();
            let frame = Frame::new(&[28, 28], vec![Plane::owned(PixelFormat::F32, bytes, 28)]).unwrap();
            let options = TrackerOptions { precision: Precision::F32, ..TrackerOptions::default() };
            let estimate = Tracker::new(compiled.clone(), options).unwrap().track(&frame);
            (estimate.sampled.unwrap().points <= 2).then(|| (number, distance(&estimate, centre)))
        })
        .collect();
    // One starts too far away.
    assert!(coarse.len() <= 1, "{coarse:?}");
}

#[test]
fn a_stated_quadrature_is_honoured() {
    let centre = SPOT.replace("quadrature = \"auto\"", "quadrature = 1");
    // So small a target at pixel centres alone leaves more unexplained than noise does.
    let (worst, sampled) = followed(&centre, 2.5, 0.0);
    assert!(sampled.is_none() && worst > 1.0, "{worst} σ, {sampled:?}");
}

#[test]
fn a_choice_is_kept_while_the_target_does_not_change() {
    let mut tracker = tracker(SPOT, Precision::F32, Preparing::AtOnce);
    let choices: Vec<Option<Sampled>> =
        (0..40).map(|number| tracker.track(&frame(9.0, number, 2.0).0).sampled).collect();
    let changes = choices.windows(2).filter(|pair| pair[0] != pair[1]).count();
    assert!(choices[0].is_some() && changes <= 1, "{choices:?}");
}

#[test]
fn sampling_kernels_are_prepared_beside_the_fits() {
    let mut tracker = tracker(SPOT, Precision::F32, Preparing::Beside);
    let coarse = Some(Sampled { points: 2, slopes: 2 });
    assert_eq!(tracker.track(&frame(4.0, 0, 0.0).0).sampled, coarse);
    let preparation = tracker.wanted().unwrap();
    // A stopped preparation leaves nothing half done.
    preparation.run(&|| false).unwrap();
    assert_eq!(tracker.track(&frame(4.0, 1, 0.0).0).sampled, coarse);
    tracker.wanted().unwrap().run(&|| true).unwrap();
    let estimate = tracker.track(&frame(4.0, 2, 0.0).0);
    assert!(estimate.sampled.unwrap().points > 2 && tracker.wanted().is_none(), "{estimate:?}");
}

#[test]
fn fits_in_double_precision_report_two_points() {
    let estimate = tracker(SPOT, Precision::F64, Preparing::AtOnce).track(&frame(8.0, 0, 0.0).0);
    assert_eq!(estimate.sampled, Some(Sampled { points: 2, slopes: 2 }));
}

#[test]
fn a_target_that_shrinks_slowly_is_sampled_ever_more_finely() {
    let mut tracker = tracker(SPOT, Precision::F32, Preparing::AtOnce);
    let mut half = 24.0;
    let mut points = Vec::new();
    for number in 0..50 {
        let (frame, centre) = frame_of(half, 130, number, 0.0);
        let estimate = tracker.track(&frame);
        assert!(distance(&estimate, centre) < 0.3, "{half} px: {}, {estimate:?}", distance(&estimate, centre));
        points.push(estimate.sampled.unwrap().points);
        half *= 0.96;
    }
    assert!(points[0] < points[49], "{points:?}");
}

#[test]
fn nan_pixels_are_left_out_after_clean_frames() {
    let mut tracker = tracker(SPOT, Precision::F32, Preparing::AtOnce);
    for number in 0..6 {
        let (mut pixels, centre) = pixels_of(12.0, 120, number, 0.0);
        if number > 2 {
            let position = centre[1] as usize * 120 + centre[0] as usize + 3;
            pixels[position] = f32::NAN;
        }
        let bytes = pixels.iter().flat_map(|value| value.to_ne_bytes()).collect();
        let frame = Frame::new(&[120, 120], vec![Plane::owned(PixelFormat::F32, bytes, 120)]).unwrap();
        let estimate = tracker.track(&frame.with_sequence(number));
        assert!(distance(&estimate, centre) < 0.6, "{number}: {estimate:?}");
    }
}
