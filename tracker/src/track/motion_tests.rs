#![allow(clippy::unwrap_used)]
use super::*;
use crate::picture::Noise;

const PERIOD_S: f64 = 1.0 / 60.0;

/// A centre in two coordinates with a deviation of `sigma` px, and a shape of three entries.
fn measured(x: f64, y: f64, sigma: f64) -> Measured {
    let values = DVector::from_vec(vec![x, y, 2.5e-3, 0.0, 5e-3]);
    let spread = [sigma * sigma, sigma * sigma, 1e-10, 1e-10, 1e-10];
    Measured { centres: 2, values, covariance: DMatrix::from_diagonal(&DVector::from_row_slice(&spread)) }
}

/// Follows x(t), y(t) with seeded noise; the mean of yᵀS⁻¹y over the last frames, and the filter.
fn followed(sigma: f64, frames: u32, path: impl Fn(f64) -> [f64; 2]) -> (f64, Motion) {
    let mut noise = Noise(0x5EED);
    let mut seen = |frame: u32| {
        let [x, y] = path(f64::from(frame) * PERIOD_S);
        measured(x + sigma * noise.normal(), y + sigma * noise.normal(), sigma)
    };
    let mut motion = Motion::begin(&seen(0), 0.0, None);
    let mut sum = 0.0;
    for frame in 1..frames {
        let (now, time_s) = (seen(frame), f64::from(frame) * PERIOD_S);
        if 2 * frame >= frames {
            sum += motion.predict(time_s).distance(&now).unwrap();
        }
        motion.update(&now, time_s);
    }
    (2.0 * sum / f64::from(frames), motion)
}

#[test]
fn innovations_are_as_large_as_the_filter_says() {
    let swing = |amplitude: f64| move |t: f64| [300.0 + amplitude * (3.0 * t).sin(), 200.0 + 50.0 * t];
    for (sigma, amplitude) in [(0.1, 0.0), (0.1, 80.0), (0.03, 300.0), (1.0, 80.0)] {
        let (mean, motion) = followed(sigma, 1200, swing(amplitude));
        // Two coordinates; it may be too careful, never too sure.
        assert!((0.5..3.0).contains(&mean), "σ {sigma}, {amplitude} px: {mean} {motion:?}");
    }
}

#[test]
fn a_steady_target_is_predicted_through_a_gap() {
    let (_, motion) = followed(0.1, 300, |t| [100.0 + 90.0 * t, 50.0 - 30.0 * t]);
    let (last_s, mut before) = (299.0 * PERIOD_S, 0.0);
    for gap in [1.0, 10.0, 60.0] {
        let time_s = last_s + gap * PERIOD_S;
        let (state, covariance) = motion.predict(time_s).moving();
        let (dx, dy) = (state[0] - 100.0 - 90.0 * time_s, state[1] - 50.0 + 30.0 * time_s);
        let deviation = covariance[(0, 0)].sqrt();
        assert!(dx.hypot(dy) < 4.0 * deviation && deviation > before, "{gap} frames: {dx} {dy} {deviation}");
        before = deviation;
    }
    assert!(before < 60.0, "a second later it is still known to {before} px");
}

#[test]
fn time_steps_need_not_be_even() {
    let path = |t: f64| (20.0 + 120.0 * t, 80.0 + 60.0 * t);
    let mut motion = Motion::begin(&measured(20.0, 80.0, 0.05), 0.0, Some(500.0));
    let mut time_s = 0.0;
    for step in 0..200 {
        time_s += PERIOD_S * [1.0, 3.0, 0.5, 7.0][step % 4];
        let (x, y) = path(time_s);
        let now = measured(x, y, 0.05);
        assert!(step < 3 || motion.predict(time_s).admits(&now), "step {step}");
        motion.update(&now, time_s);
    }
    let (state, _) = motion.predict(time_s).moving();
    assert!((state[2] - 120.0).abs() < 5.0 && (state[3] - 60.0).abs() < 5.0, "{state}");
    assert_eq!(motion.sigma_px_s2, 500.0, "a given acceleration stays");
}

#[test]
fn the_gate_refuses_what_is_elsewhere() {
    let (_, motion) = followed(0.1, 300, |t| [100.0 + 90.0 * t, 50.0]);
    let time_s = 300.0 * PERIOD_S;
    let predicted = motion.predict(time_s);
    let x = 100.0 + 90.0 * time_s;
    assert!(predicted.admits(&measured(x + 0.2, 50.1, 0.1)));
    assert!(!predicted.admits(&measured(x + 40.0, 50.0, 0.1)));
    // χ² with 2 degrees of freedom: the tail beyond g is exp(−g/2).
    let tail = (-0.5 * gate(2)).exp();
    assert!((1e-5..1e-4).contains(&tail), "{tail}");
    assert_eq!(Predicted::excess((1.0, 2)), 0.0);
    assert!(Predicted::excess((2.0 * 49.0, 2)) > 2.0);
}

#[test]
fn a_covariance_stays_one() {
    let (_, motion) = followed(1e-4, 3000, |t| [100.0 + 900.0 * (5.0 * t).sin(), 50.0]);
    let (_, covariance) = motion.predict(3000.0 * PERIOD_S).moving();
    assert!(covariance.clone().cholesky().is_some(), "{covariance}");
    assert!((covariance.clone() - covariance.transpose()).amax() < 1e-9 * covariance.amax());
}
