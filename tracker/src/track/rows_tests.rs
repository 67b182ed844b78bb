#![allow(clippy::unwrap_used)]
//! Frames with row offsets of stated and of unknown variance.

use std::sync::Arc;

use isophote_frame::{Frame, Plane};
use isophote_jit::PixelFormat;
use isophote_symbolic::{Model, Precision};

use crate::picture::{Falloff, Noise, Spot, TestPicture};
use crate::solve::compiled::Compiled;
use crate::{Camera, Estimate, TrackState, Tracker, TrackerOptions};

const FRAMES: u64 = 60;

struct Scene {
    centre: [f64; 2],
    frame: Frame,
}

/// A spot in noise of 1 DN, with row offsets of this standard deviation, DN.
fn scene(seed: u64, rows: f64) -> Scene {
    let centre = [39.6 + 0.37 * (seed % 7) as f64, 40.9 - 0.21 * (seed % 5) as f64];
    let profile = Falloff::Cubic(-0.5, -0.3);
    let spot = Spot { centre, half: [20.0, 14.0], angle: 0.3, amplitude: 150.0, profile };
    let picture = TestPicture { noise: 1.0, seed: seed + 1, samples: 4, ..TestPicture::new(80, 80, vec![spot]) };
    let mut noise = Noise(0x51_7C_C1_B7 + 77 * seed);
    let pixels = picture.pixels();
    let rows = pixels.chunks(80).flat_map(|row| {
        let offset = rows * noise.normal();
        row.iter().map(move |value| (value + offset).round().clamp(0.0, 255.0) as u8)
    });
    let frame = Frame::new(&[80, 80], vec![Plane::owned(PixelFormat::U8, rows.collect(), 80)]).unwrap();
    Scene { centre, frame }
}

fn compiled() -> Arc<Compiled> {
    let model = Arc::new(Model::from_toml(include_str!("../../../models/spot.toml")).unwrap());
    Arc::new(Compiled::new(model, Precision::F32).unwrap())
}

fn tracker(compiled: &Arc<Compiled>, row_noise_e: Option<f64>) -> Tracker {
    let constants = [("gain", 0.0), ("read_noise", 1.0)].map(|(name, value)| (name.to_string(), value)).into();
    let camera = Camera { electrons_per_dn: Some(20.0), row_noise_e, ..Camera::default() };
    Tracker::new(compiled.clone(), TrackerOptions { constants, camera, ..TrackerOptions::default() }).unwrap()
}

/// Squared error, and eᵀC⁻¹e.
fn judged(tracker: &Tracker, scene: &Scene, estimate: &Estimate) -> [f64; 2] {
    assert_eq!(estimate.state, TrackState::Tracking, "{estimate:?}");
    assert!(estimate.substitute.is_none(), "{estimate:?}");
    let model = tracker.compiled().model();
    let at = |name: &str| estimate.parameters[model.parameter(name).unwrap().index()];
    let [x, y] = [at("bx") - scene.centre[0], at("by") - scene.centre[1]];
    let c = estimate.covariance.as_ref().unwrap();
    let nees = (c[1][1] * x * x - 2.0 * c[0][1] * x * y + c[0][0] * y * y) / (c[0][0] * c[1][1] - c[0][1] * c[1][0]);
    [x * x + y * y, nees]
}

fn mean(all: &[[f64; 2]]) -> [f64; 2] {
    [0, 1].map(|of| all.iter().map(|one| one[of]).sum::<f64>() / all.len() as f64)
}

#[test]
fn stated_row_offsets_leave_honest_covariances() {
    let compiled = compiled();
    let found: Vec<[f64; 2]> = (0..FRAMES)
        .map(|seed| {
            let (scene, mut tracker) = (scene(seed, 2.0), tracker(&compiled, Some(40.0)));
            let estimate = tracker.track(&scene.frame);
            let reduced = estimate.reduced_chi_square.unwrap();
            assert!((0.85..1.15).contains(&reduced) && estimate.confidence.unwrap() > 0.9, "{estimate:?}");
            judged(&tracker, &scene, &estimate)
        })
        .collect();
    let [_, nees] = mean(&found);
    assert!((1.2..2.8).contains(&nees), "{nees}"); // 2 ± 3 · 2/√60
}

#[test]
fn row_offsets_are_detected() {
    let compiled = compiled();
    let mut tracker = tracker(&compiled, None);
    let found: Vec<[f64; 2]> = (0..FRAMES)
        .map(|seed| {
            let scene = scene(seed, 2.0);
            let estimate = tracker.track(&scene.frame);
            judged(&tracker, &scene, &estimate)
        })
        .collect();
    let [_, nees] = mean(&found);
    assert!((1.2..2.8).contains(&nees), "{nees}");
    let learned = tracker.tracks[0].memory.rows.variance().unwrap();
    assert!((3.0..5.0).contains(&learned), "{learned}");
}

/// Less than the noise of a pixel, so that χ²/ν hardly changes.
#[test]
fn small_row_offsets_are_detected() {
    let compiled = compiled();
    let mut tracker = tracker(&compiled, None);
    tracker.track(&scene(1000, 0.5).frame);
    let found: Vec<[f64; 2]> = (0..FRAMES)
        .map(|seed| {
            let scene = scene(seed, 0.5);
            let estimate = tracker.track(&scene.frame);
            judged(&tracker, &scene, &estimate)
        })
        .collect();
    let [_, nees] = mean(&found);
    assert!((1.2..2.8).contains(&nees), "{nees}");
}

#[test]
fn no_offsets_are_learned_from_rows_without_them() {
    let compiled = compiled();
    let mut tracker = tracker(&compiled, None);
    for seed in 0..10 {
        tracker.track(&scene(seed, 0.0).frame);
        assert_eq!(tracker.tracks[0].memory.rows.variance(), None, "{seed}");
    }
}
