#![allow(clippy::unwrap_used)]
use super::*;

fn quadratic(gradient: &[f64], hessian: &[f64]) -> Quadratic {
    let n = gradient.len();
    Quadratic {
        objective: 0.0,
        gradient: DVector::from_row_slice(gradient),
        hessian: DMatrix::from_row_slice(n, n, hessian),
        curvature: Curvature::Full,
    }
}

fn model(quadratic: &Quadratic, delta: &DVector<f64>) -> f64 {
    quadratic.gradient.dot(delta) + 0.5 * (delta.transpose() * &quadratic.hessian * delta)[0]
}

/// Gradient, Hessian, radius, whether the step should be interior.
type Case = (&'static [f64], &'static [f64], f64, bool);

const CASES: &[Case] = &[
    (&[1.0, -2.0], &[2.0, 0.5, 0.5, 3.0], 10.0, true),
    (&[1.0, -2.0], &[2.0, 0.5, 0.5, 3.0], 0.1, false),
    (&[1.0, 1.0], &[1.0, 0.0, 0.0, -2.0], 1.5, false), // indefinite
    (&[1.0, 0.0], &[4.0, 0.0, 0.0, -1.0], 2.0, false), // indefinite, hard case: no gradient along the lowest vector
    (&[0.0, 0.0], &[1.0, 0.0, 0.0, -1.0], 1.0, false), // a saddle
    (&[1.0, 1.0], &[1.0, 1.0, 1.0, 1.0], 5.0, true),   // singular, gradient in range
    (&[1.0, -1.0], &[1.0, 1.0, 1.0, 1.0], 5.0, false), // singular, gradient out of range: downhill without end
    (&[3.0, 1e-3], &[1e6, 0.0, 0.0, 1e-4], 1e9, true), // ten decades of scale
    (&[1.0], &[-3.0], 0.5, false),
];

#[test]
fn steps_minimise_the_model_within_the_radius() {
    for (number, &(gradient, hessian, radius, interior)) in CASES.iter().enumerate() {
        let quadratic = quadratic(gradient, hessian);
        let n = gradient.len();
        let scale = DVector::from_fn(n, |i, _| quadratic.hessian[(i, i)].abs().sqrt());
        let spectrum = Spectrum::new(&quadratic, &scale, 1e-15).unwrap();
        let step = spectrum.step(radius);
        assert_eq!(step.interior, interior, "case {number}");
        assert!(step.length <= radius * 1.00001, "case {number}: {} > {radius}", step.length);
        let value = model(&quadratic, &step.delta);
        assert!(
            (value + step.reduction).abs() <= 1e-9 * (1.0 + step.reduction),
            "case {number}: says {}, is {value}",
            step.reduction
        );
        assert!((quadratic.gradient.dot(&step.delta) - step.slope).abs() <= 1e-9 * (1.0 + step.slope.abs()));
        // No point of a fine grid over the region is better.
        for k in 0..2000 {
            let angle = k as f64 * 0.7390;
            let r = radius * ((k % 50) as f64 / 49.0);
            let z = if n == 1 {
                DVector::from_element(1, r * angle.cos().signum())
            } else {
                DVector::from_row_slice(&[r * angle.cos(), r * angle.sin()])
            };
            let other = model(&quadratic, &z.component_div(&scale));
            assert!(value <= other + 1e-5 * (1.0 + value.abs()), "case {number}: {value} > {other}");
        }
    }
}

#[test]
fn a_shortened_step_predicts_its_own_reduction() {
    let quadratic = quadratic(&[1.0, 1.0], &[1.0, 0.0, 0.0, -2.0]);
    let spectrum = Spectrum::new(&quadratic, &DVector::from_element(2, 1.0), 1e-15).unwrap();
    let step = spectrum.step(1.5).shortened(0.3);
    assert!((model(&quadratic, &step.delta) + step.reduction).abs() < 1e-12);
}

#[test]
fn rounding_does_not_count_as_indefinite() {
    let is_indefinite = |lowest: f64| {
        Spectrum::new(&quadratic(&[0.0, 0.0], &[1.0, 0.0, 0.0, lowest]), &DVector::from_element(2, 1.0), 1e-7)
            .unwrap()
            .is_indefinite()
    };
    assert!(is_indefinite(-1e-3) && !is_indefinite(-1e-9) && !is_indefinite(1e-3));
}

#[test]
fn undetermined_parameters_have_infinite_variance() {
    let scale = DVector::from_element(3, 1.0);
    let spectrum =
        Spectrum::new(&quadratic(&[0.0; 3], &[1.0, 1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 4.0]), &scale, 1e-15).unwrap();
    let diagonal = spectrum.inverse_diagonal().unwrap();
    assert!(diagonal[0].is_infinite() && diagonal[1].is_infinite());
    assert!((diagonal[2] - 0.25).abs() < 1e-12);
}

#[test]
fn degenerate_parameters_have_large_variances_and_leave_the_others_known() {
    // Columns a, a and b with |a|² = 4, a·b = 1, |b|² = 2.
    let twice = quadratic(&[0.0; 3], &[4.0, 4.0, 1.0, 4.0, 4.0, 1.0, 1.0, 1.0, 2.0]);
    let scale = twice.hessian.diagonal().map(f64::sqrt);
    let spectrum = Spectrum::new(&twice, &scale, 1e-8).unwrap();
    assert!(spectrum.inverse().is_none());
    let inverse = spectrum.clamped_inverse().unwrap();
    assert!((inverse[(2, 2)] - 4.0 / 7.0).abs() < 1e-6, "{inverse}");
    assert!(inverse[(0, 0)] > 1e5 && inverse[(1, 1)] > 1e5, "{inverse}");
    let once = quadratic(&[0.0; 2], &[4.0, 1.0, 1.0, 2.0]);
    let spectrum = Spectrum::new(&once, &once.hessian.diagonal().map(f64::sqrt), 1e-8).unwrap();
    let (plain, clamped) = (spectrum.inverse().unwrap(), spectrum.clamped_inverse().unwrap());
    assert!((plain - clamped).amax() < 1e-12);
}

#[test]
fn the_first_radius_is_the_scaled_length_of_the_point() {
    let hessian = DMatrix::from_row_slice(2, 2, &[4.0, 0.0, 0.0, 9.0]);
    let region = TrustRegion::new(&hessian, &DVector::from_row_slice(&[3.0, 4.0]));
    assert!((region.radius() - (36.0f64 + 144.0).sqrt()).abs() < 1e-12);
}

#[test]
fn the_radius_follows_the_ratio() {
    let quadratic = quadratic(&[1.0, 0.0], &[1.0, 0.0, 0.0, 1.0]);
    let spectrum = Spectrum::new(&quadratic, &DVector::from_element(2, 1.0), 1e-15).unwrap();
    // (actual reduction of F, accepted, radius after), from radius 0.5; the model predicts 0.375.
    for (actual, accepted, radius) in [
        (0.375, true, 1.0),
        (0.2, true, 0.5),
        (0.05, true, 0.5),
        (0.03, true, 0.25),
        (-0.5, false, 0.25),
        (f64::NAN, false, 0.05),
        (f64::NEG_INFINITY, false, 0.05),
    ] {
        let mut region = TrustRegion { largest: DVector::from_element(2, 1.0), radius: 0.5, fresh: false };
        let step = spectrum.step(0.5);
        assert_eq!(region.judge(&step, actual, 0.0), accepted, "{actual}");
        assert!((region.radius() - radius).abs() < 1e-6, "{actual}: {}", region.radius());
    }
}

#[test]
fn gauss_newton_steps_do_not_move_along_undetermined_directions() {
    let mut singular = quadratic(&[1.0, -1.0], &[1.0, 1.0, 1.0, 1.0]);
    singular.curvature = Curvature::GaussNewton;
    let spectrum = Spectrum::new(&singular, &DVector::from_element(2, 1.0), 1e-15).unwrap();
    let step = spectrum.step(5.0);
    assert!(step.interior && step.length < 1e-12 && !spectrum.is_indefinite());
}

#[test]
fn gradients_along_vanishing_eigenvalues_are_used_within_their_bounds() {
    // g = 2 Jᵀr and H = 2 JᵀJ allow |g| ≤ √(2 Λ F): up to 3e-8 where Λ is below 4.4e-16 and F = 1; below 3e-12 it is rounding.
    for (gradient, is_answered) in [(1e-9, true), (1e-13, false), (1e-6, false)] {
        let mut valley = quadratic(&[0.0, gradient], &[1.0, 0.0, 0.0, 1e-18]);
        (valley.curvature, valley.objective) = (Curvature::GaussNewton, 1.0);
        let spectrum = Spectrum::new(&valley, &DVector::from_element(2, 1.0), f64::EPSILON).unwrap();
        let step = spectrum.step(f64::INFINITY);
        let expected = if is_answered { -gradient / (2.0 * f64::EPSILON) } else { 0.0 };
        assert!((step.delta[1] - expected).abs() <= 1e-6 * expected.abs(), "{gradient}: {step:?}");
    }
}

#[test]
fn cholesky_steps_equal_spectral_steps() {
    // From two nearly degenerate parameters to two independent ones.
    let mut clear = 0;
    for power in 0..18 {
        let apart = 10f64.powi(-power);
        let same = 2.0 * (1.0 - apart);
        let mut valley = quadratic(&[3.0, -1.0, 0.5], &[2.0, same, 0.1, same, 2.0, 0.1, 0.1, 0.1, 50.0]);
        valley.curvature = Curvature::GaussNewton;
        valley.objective = 1e30;
        let Some(mut definite) = Definite::of(&valley.hessian) else { continue };
        let spectrum = Spectrum::new(&valley, &definite.scale(), 1e-8).unwrap();
        if !definite.is_clear(1e-8) {
            continue;
        }
        clear += 1;
        assert!(spectrum.values.min() > spectrum.zero, "{apart}: {} of {}", spectrum.values.min(), spectrum.zero);
        let (mut delta, step) = (Vec::new(), spectrum.step(f64::INFINITY));
        let reduction = definite.newton_step(valley.gradient.iter().copied(), &mut delta);
        let delta = DVector::from_vec(delta);
        assert!((&delta - &step.delta).norm() <= 1e-6 * delta.norm(), "{apart}: {delta} {}", step.delta);
        assert!((reduction / step.reduction - 1.0).abs() < 1e-6, "{apart}");
        let unit = definite.inverse() * &valley.hessian - DMatrix::identity(3, 3);
        assert!(unit.amax() < 1e-6, "{apart}: {unit}");
    }
    assert!((4..10).contains(&clear), "{clear} of 18");
}
