#![allow(clippy::unwrap_used)]
use super::*;
use crate::picture::Noise;

const PERIOD_S: f64 = 1.0 / 60.0;

/// A position in two coordinates with a standard deviation of `sigma` px.
fn measured(x: f64, y: f64, sigma: f64) -> Measured {
    Measured { values: DVector::from_vec(vec![x, y]), covariance: DMatrix::identity(2, 2) * (sigma * sigma) }
}

/// Follows x(t), y(t) with seeded noise; returns the mean of yᵀS⁻¹y over the second half of the frames, and the filter.
fn followed(sigma: f64, frames: u32, path: impl Fn(f64) -> [f64; 2]) -> (f64, MotionFilter) {
    let mut noise = Noise(0x5EED);
    let mut seen = |frame: u32| {
        let [x, y] = path(f64::from(frame) * PERIOD_S);
        measured(x + sigma * noise.normal(), y + sigma * noise.normal(), sigma)
    };
    let mut motion = MotionFilter::new(&seen(0), 0.0, None);
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
fn innovations_are_consistent_with_the_filter() {
    let swing = |amplitude: f64| move |t: f64| [300.0 + amplitude * (3.0 * t).sin(), 200.0 + 50.0 * t];
    for (sigma, amplitude) in [(0.1, 0.0), (0.1, 80.0), (0.03, 300.0), (1.0, 80.0)] {
        let (mean, motion) = followed(sigma, 1200, swing(amplitude));
        assert!((1.0..3.5).contains(&mean), "two coordinates, σ {sigma}, {amplitude} px: {mean} {motion:?}");
    }
}

#[test]
fn a_steady_target_is_predicted_through_a_gap() {
    let (_, motion) = followed(0.1, 300, |t| [100.0 + 90.0 * t, 50.0 - 30.0 * t]);
    let (last_s, mut before) = (299.0 * PERIOD_S, 0.0);
    for gap in [1.0, 10.0, 60.0] {
        let time_s = last_s + gap * PERIOD_S;
        let (state, covariance) = motion.predict(time_s).state_with_covariance();
        let off = [state[0] - 100.0 - 90.0 * time_s, state[1] - 50.0 + 30.0 * time_s];
        let deviations = [covariance[(0, 0)].sqrt(), covariance[(1, 1)].sqrt()];
        for (off, deviation) in off.into_iter().zip(deviations) {
            assert!(off.abs() < 4.0 * deviation, "{gap} frames: {off} {deviation}");
        }
        assert!(deviations[0] > before);
        before = deviations[0];
    }
    assert!(before < 1.0, "a second later it is still known to {before} px");
}

#[test]
fn time_steps_may_be_uneven() {
    let path = |t: f64| (20.0 + 120.0 * t, 80.0 + 60.0 * t);
    for q in [Some(500.0), None] {
        let mut motion = MotionFilter::new(&measured(20.0, 80.0, 0.05), 0.0, q);
        let mut time_s = 0.0;
        for step in 0..200 {
            time_s += PERIOD_S * [1.0, 3.0, 0.5, 7.0][step % 4];
            let (x, y) = path(time_s);
            let now = measured(x, y, 0.05);
            assert!(step < 3 || motion.predict(time_s).admits(&now), "step {step}");
            motion.update(&now, time_s);
        }
        let (state, covariance) = motion.predict(time_s).state_with_covariance();
        assert!((state[2] - 120.0).abs() < 5.0 && (state[3] - 60.0).abs() < 5.0, "{state}");
        assert!(covariance[(0, 0)] < 0.05_f64.powi(2), "uneven steps are no jitter: {covariance}");
    }
}

#[test]
fn the_gate_rejects_distant_measurements() {
    let (_, motion) = followed(0.1, 300, |t| [100.0 + 90.0 * t, 50.0]);
    let time_s = 300.0 * PERIOD_S;
    let predicted = motion.predict(time_s);
    let x = 100.0 + 90.0 * time_s;
    assert!(predicted.admits(&measured(x + 0.2, 50.1, 0.1)));
    assert!(!predicted.admits(&measured(x + 40.0, 50.0, 0.1)));
    // χ² with 2 degrees of freedom: the tail beyond g is exp(−g/2).
    let tail = (-0.5 * chi_square(GATE_QUANTILE, 2)).exp();
    assert!((1e-5..1e-4).contains(&tail), "{tail}");
}

#[test]
fn the_covariance_stays_positive_definite() {
    let (_, motion) = followed(1e-4, 3000, |t| [100.0 + 900.0 * (5.0 * t).sin(), 50.0]);
    let (_, covariance) = motion.predict(3000.0 * PERIOD_S).state_with_covariance();
    assert!(covariance.clone().cholesky().is_some(), "{covariance}");
    assert!((covariance.clone() - covariance.transpose()).amax() < 1e-9 * covariance.amax());
}

#[test]
fn learned_levels_survive_a_restart() {
    let mut noise = Noise(7);
    let mut shaken = |at: f64| measured(at + 0.5 * noise.normal(), 50.0, 0.02);
    let mut motion = MotionFilter::new(&shaken(100.0), 0.0, None);
    for frame in 1..200 {
        motion.update(&shaken(100.0), f64::from(frame) * PERIOD_S);
    }
    let time_s = 200.0 * PERIOD_S;
    motion.reset(&shaken(200.0), time_s);
    assert_eq!((motion.measurements, motion.time_s()), (1, time_s));
    let (state, covariance) = motion.predict(time_s).state_with_covariance();
    assert!((state[0] - 200.0).abs() < 2.0 && state[2] == 0.0, "{state}");
    assert!(covariance[(0, 0)] > 0.15 && covariance[(1, 1)] < 0.01, "it still shakes: {covariance}");
    let only = motion.of_positions(&[1]).unwrap();
    assert_eq!(only.predict(time_s).positions_with_covariance().0[0], 50.0);
    assert!(motion.of_positions(&[2]).is_none() && motion.of_positions(&[]).is_none());
}
