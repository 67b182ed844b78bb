//! Consistency of predictions: the mean squared error over the variance (NEES) along synthetic paths.
#![allow(clippy::unwrap_used)]
use super::*;
use crate::picture::Noise;

const TAU: f64 = std::f64::consts::TAU;

/// The position at a time.
type Path = Box<dyn Fn(f64, &mut Noise) -> f64>;

/// A path and its measurement noise.
struct Case {
    name: &'static str,
    path: Path,
    /// Standard deviation of a measurement, px.
    sigma: f64,
    /// Time of a sudden change.
    step_s: Option<f64>,
}

/// Errors of predictions along a path.
#[derive(Debug)]
struct Found {
    /// 0.1 s and 0.5 s ahead.
    nees: [f64; 2],
    /// Root mean square errors of predictions of the next frame, and of the last measurement in their stead.
    next_px: f64,
    last_px: f64,
}

fn cases() -> Vec<Case> {
    let case = |name, sigma, path: Path| Case { name, path, sigma, step_s: None };
    let uniform = |noise: &mut Noise| 2.0 * noise.uniform() - 1.0;
    let mut all = vec![
        case("still", 0.02, Box::new(|_, _| 100.3)),
        case("still, precise", 0.002, Box::new(|_, _| 100.3)),
        case("jitter ±1", 0.02, Box::new(move |_, noise| 100.0 + uniform(noise))),
        case("jitter 0.3", 0.02, Box::new(|_, noise| 100.0 + 0.3 * noise.normal())),
        case("jitter ±1, moving", 0.02, Box::new(move |t, noise| 60.0 * t + uniform(noise))),
        case("swing", 0.02, Box::new(|t, _| 320.0 + 80.0 * (TAU * 0.2 * t).sin())),
        case("swing, fast", 0.02, Box::new(|t, _| 320.0 + 70.0 * (2.5 * t).sin())),
    ];
    for (name, speed) in [("10 px/s", 10.0), ("120 px/s", 120.0), ("600 px/s", 600.0)] {
        all.push(case(name, 0.02, Box::new(move |t, _| speed * t)));
    }
    for (name, acceleration) in [("20 px/s²", 20.0), ("200 px/s²", 200.0), ("1000 px/s²", 1000.0)] {
        all.push(case(name, 0.02, Box::new(move |t, _| 0.5 * acceleration * t * t)));
    }
    let turned = |t: f64, _: &mut Noise| 50.0 * t - 150.0 * (t - 3.0).max(0.0);
    all.push(Case { step_s: Some(3.0), ..case("velocity step", 0.02, Box::new(turned)) });
    all
}

/// Follows a path for six seconds, several times.
fn followed(case: &Case, rate_hz: f64, runs: u64) -> Found {
    let (mut sums, mut counts) = ([0.0; 2], [0.0; 2]);
    let (mut next, mut last, mut frames) = (0.0, 0.0, 0.0);
    for run in 0..runs {
        let mut noise = Noise(0x1234_5678_9ABC + 7919 * run);
        let count = (6.0 * rate_hz) as usize;
        let time_s = |frame: usize| frame as f64 / rate_hz;
        let truth: Vec<f64> = (0..count).map(|frame| (case.path)(time_s(frame), &mut noise)).collect();
        let seen: Vec<f64> = truth.iter().map(|at| at + case.sigma * noise.normal()).collect();
        let variance = case.sigma * case.sigma;
        let step = case.step_s.map(|step_s| (step_s * rate_hz) as usize);
        let mut coordinate = Coordinate::new(seen[0], variance, 0.0, None);
        for frame in 1..count {
            if frame > 30 {
                next += (coordinate.predict(time_s(frame)).position - seen[frame]).powi(2);
                last += (seen[frame - 1] - seen[frame]).powi(2);
                frames += 1.0;
            }
            coordinate.update(seen[frame], variance, time_s(frame));
            for (number, ahead_s) in [0.1, 0.5].into_iter().enumerate() {
                let then = frame + (ahead_s * rate_hz).round() as usize;
                // A step is not predictable before it, nor in the two frames that show it.
                let is_struck = step.is_some_and(|step| frame < step + 2 && then >= step);
                if time_s(frame) < 0.7 || then >= count || is_struck {
                    continue;
                }
                let predicted = coordinate.predict(time_s(then));
                sums[number] += (predicted.position - truth[then]).powi(2) / predicted.variance;
                counts[number] += 1.0;
            }
        }
    }
    let nees = [sums[0] / counts[0], sums[1] / counts[1]];
    Found { nees, next_px: f64::sqrt(next / frames), last_px: f64::sqrt(last / frames) }
}

/// `ISOPHOTE_PREDICTION_RUNS=20` makes more runs of each, for figures.
#[test]
fn predictions_are_consistent() {
    let runs = std::env::var("ISOPHOTE_PREDICTION_RUNS").ok().and_then(|runs| runs.parse().ok()).unwrap_or(8);
    let mut wrong = Vec::new();
    for case in cases() {
        for rate_hz in [30.0, 60.0, 200.0] {
            let found = followed(&case, rate_hz, runs);
            let [near, far] = found.nees;
            eprintln!(
                "{:18} {rate_hz:3} Hz: NEES {near:.2} at 0.1 s, {far:.2} at 0.5 s; next frame {:.3} px off, last {:.3}",
                case.name, found.next_px, found.last_px
            );
            if !found.nees.iter().all(|nees| (0.5..=2.0).contains(nees)) {
                wrong.push(format!("{} at {rate_hz} Hz: {found:?}", case.name));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// A filter with acceleration that is constant through a step rings: it predicts the next frame worse than the last measurement.
#[test]
fn a_prediction_is_no_worse_than_the_last_measurement() {
    for case in cases() {
        let found = followed(&case, 60.0, 4);
        assert!(found.next_px < 1.05 * found.last_px, "{}: {found:?}", case.name);
    }
}

#[test]
fn many_short_steps_equal_one_long_step() {
    let mut noise = Noise(3);
    let state = KalmanState::new(10.0, 0.04, 30.0);
    for q in [0.0, 7.0, 3e4] {
        let long = state.after(0.5, q);
        let short = (0..30).fold(state, |state, _| state.after(0.5 / 30.0, q));
        let close = |a: f64, b: f64| (a - b).abs() <= 1e-9 * a.abs().max(1.0);
        assert!(close(long.variance, short.variance) && close(long.covariance, short.covariance), "{long:?} {short:?}");
        assert!(close(long.velocity_variance, short.velocity_variance), "{long:?} {short:?}");
    }
    // A given density is used unchanged, over any time.
    let mut coordinate = Coordinate::new(0.0, 1e-4, 0.0, Some(300.0));
    for frame in 1..100 {
        coordinate.update(0.01 * noise.normal(), 1e-4, f64::from(frame) / 60.0);
    }
    let (near, far) = (coordinate.predict(99.0 / 60.0), coordinate.predict(99.0 / 60.0 + 0.5));
    let jitter = coordinate.jitter.level();
    let expected = KalmanState { variance: near.variance - jitter, ..near }.after(0.5, 300.0).variance + jitter;
    assert!((far.variance / expected - 1.0).abs() < 1e-9, "{far:?} {expected}");
}

#[test]
fn variance_grows_with_the_horizon() {
    for case in cases() {
        let mut noise = Noise(11);
        let mut coordinate = Coordinate::new((case.path)(0.0, &mut noise), 4e-4, 0.0, None);
        for frame in 1..240 {
            let time_s = f64::from(frame) / 60.0;
            coordinate.update((case.path)(time_s, &mut noise), 4e-4, time_s);
        }
        let ahead: Vec<f64> =
            (0..60).map(|n| coordinate.predict(239.0 / 60.0 + 0.01 * f64::from(n)).variance).collect();
        assert!(ahead.windows(2).all(|pair| pair[1] >= pair[0]), "{}: {ahead:?}", case.name);
    }
}

/// Fits do not start from predictions that have been worse than none.
#[test]
fn overshooting_predictions_are_noticed() {
    // A random walk, taken for a steady one: each step is overshot.
    let mut noise = Noise(5);
    let mut at = 0.0;
    let mut overshooting = Coordinate::new(at, 1e-4, 0.0, Some(1e8));
    assert!(overshooting.predicts_well());
    let mut noticed = 0;
    for frame in 1..200 {
        at += noise.normal();
        overshooting.update(at, 1e-4, f64::from(frame) / 60.0);
        noticed += u32::from(!overshooting.predicts_well());
    }
    assert!(noticed > 150, "{noticed} {overshooting:?}");
}
