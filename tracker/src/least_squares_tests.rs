#![allow(clippy::unwrap_used)]
use nalgebra::{Vector1, Vector2};

use super::*;

#[test]
fn rosenbrocks_valley_is_followed_to_its_end() {
    // r = (10 (y − x²), 1 − x), from where the valley bends the other way.
    let mut points = 0;
    let equations = |at: &Vector2<f64>| {
        points += 1;
        let mut equations = NormalEquations::zero();
        equations.add(-10.0 * (at.y - at.x * at.x), &Vector2::new(-20.0 * at.x, 10.0), 1.0);
        equations.add(1.0 - at.x, &Vector2::new(1.0, 0.0), 1.0);
        Some(equations)
    };
    let found = least_squares(Vector2::new(-1.2, 1.0), 1e-24, equations, |at, by| at + by).unwrap();
    assert!(found.is_converged && (found.point - Vector2::new(1.0, 1.0)).norm() < 1e-10, "{found:?}");
    assert!(points < 40, "{points}");
}

/// Units of the parameters do not change the points that are tried.
#[test]
fn units_do_not_matter() {
    let solved = |unit: f64| {
        let equations = |at: &Vector2<f64>| {
            let (x, mut equations) = (at.x * unit, NormalEquations::zero());
            for place in [0.0, 1.0, 2.0, 3.0] {
                let predicted = (x * place).exp() + at.y;
                let row = Vector2::new(unit * place * (x * place).exp(), 1.0);
                equations.add((0.7 * place).exp() + 2.0 - predicted, &row, 1.0);
            }
            Some(equations)
        };
        let found = least_squares(Vector2::new(0.1 / unit, 0.0), 1e-20, equations, |at, by| at + by).unwrap();
        assert!(found.is_converged);
        Vector2::new(found.point.x * unit, found.point.y)
    };
    assert!((solved(1.0) - Vector2::new(0.7, 2.0)).norm() < 1e-9);
    assert!((solved(1.0) - solved(1e9)).norm() < 1e-9);
}

#[test]
fn of_a_rank_deficient_problem_a_minimum_near_the_start_is_found() {
    // Nothing but the sum of both parameters is measured, and nothing at all of the third.
    let equations = |at: &SVector<f64, 3>| {
        let (sum, mut equations) = (at[0] + at[1], NormalEquations::zero());
        equations.add(9.0 - sum * sum, &SVector::from([2.0 * sum, 2.0 * sum, 0.0]), 1.0);
        Some(equations)
    };
    let found = least_squares(SVector::from([1.0, 0.5, 7.0]), 1e-24, equations, |at, by| at + by).unwrap();
    let [x, y, z]: [f64; 3] = found.point.into();
    assert!(found.is_converged && (x + y - 3.0).abs() < 1e-9 && (x - y - 0.5).abs() < 1e-6 && z == 7.0, "{found:?}");
}

#[test]
fn a_step_to_residuals_that_are_not_finite_is_rejected() {
    // Gauss–Newton leads from 10 to 10 − 10 ln 10, which has no logarithm.
    let logarithm = |at: &Vector1<f64>| {
        let mut equations = NormalEquations::zero();
        equations.add(-at.x.ln(), &Vector1::new(at.x.recip()), 1.0);
        Some(equations)
    };
    let found = least_squares(Vector1::new(10.0), 1e-24, logarithm, |at, by| at + by).unwrap();
    assert!(found.is_converged && (found.point.x - 1.0).abs() < 1e-10, "{found:?}");
    assert!(least_squares(Vector1::new(-1.0), 1e-24, logarithm, |at, by| at + by).is_none());
    // Wherever but at the start there is none.
    let lonely = |at: &Vector1<f64>| logarithm(at).filter(|_| at.x == 10.0);
    let stuck = least_squares(Vector1::new(10.0), 1e-24, lonely, |at, by| at + by).unwrap();
    assert_eq!(stuck.point.x, 10.0);
}
