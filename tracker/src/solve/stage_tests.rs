#![allow(clippy::unwrap_used)]
use super::*;

/// Runs a stage; returns its report.
fn run<P: CostFunction>(problem: &mut P, rules: &Rules, point: &mut [f64]) -> StageReport {
    super::run(problem, rules, point).report
}

use nalgebra::DMatrix;
use std::sync::Arc;

/// `f(point, pixel)`: the residual, its gradient, its Hessian by rows.
type Residual<'a> = &'a dyn Fn(&[f64], usize) -> (f64, Vec<f64>, Vec<f64>);

/// Residuals in closed form as a cost function.
struct Closed<'a> {
    pixels: usize,
    parameters: usize,
    full: bool,
    f: Residual<'a>,
    inside: &'a dyn Fn(&[f64], usize) -> bool,
    allowed: &'a dyn Fn(&[f64]) -> bool,
}

fn everywhere(_: &[f64], _: usize) -> bool {
    true
}

fn anything(_: &[f64]) -> bool {
    true
}

impl CostFunction for Closed<'_> {
    fn gradient(&mut self, point: &[f64], entry: &[f64], pass: &mut Pass) -> Result<(), Ending> {
        let n = self.parameters;
        let (mut objective, mut gradient, mut hessian, mut pixels) = (0.0, DVector::zeros(n), DMatrix::zeros(n, n), 0);
        for i in (0..self.pixels).filter(|&i| (self.inside)(entry, i)) {
            let (r, d, dd) = (self.f)(point, i);
            objective += r * r;
            pixels += 1;
            for a in 0..n {
                gradient[a] += 2.0 * r * d[a];
                for b in 0..n {
                    hessian[(a, b)] += 2.0 * d[a] * d[b] + if self.full { 2.0 * r * dd[a * n + b] } else { 0.0 };
                }
            }
        }
        let curvature = if self.full { Curvature::Full } else { Curvature::GaussNewton };
        *pass = Pass { quadratic: Quadratic { objective, gradient, hessian, curvature }, pixels };
        Ok(())
    }

    fn allowed(&self, point: &[f64]) -> bool {
        (self.allowed)(point)
    }
}

fn rules(parameters: usize, window_pixels: u64) -> Rules {
    Rules {
        free: (0..parameters).collect(),
        bounds: vec![[f64::NEG_INFINITY, f64::INFINITY]; parameters].into(),
        position_rows: Arc::default(),
        iterations: 200,
        tolerance: 1e-3,
        noise: false,
        renewal: Renewal::ByRound,
        has_domain: true,
        converges_fully: true,
        precision: Precision::F64,
        rounding: 0.0,
        rounding_variance: 0.0,
        is_traced: false,
        window_pixels,
    }
}

/// Rosenbrock's valley as two residuals: 10 (y − x²), 1 − x.
fn rosenbrock(u: &[f64], i: usize) -> (f64, Vec<f64>, Vec<f64>) {
    match i {
        0 => (10.0 * (u[1] - u[0] * u[0]), vec![-20.0 * u[0], 10.0], vec![-20.0, 0.0, 0.0, 0.0]),
        _ => (1.0 - u[0], vec![-1.0, 0.0], vec![0.0; 4]),
    }
}

#[test]
fn rosenbrock_by_either_hessian() {
    for full in [false, true] {
        for start in [[-1.2, 1.0], [10.0, -10.0], [0.0, 0.0]] {
            let mut problem =
                Closed { pixels: 2, parameters: 2, full, f: &rosenbrock, inside: &everywhere, allowed: &anything };
            let mut point = start.to_vec();
            let report = run(&mut problem, &rules(2, 2), &mut point);
            assert_eq!(report.ending, Ending::SmallStep, "full {full} {start:?}");
            assert!((point[0] - 1.0).abs() < 1e-9 && (point[1] - 1.0).abs() < 1e-9, "full {full} {start:?}: {point:?}");
        }
    }
}

/// NIST's Misra1a: y = b1 (1 − exp(−b2 x)), its 14 observations.
const MISRA1A: [(f64, f64); 14] = [
    (77.6, 10.07),
    (114.9, 14.73),
    (141.1, 17.94),
    (190.8, 23.93),
    (239.9, 29.61),
    (289.0, 35.18),
    (332.8, 40.02),
    (378.4, 44.82),
    (434.8, 50.76),
    (477.3, 55.05),
    (536.8, 61.01),
    (593.1, 66.40),
    (689.1, 75.47),
    (760.0, 81.78),
];

fn misra1a(u: &[f64], i: usize) -> (f64, Vec<f64>, Vec<f64>) {
    let (x, y) = MISRA1A[i];
    let e = (-u[1] * x).exp();
    (y - u[0] * (1.0 - e), vec![-(1.0 - e), -u[0] * x * e], vec![0.0, -x * e, -x * e, u[0] * x * x * e])
}

#[test]
fn misra1a_from_both_starts() {
    for full in [false, true] {
        for start in [[500.0, 0.0001], [250.0, 0.0005]] {
            let mut problem =
                Closed { pixels: 14, parameters: 2, full, f: &misra1a, inside: &everywhere, allowed: &anything };
            let mut point = start.to_vec();
            let report = run(&mut problem, &Rules { tolerance: 1e-7, ..rules(2, 14) }, &mut point);
            assert_eq!(report.ending, Ending::SmallStep);
            assert!((point[0] / 2.389_421_291_8e2 - 1.0).abs() < 1e-8, "full {full} {point:?}");
            assert!((point[1] / 5.501_564_318_1e-4 - 1.0).abs() < 1e-8, "full {full} {point:?}");
        }
    }
}

/// A dip of known depth and width at an unknown position: beyond its inflection the full Hessian is negative.
fn dip(u: &[f64], i: usize) -> (f64, Vec<f64>, Vec<f64>) {
    let gauss = |x: f64| (-0.5 * x * x).exp();
    let d = (i as f64 - u[0]) / 4.0;
    let (observed, value) = (gauss((i as f64 - 30.0) / 4.0), gauss(d));
    (observed - value, vec![-value * d / 4.0], vec![-value * (d * d - 1.0) / 16.0])
}

#[test]
fn indefinite_steps_are_counted_and_overcome() {
    let mut problem =
        Closed { pixels: 60, parameters: 1, full: true, f: &dip, inside: &everywhere, allowed: &anything };
    let mut point = vec![38.0];
    let report = run(&mut problem, &rules(1, 60), &mut point);
    assert!(report.indefinite_steps >= 1, "{report:?}");
    assert_eq!(report.ending, Ending::SmallStep);
    assert!((point[0] - 30.0).abs() < 1e-8, "{point:?}");
}

#[test]
fn a_bounded_parameter_ends_at_its_bound_and_the_others_at_their_minimum() {
    // Minimum at (−3, 4); with the first ≥ 0 the other becomes 4 − 3/2.
    let f = |u: &[f64], i: usize| match i {
        0 => (u[0] + u[1] - 1.0, vec![1.0, 1.0], vec![0.0; 4]),
        _ => (u[1] - 4.0, vec![0.0, 1.0], vec![0.0; 4]),
    };
    for start in [[5.0, 0.0], [0.1, 100.0], [0.0, -7.0]] {
        let mut problem =
            Closed { pixels: 2, parameters: 2, full: false, f: &f, inside: &everywhere, allowed: &anything };
        let mut point = start.to_vec();
        let bounds = vec![[0.0, 9.0], [-1e3, 1e3]].into();
        let report = run(&mut problem, &Rules { bounds, ..rules(2, 2) }, &mut point);
        assert_eq!(report.ending, Ending::SmallStep, "{start:?}: {report:?}");
        assert!(point[0] == 0.0 && (point[1] - 2.5).abs() < 1e-9, "{start:?}: {point:?}");
        assert!(report.passes < 10, "{start:?}: {report:?}");
    }
}

#[test]
fn a_bound_without_a_value_is_approached() {
    // No value at 0, where F would be least: by the formula, and by a constraint.
    let f = |u: &[f64], i: usize| {
        let root = (0.1 * i as f64 + u[0].ln()) * 1e-3;
        (u[0] + 3.0 + root, vec![1.0 + 1e-3 / u[0]], vec![0.0])
    };
    let plain = |u: &[f64], _: usize| (u[0] + 3.0, vec![1.0], vec![0.0]);
    let positive = |u: &[f64]| u[0] > 0.0;
    for (f, allowed) in [(&f as Residual, &anything as &dyn Fn(&[f64]) -> bool), (&plain, &positive)] {
        let mut problem = Closed { pixels: 9, parameters: 1, full: false, f, inside: &everywhere, allowed };
        let mut point = vec![5.0];
        let bounds = vec![[0.0, f64::INFINITY]].into();
        let report = run(&mut problem, &Rules { bounds, ..rules(1, 9) }, &mut point);
        assert!(point[0] > 0.0 && point[0] < 1e-2 && report.ending.is_fit(), "{point:?} {report:?}");
    }
}

#[test]
fn the_last_round_with_enough_pixels_is_the_result() {
    // The domain is the pixels below the parameter, and the fit pulls the parameter down to −5.
    let f = |u: &[f64], _: usize| (u[0] + 5.0, vec![1.0], vec![0.0]);
    let mut problem = Closed {
        pixels: 1000,
        parameters: 1,
        full: false,
        f: &f,
        inside: &|u, i| (i as f64) < u[0],
        allowed: &anything,
    };
    let mut point = vec![900.0];
    let report = run(&mut problem, &rules(1, 1000), &mut point);
    assert_eq!(report.ending, Ending::SmallStep);
    assert!(report.domain_shrank() && report.pixels_first == 900 && report.pixels_least < 18, "{report:?}");
    assert!((point[0] + 5.0).abs() < 1e-9, "{point:?}");
    // A start without pixels fails.
    let mut point = vec![1.0];
    assert_eq!(run(&mut problem, &rules(1, 1000), &mut point).ending, Ending::DomainVanished);
}

#[test]
fn small_data_sets_do_not_count_as_vanished_domains() {
    let f = |u: &[f64], i: usize| (u[0] - i as f64, vec![1.0], vec![0.0]);
    let mut problem = Closed { pixels: 5, parameters: 1, full: false, f: &f, inside: &everywhere, allowed: &anything };
    let mut point = vec![9.0];
    assert_eq!(run(&mut problem, &rules(1, 5), &mut point).ending, Ending::SmallStep);
    assert!((point[0] - 2.0).abs() < 1e-12);
}

#[test]
fn non_finite_steps_are_retracted() {
    // F is NaN above 2; the first full step from 0.1 would land far beyond.
    let f = |u: &[f64], i: usize| {
        let r = (2.0 - u[0]).sqrt() - 1.0 - 1e-3 * (i as f64 - 4.0);
        (r, vec![-0.5 / (2.0 - u[0]).sqrt()], vec![0.0])
    };
    let mut problem = Closed { pixels: 9, parameters: 1, full: false, f: &f, inside: &everywhere, allowed: &anything };
    let mut point = vec![-30.0];
    assert_eq!(run(&mut problem, &rules(1, 9), &mut point).ending, Ending::SmallStep);
    assert!((point[0] - 1.0).abs() < 1e-3, "{point:?}");
    let mut point = vec![3.0];
    assert_eq!(run(&mut problem, &rules(1, 9), &mut point).ending, Ending::NonFinite);
    assert_eq!(point, [3.0]);
}

#[test]
fn a_parameter_without_effect_does_not_move() {
    let f =
        |u: &[f64], i: usize| (u[0] * u[0] - 4.0 - 1e-2 * i as f64, vec![2.0 * u[0], 0.0], vec![2.0, 0.0, 0.0, 0.0]);
    let mut problem = Closed { pixels: 20, parameters: 2, full: false, f: &f, inside: &everywhere, allowed: &anything };
    let mut point = vec![1.0, 7.0];
    assert_eq!(run(&mut problem, &rules(2, 20), &mut point).ending, Ending::SmallStep);
    assert_eq!(point[1], 7.0);
}

#[test]
fn the_iteration_limit_leaves_the_best_point() {
    let mut problem =
        Closed { pixels: 2, parameters: 2, full: false, f: &rosenbrock, inside: &everywhere, allowed: &anything };
    let mut point = vec![-1.2, 1.0];
    let value = |u: &[f64]| (0..2).map(|i| rosenbrock(u, i).0.powi(2)).sum::<f64>();
    let before = value(&point);
    let report = run(&mut problem, &Rules { iterations: 3, is_traced: true, ..rules(2, 2) }, &mut point);
    assert_eq!((report.iterations, report.ending), (3, Ending::IterationLimit));
    let [start, steps @ ..] = &report.trace[..] else { panic!("no trace") };
    assert_eq!((start.objective, start.radius, start.ratio, steps.len()), (before, None, None, 3));
    assert!(steps.iter().all(|step| step.radius.is_some() && step.ratio.is_some()), "{steps:?}");
    assert!(value(&point) < before);
}

#[test]
fn a_kink_at_the_minimum_converges() {
    // A tent |i − u| seen by pixels: the derivative of pixel 20's residual jumps where the minimum is.
    let f = |u: &[f64], i: usize| {
        let side = if (i as f64) < u[0] { 1.0 } else { -1.0 };
        let noise = 0.3 * (7.7 * i as f64).sin();
        ((i as f64 - 20.0).abs() + noise - (i as f64 - u[0]).abs(), vec![-side], vec![0.0])
    };
    for start in [19.3, 20.4, 23.0, 11.0] {
        let mut problem =
            Closed { pixels: 41, parameters: 1, full: false, f: &f, inside: &everywhere, allowed: &anything };
        let mut point = vec![start];
        let rules = Rules { iterations: 50, ..rules(1, 41) };
        let report = run(&mut problem, &rules, &mut point);
        assert_eq!(report.ending, Ending::SmallStep, "{start}: {point:?} {report:?}");
        assert!((point[0] - 20.0).abs() < 0.1, "{start}: {point:?} {report:?}");
    }
}

/// Noise that no model explains, so that F is far from 0 at its minimum.
fn scatter(i: usize) -> f64 {
    0.3 * (7.7 * i as f64).sin()
}

/// Sums with an error that alternates from point to point, as large as rounding in single precision.
struct Rounded<'a>(Closed<'a>);

impl CostFunction for Rounded<'_> {
    fn gradient(&mut self, point: &[f64], entry: &[f64], pass: &mut Pass) -> Result<(), Ending> {
        self.0.gradient(point, entry, pass)?;
        pass.quadratic.objective *= 1.0 + 4e-8 * (1e9 * point[0]).sin();
        Ok(())
    }

    fn allowed(&self, _: &[f64]) -> bool {
        true
    }
}

#[test]
fn a_minimum_hidden_by_rounding_is_accepted() {
    let f = |u: &[f64], i: usize| (u[0] - scatter(i), vec![1.0], vec![0.0]);
    for start in [1.0, 1e-3, 1e-5] {
        let closed = Closed { pixels: 40, parameters: 1, full: false, f: &f, inside: &everywhere, allowed: &anything };
        let mut point = vec![start];
        let rules = Rules { precision: Precision::F32, tolerance: 1e-7, ..rules(1, 40) };
        let report = run(&mut Rounded(closed), &rules, &mut point);
        assert!(report.ending.is_fit(), "{start}: {report:?}");
    }
}

#[test]
fn a_cancelled_pass_ends_the_stage_at_its_best_point() {
    // Passes are cancelled after a given number.
    struct Stopping<'a>(Closed<'a>, u32);
    impl Stopping<'_> {
        fn spend(&mut self) -> Result<(), Ending> {
            self.1 = self.1.checked_sub(1).ok_or(Ending::Cancelled)?;
            Ok(())
        }
    }
    impl CostFunction for Stopping<'_> {
        fn gradient(&mut self, point: &[f64], entry: &[f64], pass: &mut Pass) -> Result<(), Ending> {
            self.spend()?;
            self.0.gradient(point, entry, pass)
        }
        fn allowed(&self, _: &[f64]) -> bool {
            true
        }
    }
    for passes in 0..12 {
        let closed =
            Closed { pixels: 2, parameters: 2, full: false, f: &rosenbrock, inside: &everywhere, allowed: &anything };
        let mut point = vec![-1.2, 1.0];
        let report = run(&mut Stopping(closed, passes), &rules(2, 2), &mut point);
        assert_eq!(report.ending, Ending::Cancelled, "{passes}");
        assert!(rosenbrock(&point, 0).0.powi(2) + rosenbrock(&point, 1).0.powi(2) <= 24.2 + 1e-9, "{point:?}");
    }
}

#[test]
fn a_start_without_derivatives_is_displaced() {
    // At 3 exactly F is known, but a root has no slope there.
    let f = |u: &[f64], i: usize| {
        let slope = if u[0] == 3.0 { f64::INFINITY } else { 1.0 };
        (u[0] - 1.0 - 1e-3 * (i as f64 - 4.0), vec![slope], vec![0.0])
    };
    let mut problem = Closed { pixels: 9, parameters: 1, full: false, f: &f, inside: &everywhere, allowed: &anything };
    let mut point = vec![3.0];
    assert_eq!(run(&mut problem, &rules(1, 9), &mut point).ending, Ending::SmallStep);
    assert!((point[0] - 1.0).abs() < 1e-3, "{point:?}");
}
