//! Levenberg–Marquardt for small nonlinear least-squares problems: calibrations and pose starts.
//!
//! With residuals r = measured − predicted, weights W and the Jacobian J of the prediction, a step δ solves `(A + λ D)
//! δ = JᵀWr` with A = JᵀWJ and D its diagonal, so that units of parameters do not matter (D. Marquardt, 1963). A step
//! is accepted when it achieves a share of the reduction of rᵀWr that the linearised residuals predict, `δᵀJᵀWr + λ
//! δᵀDδ` (J. Moré, 1978); λ follows that share (H. B. Nielsen, 1999).

use nalgebra::{Cholesky, SMatrix, SVector};

/// λ of the first step, a budget: Nielsen's τ for a start that is nearly right.
const DAMPING: f64 = 1e-3;
/// λ at least, derived: `D⁻½AD⁻½ + λ`, whose rounding is N ε < 1e-14, is positive definite whatever the rank of A.
const DAMPING_MIN: f64 = 1e-12;
/// Budget: λ falls to this share after a step that achieves the predicted reduction (Marquardt's 10).
const RELAXED: f64 = 0.1;
/// Budget: λ grows by this factor after a rejected step, and by twice the last factor after each further one (Nielsen).
const RAISED: f64 = 2.0;
/// Budget: least share of the predicted reduction for a step to be accepted: MINPACK's.
const ACHIEVED_MIN: f64 = 1e-4;
/// Budget: trial steps.
const STEPS_MAX: usize = 60;

/// The normal equations of weighted residuals at a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NormalEquations<const N: usize> {
    /// rᵀWr
    pub cost: f64,
    /// JᵀWr
    pub right: SVector<f64, N>,
    /// JᵀWJ
    pub information: SMatrix<f64, N, N>,
}

impl<const N: usize> NormalEquations<N> {
    /// Sums residuals, each with its row of the Jacobian and its weight.
    pub fn of(rows: impl IntoIterator<Item = (f64, SVector<f64, N>, f64)>) -> NormalEquations<N> {
        let zero = NormalEquations { cost: 0.0, right: SVector::zeros(), information: SMatrix::zeros() };
        rows.into_iter().fold(zero, |mut sums, (residual, row, weight)| {
            let weighted = row * weight;
            sums.cost += weight * residual * residual;
            sums.right.axpy(residual, &weighted, 1.0);
            sums.information.ger(1.0, &weighted, &row, 1.0);
            sums
        })
    }

    fn is_finite(&self) -> bool {
        self.cost.is_finite() && self.right.iter().chain(&self.information).all(|number| number.is_finite())
    }

    /// δ and the predicted reduction; `None` when the damped matrix is not positive definite.
    fn step(&self, damping: f64) -> Option<(SVector<f64, N>, f64)> {
        let scale = self.information.diagonal().map(|entry| if entry > 0.0 { entry.sqrt().recip() } else { 1.0 });
        let mut damped = SMatrix::from_fn(|i, j| scale[i] * self.information[(i, j)] * scale[j]);
        for i in 0..N {
            damped[(i, i)] += damping;
        }
        let right = self.right.component_mul(&scale);
        let step = Cholesky::new(damped)?.solve(&right);
        let predicted = step.dot(&right) + damping * step.norm_squared();
        Some((step.component_mul(&scale), predicted))
    }
}

/// Result of a minimisation.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Solution<P, const N: usize> {
    pub point: P,
    /// Normal equations at that point.
    pub equations: NormalEquations<N>,
    /// True when no step is predicted to reduce the cost by more than the tolerance; false when the steps ran out.
    pub is_converged: bool,
}

/// The local minimum reached from `point`: no step is predicted to reduce the cost by more than `tolerance`, or than
/// its rounding. A point without finite equations is rejected; `None` when the first one has none.
pub(crate) fn least_squares<P, const N: usize>(
    mut point: P,
    tolerance: f64,
    mut equations: impl FnMut(&P) -> Option<NormalEquations<N>>,
    moved: impl Fn(&P, &SVector<f64, N>) -> P,
) -> Option<Solution<P, N>> {
    let mut at = |point: &P| equations(point).filter(NormalEquations::is_finite);
    let mut here = at(&point)?;
    let (mut damping, mut raised) = (DAMPING, RAISED);
    for _ in 0..STEPS_MAX {
        let step = here.step(damping);
        if step.is_some_and(|(_, predicted)| predicted <= tolerance.max(f64::EPSILON * here.cost)) {
            return Some(Solution { point, equations: here, is_converged: true });
        }
        let accepted = step.and_then(|(step, predicted)| {
            let trial = moved(&point, &step);
            let next = at(&trial)?;
            let achieved = (here.cost - next.cost) / predicted;
            (achieved >= ACHIEVED_MIN).then_some((trial, next, achieved))
        });
        if let Some((trial, next, achieved)) = accepted {
            (point, here) = (trial, next);
            damping = (damping * (1.0 - (2.0 * achieved - 1.0).powi(3)).max(RELAXED)).max(DAMPING_MIN);
            raised = RAISED;
        } else {
            damping *= raised;
            raised *= 2.0;
        }
    }
    Some(Solution { point, equations: here, is_converged: false })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use nalgebra::{Vector1, Vector2, Vector3};

    use super::*;

    #[test]
    fn rosenbrock_function_is_minimised() {
        // r = (10 (y − x²), 1 − x), from where the valley bends the other way.
        let mut points = 0;
        let equations = |at: &Vector2<f64>| {
            points += 1;
            let valley = (-10.0 * (at.y - at.x * at.x), Vector2::new(-20.0 * at.x, 10.0), 1.0);
            Some(NormalEquations::of([valley, (1.0 - at.x, Vector2::x(), 1.0)]))
        };
        let found = least_squares(Vector2::new(-1.2, 1.0), 1e-24, equations, |at, by| at + by).unwrap();
        assert!(found.is_converged && (found.point - Vector2::new(1.0, 1.0)).norm() < 1e-10, "{found:?}");
        assert!(points < 40, "{points}");
    }

    #[test]
    fn units_of_parameters_do_not_matter() {
        let solved = |unit: f64| {
            let row = |at: &Vector2<f64>, place: f64| {
                let rise = (unit * at.x * place).exp();
                ((0.7 * place).exp() + 2.0 - rise - at.y, Vector2::new(unit * place * rise, 1.0), 1.0)
            };
            let equations =
                |at: &Vector2<f64>| Some(NormalEquations::of([0.0, 1.0, 2.0, 3.0].map(|place| row(at, place))));
            let found = least_squares(Vector2::new(0.1 / unit, 0.0), 1e-20, equations, |at, by| at + by).unwrap();
            assert!(found.is_converged);
            Vector2::new(found.point.x * unit, found.point.y)
        };
        assert!((solved(1.0) - Vector2::new(0.7, 2.0)).norm() < 1e-9);
        assert!((solved(1.0) - solved(1e9)).norm() < 1e-9);
    }

    #[test]
    fn rank_deficient_problem_converges_near_the_start() {
        // Only the sum of two parameters is measured; the third is unconstrained.
        let equations = |at: &Vector3<f64>| {
            let sum = at.x + at.y;
            Some(NormalEquations::of([(9.0 - sum * sum, Vector3::new(2.0 * sum, 2.0 * sum, 0.0), 1.0)]))
        };
        let found = least_squares(Vector3::new(1.0, 0.5, 7.0), 1e-24, equations, |at, by| at + by).unwrap();
        let [x, y, z]: [f64; 3] = found.point.into();
        assert!(
            found.is_converged && (x + y - 3.0).abs() < 1e-9 && (x - y - 0.5).abs() < 1e-6 && z == 7.0,
            "{found:?}"
        );
    }

    #[test]
    fn a_step_to_residuals_that_are_not_finite_is_rejected() {
        // Gauss–Newton leads from 10 to 10 − 10 ln 10, which has no logarithm.
        let logarithm = |at: &Vector1<f64>| Some(NormalEquations::of([(-at.x.ln(), Vector1::new(at.x.recip()), 1.0)]));
        let found = least_squares(Vector1::new(10.0), 1e-24, logarithm, |at, by| at + by).unwrap();
        assert!(found.is_converged && (found.point.x - 1.0).abs() < 1e-10, "{found:?}");
        assert!(least_squares(Vector1::new(-1.0), 1e-24, logarithm, |at, by| at + by).is_none());
        // Equations exist only at the start.
        let lonely = |at: &Vector1<f64>| logarithm(at).filter(|_| at.x == 10.0);
        let stuck = least_squares(Vector1::new(10.0), 1e-24, lonely, |at, by| at + by).unwrap();
        assert_eq!(stuck.point.x, 10.0);
    }
}
