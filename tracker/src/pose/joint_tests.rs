//! Poses are recovered from exact ellipses.

#![allow(clippy::unwrap_used)]
use super::*;
use crate::camera::Distortion;
use crate::pose::profile::tests::cubic;
use nalgebra::{Rotation3, Vector3};

pub fn lens(model: Distortion, coefficients: &[f64]) -> Intrinsics {
    let coefficients = coefficients.to_vec();
    Intrinsics {
        width: 640,
        height: 480,
        fx: 600.0,
        fy: 600.0,
        cx: 319.5,
        cy: 239.5,
        model,
        coefficients,
        covariance: None,
    }
}

fn spots(positions: &[[f64; 3]]) -> Vec<TargetSpot> {
    let spot = |(i, at): (usize, &[f64; 3])| TargetSpot { name: i.to_string(), position_mm: *at, radius_mm: 30.0 };
    positions.iter().enumerate().map(spot).collect()
}

const FLAT: [[f64; 3]; 3] = [[0.0, 80.0, 0.0], [-70.0, -40.0, 0.0], [70.0, -40.0, 0.0]];
const RAISED: [[f64; 3]; 3] = [[0.0, 80.0, 0.0], [-70.0, -40.0, 0.0], [70.0, -40.0, -40.0]];

fn pose(turn: [f64; 3], at: [f64; 3]) -> Rigid {
    let rotation = Rotation3::new(Vector3::from(turn)).into_inner();
    Rigid { rotation, translation: Vector3::from(at) }
}

fn poses() -> Vec<Rigid> {
    vec![
        pose([0.0, 0.0, 0.0], [0.0, 0.0, 1000.0]),
        pose([0.5, -0.3, 0.4], [100.0, -60.0, 1000.0]),
        pose([-0.2, 0.6, -2.5], [-150.0, 90.0, 700.0]),
        pose([0.03, 0.02, 1.5], [10.0, 20.0, 2500.0]),
        pose([0.7, 0.4, 3.0], [30.0, 10.0, 500.0]),
    ]
}

/// σ of a centre 0.004 px, of the shape's entries 2 · 10⁻⁴ of them.
fn covariance(seen: &[SpotSeen]) -> DMatrix<f64> {
    let n = 5 * seen.len();
    let deviation = |i: usize| if i % 5 < 2 { 0.004 } else { 2e-4 * seen[i / 5].ellipse[2] };
    DMatrix::from_fn(n, n, |i, j| if i == j { deviation(i).powi(2) } else { 0.0 })
}

fn minima(lens: &Intrinsics, target: &[TargetSpot], pose: &Rigid, predict: Predict) -> Vec<Minimum> {
    let seen: Vec<SpotSeen> = target
        .iter()
        .map(|spot| {
            let mut seen = SpotSeen { spot, ellipse: Five::zeros(), profile: Some(cubic(350.0, 255.0)) };
            seen.ellipse = predict(lens, pose, &seen).unwrap();
            seen
        })
        .collect();
    Joint::new(lens, &seen, &covariance(&seen)).unwrap().minima(&|_| Ok(())).unwrap()
}

#[test]
fn three_spots_give_the_pose_whatever_the_lens() {
    let lenses = [
        lens(Distortion::None, &[]),
        lens(Distortion::PlumbBob, &[-0.25, 0.08, 0.001, -0.0005, 0.0]),
        lens(Distortion::Fisheye, &[0.02, -0.005, 0.001, 0.0]),
    ];
    for lens in &lenses {
        for target in [spots(&FLAT), spots(&RAISED)] {
            for pose in poses() {
                let found = minima(lens, &target, &pose, seen_of);
                let best = &found[0];
                let (far, turned) = ((best.pose.translation - pose.translation).norm(), best.pose.angle_to(&pose));
                assert!(far < 1e-3 && turned < 1e-5, "{:?}: {far} mm, {turned} rad of {pose:?}", lens.model);
                assert!(best.chi_square < 1e-3);
                assert!(found[1..].iter().all(|other| other.chi_square > 100.0), "{found:?}");
            }
        }
    }
}

/// Planted fault: the fitted ellipses are taken for outlines of s = 1.
#[test]
fn fitted_ellipses_taken_for_outlines_bias_the_pose() {
    let (lens, pose) = (lens(Distortion::None, &[]), pose([0.5, -0.3, 0.4], [100.0, -60.0, 1000.0]));
    let target = spots(&FLAT);
    let wrong = &minima(&lens, &target, &pose, outline_of)[0];
    let shift = wrong.pose.translation - pose.translation;
    assert!(shift.norm() > 0.05 && wrong.chi_square > 5.0, "{shift:?} {}", wrong.chi_square);
}

#[test]
fn one_and_two_spots_have_ambiguous_poses() {
    let lens = lens(Distortion::None, &[]);
    let pose = pose([0.5, -0.3, 0.0], [100.0, -60.0, 1000.0]);
    let target = spots(&FLAT);
    let found = minima(&lens, &target[..1], &pose, seen_of);
    assert_eq!(found.len(), 2);
    let normal = pose.rotation.column(2).into_owned();
    let centre = pose.apply(target[0].centre());
    let fits = |m: &Minimum| {
        let away = (m.pose.apply(target[0].centre()) - centre).norm();
        away < 1e-2 && (m.pose.rotation.column(2) - normal).norm() < 1e-4
    };
    assert_eq!(found.iter().filter(|m| fits(m)).count(), 1, "{found:?}");
    // The spin has the variance of an unknown angle, the tilt is known.
    let covariance = found[0].information.try_inverse().unwrap();
    let axis = found[0].pose.rotation.column(2).into_owned();
    let spin = (axis.transpose() * covariance.fixed_view::<3, 3>(3, 3) * axis)[0];
    assert!((spin - ANY_ANGLE).abs() < 0.01, "{spin}");

    let found = minima(&lens, &target[..2], &pose, seen_of);
    assert!(found[0].pose.angle_to(&pose) < 1e-4 && found[0].chi_square < 1e-3, "{found:?}");
}

/// Noise drawn from the covariance spreads the poses by their own covariance.
#[test]
fn the_covariance_is_that_of_the_poses() {
    let (lens, pose) = (lens(Distortion::None, &[]), pose([0.5, -0.3, 0.4], [100.0, -60.0, 1000.0]));
    let target = spots(&FLAT);
    let mut noise = crate::picture::Noise(7);
    let exact: Vec<SpotSeen> = target
        .iter()
        .map(|spot| SpotSeen { spot, ellipse: outline(&lens, &pose, spot).unwrap(), profile: None })
        .collect();
    let covariance = covariance(&exact);
    let runs = 300;
    let mut total = 0.0;
    for _ in 0..runs {
        let mut noisy = exact.clone();
        for (i, seen) in noisy.iter_mut().enumerate() {
            for k in 0..5 {
                seen.ellipse[k] += covariance[(5 * i + k, 5 * i + k)].sqrt() * noise.normal();
            }
        }
        let best = Joint::new(&lens, &noisy, &covariance).unwrap().minima(&|_| Ok(())).unwrap()[0];
        let off = best.pose.to(&pose);
        total += off.dot(&(best.information * off));
    }
    let mean = total / f64::from(runs);
    // Six degrees of freedom: σ of the mean is √(12 / 300) = 0.2.
    assert!((mean - 6.0).abs() < 0.8, "{mean}");
}
