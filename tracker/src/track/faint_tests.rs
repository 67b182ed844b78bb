#![allow(clippy::unwrap_used)]
use std::sync::Arc;

use isophote_frame::{Frame, Plane};
use isophote_jit::PixelFormat;
use isophote_symbolic::{Model, Precision};

use crate::picture::Noise;
use crate::{Compiled, Ending, Estimate, TrackState, Tracker, TrackerOptions};

/// A 16-bit frame of 400 × 300 px with noise of 20 DN and Gaussians: x, y, σ, height; clipped at 4095.
fn frame(seed: u64, stars: &[[f64; 4]]) -> Frame {
    let mut noise = Noise(0x5851_F42D_4C95_7F2D ^ (seed + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15));
    let value = |i: usize| {
        let (x, y) = ((i % 400) as f64, (i / 400) as f64);
        let star = |[u, v, sigma, height]: &[f64; 4]| {
            height * (-0.5 * ((x - u).powi(2) + (y - v).powi(2)) / sigma.powi(2)).exp()
        };
        let light: f64 = stars.iter().map(star).sum();
        ((300.0 + light + 20.0 * noise.normal()).round().clamp(0.0, 4095.0) as u16).to_ne_bytes()
    };
    let bytes = (0..400 * 300).flat_map(value).collect();
    Frame::new(&[400, 300], vec![Plane::owned(PixelFormat::U16, bytes, 400)]).unwrap()
}

fn updated(frame: &Frame) -> Estimate {
    let model = Model::from_toml(include_str!("../../../models/gaussian.toml")).unwrap();
    let compiled = Arc::new(Compiled::new(Arc::new(model), Precision::F32).unwrap());
    Tracker::new(compiled, TrackerOptions::default()).unwrap().track(frame)
}

fn is_at(estimate: &Estimate, [x, y]: [f64; 2]) -> bool {
    estimate.state == TrackState::Tracking && (estimate.parameters[0] - x).hypot(estimate.parameters[1] - y) < 2.0
}

#[test]
fn a_star_too_faint_for_single_pixels_is_tracked() {
    // In noise of 20 DN a height h has a significance of h σ √π / 20 standard deviations: 9.
    let height = 9.0 * 20.0 / (1.5 * std::f64::consts::PI.sqrt());
    for seed in 0..5 {
        let (x, y) = (60.3 + 50.0 * seed as f64, 240.8 - 40.0 * seed as f64);
        let estimate = updated(&frame(seed, &[[x, y, 1.5, height]]));
        assert!(is_at(&estimate, [x, y]), "{estimate:?}");
    }
}

#[test]
fn an_empty_frame_reports_the_strongest_response() {
    let estimate = updated(&frame(77, &[]));
    assert_eq!((estimate.state, estimate.ending), (TrackState::Searching, Ending::NoTarget));
    let strongest = estimate.strongest.unwrap();
    assert!((3.0..strongest.threshold).contains(&strongest.score), "{strongest:?}");
}

#[test]
fn a_large_overexposed_target_is_preferred_to_a_faint_one() {
    let estimate = updated(&frame(5, &[[250.0, 150.0, 22.0, 9000.0], [60.0, 60.0, 1.5, 90.0]]));
    assert!(is_at(&estimate, [250.0, 150.0]), "{estimate:?}");
}

#[test]
fn a_fit_whose_domain_shrinks_in_noise_keeps_its_first_pixels() {
    let height = 9.5 * 20.0 / (1.1 * std::f64::consts::PI.sqrt());
    let (x, y) = (181.07, 191.45);
    let estimate = updated(&frame(92, &[[x, y, 1.1, height]]));
    assert!(is_at(&estimate, [x, y]), "{estimate:?}");
}
