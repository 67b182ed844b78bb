//! Small nonlinear least-squares problems, by Levenberg–Marquardt: calibrations and the starts of poses.
//!
//! What comes in: a point, and the normal equations of the residuals at any point. What goes out: a local minimum of the weighted
//! sum of their squares. It never knows what is measured.
//!
//! With the residuals r = measured − predicted, their weights W and J the derivatives of what is predicted, a step δ solves
//! `(A + λ D) δ = JᵀWr` with A = JᵀWJ and D its diagonal, so that the units of the parameters do not matter (D. Marquardt, 1963).
//! It is accepted where it achieves a share of the reduction of rᵀWr that the linearised residuals predict, `δᵀJᵀWr + λ δᵀDδ`
//! (J. Moré, 1978), and λ follows that share (H. B. Nielsen, 1999).

use nalgebra::{Cholesky, SMatrix, SVector};

/// λ of the first step: a thousandth from Gauss–Newton, so that a good start is hardly damped.
const DAMPING: f64 = 1e-3;
/// λ at least: with it `D⁻½AD⁻½ + λ`, which is of rounding ε, is positive definite whatever the rank of A.
const DAMPING_MIN: f64 = 1e-12;
/// λ becomes so many times itself after a step that achieves what was predicted.
const RELAXED: f64 = 0.1;
/// λ becomes so many times itself after a step that is rejected, and twice as many times after each further one.
const RAISED: f64 = 2.0;
/// The share of the predicted reduction with which a step is accepted: any that is more than rounding.
const ACHIEVED_MIN: f64 = 1e-4;
/// Budget: steps that are tried.
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
    /// Of no residuals.
    pub fn zero() -> NormalEquations<N> {
        NormalEquations { cost: 0.0, right: SVector::zeros(), information: SMatrix::zeros() }
    }

    /// Adds a residual, its row of the Jacobian and its weight.
    pub fn add(&mut self, residual: f64, row: &SVector<f64, N>, weight: f64) {
        let weighted = row * weight;
        self.cost += weight * residual * residual;
        self.right.axpy(residual, &weighted, 1.0);
        self.information.ger(1.0, &weighted, row, 1.0);
    }

    fn is_finite(&self) -> bool {
        self.cost.is_finite() && self.right.iter().chain(&self.information).all(|number| number.is_finite())
    }

    /// δ and the predicted reduction; `None` where the damping does not suffice.
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

/// Where a search ended.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Solution<P, const N: usize> {
    pub point: P,
    /// At that point.
    pub equations: NormalEquations<N>,
    /// No step is predicted to reduce the cost by more than was asked; else the steps have run out.
    pub is_converged: bool,
}

/// The local minimum that `point` leads to, found when no step is predicted to reduce the cost by more than `tolerance`, or than its
/// rounding. A point without equations, or with some that are not finite, is worse than any; `None` where the first one is.
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
#[path = "least_squares_tests.rs"]
mod tests;
