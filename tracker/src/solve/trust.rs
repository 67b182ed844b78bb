//! The trust region: steps δ by a quadratic model of F, and the acceptance of each.
//!
//! The step minimises `m(δ) = gᵀδ + ½ δᵀHδ` subject to `‖D δ‖ ≤ Δ`, exactly, by the eigenvalues of the scaled Hessian
//! `D⁻¹HD⁻¹`; an indefinite H is no special case. `D` is the running maximum of `√|H_ii|` (Jacobi scaling, as in MINPACK),
//! the first radius is `1·‖D u‖`: with 10 or 100 instead some NIST problems fail (notes, "Numerical solvers"). Bounds are
//! handled by the caller.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use crate::scaled::{Definite, scaled};

/// Which second derivatives H holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Curvature {
    /// 2 JᵀWJ: positive semidefinite up to rounding, and the gradient lies in its range.
    GaussNewton,
    /// All of them; may be indefinite.
    Full,
}

/// `F(u + δ) ≈ F + gᵀδ + ½ δᵀHδ` near one point.
#[derive(Clone, Debug, PartialEq)]
pub struct Quadratic {
    /// F at the point.
    pub objective: f64,
    /// g = dF/du.
    pub gradient: DVector<f64>,
    /// H, symmetric.
    pub hessian: DMatrix<f64>,
    /// The kind of H.
    pub curvature: Curvature,
}

impl Quadratic {
    /// True when all entries are finite.
    pub fn is_finite(&self) -> bool {
        self.objective.is_finite()
            && self.gradient.as_slice().iter().all(|x| x.is_finite())
            && self.hessian.as_slice().iter().all(|x| x.is_finite())
    }
}

/// Ratio of actual to predicted reduction below which a step is refused.
const ACCEPT: f64 = 1e-4;
/// First radius over `‖D u‖`.
const FIRST_RADIUS: f64 = 1.0;
/// Most iterations of the secular equation; each at least halves the bracket.
const SECULAR_ROUNDS: usize = 100;
/// Most sweeps of the eigenvalue iteration, per parameter.
const EIGEN_SWEEPS: usize = 200;
/// Rounding of a scaled gradient's entry, over that of a scaled eigenvalue.
const GRADIENT_ROUNDING: f64 = 1e4;
/// A scaled eigenvalue below −(this) of the largest magnitude makes H indefinite; above it is rounding of the sums.
const INDEFINITE: f64 = 1e-6;

/// The eigendecomposition of H in scaled coordinates `z = D δ`: `D⁻¹HD⁻¹ = Q Λ Qᵀ`.
pub(crate) struct Spectrum {
    /// D⁻¹HD⁻¹.
    scaled: DMatrix<f64>,
    /// Λ.
    values: DVector<f64>,
    /// Q, one column per eigenvalue.
    vectors: DMatrix<f64>,
    /// Qᵀ D⁻¹ g.
    gradient: DVector<f64>,
    /// The diagonal of D.
    scale: DVector<f64>,
    /// Smaller eigenvalues cannot be distinguished from zero.
    zero: f64,
    /// Which entries of `gradient` along those are real.
    answered: Answered,
}

/// How steps treat gradients along eigenvalues that cannot be distinguished from zero.
#[derive(Clone, Copy)]
enum Answered {
    /// The first is the rounding floor; the second the bound by `g = 2 Jᵀr`, `H = 2 JᵀJ`: along a unit eigenvector q,
    /// `|gᵀq| ≤ 2 ‖Jq‖ ‖r‖ = √(2 Λ F)`, and anything larger is rounding again. The eigenvalue is lost in the rounding of H,
    /// but a gradient is known √Λ times better: between the two the step uses the largest possible eigenvalue. So a fit
    /// creeps along a valley (NIST's MGH17, where two exponentials have merged) instead of ending in it.
    Within(f64, f64),
    /// Those above this are real; the step goes as far as the region allows.
    Above(f64),
}

/// One minimiser of the quadratic model inside the trust region.
#[derive(Clone, Debug)]
pub(crate) struct TrustStep {
    /// δ.
    pub delta: DVector<f64>,
    /// `‖D δ‖`.
    pub length: f64,
    /// `−m(δ)` ≥ 0: the predicted reduction of F.
    pub reduction: f64,
    /// `gᵀδ` ≤ 0.
    pub slope: f64,
    /// True when the radius is inactive: δ = −H⁻¹g.
    pub interior: bool,
}

impl TrustStep {
    /// The step scaled by `t` (0 < t ≤ 1), with `m(tδ) = t gᵀδ + t² (m(δ) − gᵀδ)`.
    pub fn shortened(&self, t: f64) -> TrustStep {
        let curvature = -self.reduction - self.slope;
        TrustStep {
            delta: &self.delta * t,
            length: self.length * t,
            slope: self.slope * t,
            reduction: -(t * self.slope + t * t * curvature),
            interior: false,
        }
    }
}

impl Spectrum {
    /// `None` when the eigenvalues do not converge (H is not finite).
    pub fn new(quadratic: &Quadratic, scale: &DVector<f64>, resolution: f64) -> Option<Spectrum> {
        let n = scale.len();
        let scaled = scaled(&quadratic.hessian, scale);
        if !scaled.iter().all(|x| x.is_finite()) {
            return None;
        }
        let eigen = SymmetricEigen::try_new(scaled.clone(), f64::EPSILON, EIGEN_SWEEPS * n.max(1))?;
        let gradient = eigen.eigenvectors.tr_mul(&quadratic.gradient.component_div(scale));
        let largest = eigen.eigenvalues.amax();
        let zero = largest * resolution * n as f64;
        let answered = match quadratic.curvature {
            Curvature::GaussNewton => {
                let objective = quadratic.objective.max(0.0);
                let bound = |eigenvalue: f64| (2.0 * eigenvalue * objective).sqrt();
                Answered::Within(GRADIENT_ROUNDING * resolution * bound(largest), bound(zero))
            }
            Curvature::Full => Answered::Above(gradient.amax() * f64::EPSILON),
        };
        let values = match quadratic.curvature {
            Curvature::GaussNewton => eigen.eigenvalues.map(|value| value.max(0.0)), // below zero by rounding only
            Curvature::Full => eigen.eigenvalues,
        };
        Some(Spectrum { scaled, values, vectors: eigen.eigenvectors, gradient, scale: scale.clone(), zero, answered })
    }

    /// True when F has negative curvature in some direction.
    pub fn is_indefinite(&self) -> bool {
        self.values.min() < -INDEFINITE * self.values.amax()
    }

    /// The diagonal of H⁻¹; infinite for a parameter that a vanishing eigenvalue leaves undetermined, `None` when H is
    /// indefinite.
    pub fn inverse_diagonal(&self) -> Option<DVector<f64>> {
        if self.is_indefinite() {
            return None;
        }
        let entry = |i: usize| {
            let term = |k: usize| {
                let share = self.vectors[(i, k)] * self.vectors[(i, k)];
                match self.values[k] > self.zero {
                    true => share / self.values[k],
                    false if share > f64::EPSILON.sqrt() => f64::INFINITY,
                    false => 0.0,
                }
            };
            (0..self.values.len()).map(term).sum::<f64>() / (self.scale[i] * self.scale[i])
        };
        Some(DVector::from_fn(self.values.len(), |i, _| entry(i)))
    }

    /// H⁻¹; `None` when an eigenvalue vanishes or is negative. By Cholesky: eigenvectors of close eigenvalues have lost half
    /// their digits (NIST's Eckerle4).
    pub fn inverse(&self) -> Option<DMatrix<f64>> {
        if self.values.min() <= self.zero {
            return None;
        }
        Some(Definite::of_scaled(&self.scale, &self.scaled)?.inverse())
    }

    /// H⁻¹ with eigenvalues raised to the resolution: two degenerate parameters get large variances, the others correct
    /// ones. `None` when H is indefinite.
    pub fn clamped_inverse(&self) -> Option<DMatrix<f64>> {
        if self.is_indefinite() {
            return None;
        }
        let reciprocals = self.values.map(|value| value.max(self.zero).recip());
        let inverse = &self.vectors * DMatrix::from_diagonal(&reciprocals) * self.vectors.transpose();
        let unscaled = |row: usize, column: usize| inverse[(row, column)] / (self.scale[row] * self.scale[column]);
        Some(DMatrix::from_fn(reciprocals.len(), reciprocals.len(), unscaled))
    }

    /// z(λ) in the eigenbasis: `−(Λ + λ)⁻¹ Qᵀ D⁻¹ g`. Where Λ + λ cannot be distinguished from 0, see [`Answered`].
    fn shifted(&self, lambda: f64) -> DVector<f64> {
        DVector::from_fn(self.values.len(), |k, _| {
            let curvature = self.values[k] + lambda;
            let gradient = self.gradient[k];
            if curvature.abs() > self.zero {
                return -gradient / curvature;
            }
            match self.answered {
                Answered::Within(least, most) if gradient.abs() > least && gradient.abs() <= most => {
                    -gradient / self.zero
                }
                Answered::Above(least) if gradient.abs() > least => -gradient.signum() * f64::INFINITY,
                _ => 0.0,
            }
        })
    }

    /// λ with ‖z(λ)‖ = Δ, when there is one above `lowest`: 1/‖z‖ is nearly linear in λ, so Newton's method on
    /// `1/‖z(λ)‖ − 1/Δ = 0`, kept inside a bracket.
    fn multiplier(&self, lowest: f64, radius: f64) -> f64 {
        let smallest = self.values.min();
        // ‖z(λ)‖ ≤ ‖D⁻¹g‖ / (λ_min + λ) ≤ Δ at the upper end.
        let mut high = (self.gradient.norm() / radius - smallest).max(lowest);
        let mut low = lowest;
        let mut lambda = 0.5 * (low + high);
        for _ in 0..SECULAR_ROUNDS {
            let z = self.shifted(lambda);
            let norm = z.norm();
            if (norm - radius).abs() <= 1e-6 * radius || high <= low {
                break;
            }
            if norm > radius {
                low = lambda
            } else {
                high = lambda
            }
            // d(1/‖z‖)/dλ = Σ z_k²/(Λ_k + λ) / ‖z‖³
            let slope = (0..z.len()).map(|k| z[k] * z[k] / (self.values[k] + lambda)).sum::<f64>() / norm.powi(3);
            let newton = lambda + (1.0 / radius - 1.0 / norm) / slope;
            lambda = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        }
        lambda
    }

    /// The minimiser of m within `radius`.
    pub fn step(&self, radius: f64) -> TrustStep {
        let smallest = self.values.min();
        let full = self.shifted(0.0);
        // λ = 0 is the answer when H is positive (semi)definite and ‖z(0)‖ ≤ Δ.
        if smallest >= -self.zero && full.norm() <= radius {
            return TrustStep { interior: true, ..self.finish(full) };
        }
        // Otherwise λ ≥ max(0, −λ_min), and ‖z(λ)‖ = Δ.
        let lowest = (-smallest).max(0.0);
        let edge = self.shifted(lowest);
        if edge.norm() > radius {
            return self.finish(self.shifted(self.multiplier(lowest, radius)));
        }
        // Unless ‖z(−λ_min)‖ < Δ (the hard case): g has no component along the lowest eigenvector, and any multiple τ of it
        // may be added; τ² = Δ² − ‖z‖².
        let mut z = edge;
        let lowest_vector = self.values.imin();
        let along = (radius * radius - z.norm_squared()).max(0.0).sqrt();
        z[lowest_vector] += if self.gradient[lowest_vector] > 0.0 { -along } else { along };
        self.finish(z)
    }

    /// The step to z, at the region's edge.
    fn finish(&self, z: DVector<f64>) -> TrustStep {
        let slope = self.gradient.dot(&z);
        let bend: f64 = (0..z.len()).map(|k| self.values[k] * z[k] * z[k]).sum();
        let delta = (&self.vectors * &z).component_div(&self.scale);
        TrustStep {
            delta,
            length: z.norm(),
            reduction: (-slope - 0.5 * bend).max(0.0),
            slope: slope.min(0.0),
            interior: false,
        }
    }
}

/// The trust region's state between steps.
#[derive(Clone, Debug)]
pub(crate) struct TrustRegion {
    /// Running maximum of √|H_ii|; 0 while a parameter has shown no effect.
    largest: DVector<f64>,
    /// Δ.
    radius: f64,
    /// No step has been tried.
    fresh: bool,
}

impl TrustRegion {
    /// Around the point `u` (free parameters only).
    pub fn new(hessian: &DMatrix<f64>, u: &DVector<f64>) -> TrustRegion {
        let mut region = TrustRegion { largest: DVector::zeros(u.len()), radius: 0.0, fresh: true };
        region.rescale(hessian);
        let scale = region.scale();
        let length = scale.component_mul(u).norm();
        region.radius = FIRST_RADIUS * if length > 0.0 { length } else { scale.norm() };
        region
    }

    /// Updates D by a new Hessian.
    pub fn rescale(&mut self, hessian: &DMatrix<f64>) {
        for (i, largest) in self.largest.iter_mut().enumerate() {
            *largest = largest.max(hessian[(i, i)].abs().sqrt());
        }
    }

    /// The diagonal of D; 1 for a parameter without effect.
    pub fn scale(&self) -> DVector<f64> {
        self.largest.map(|d| if d > 0.0 { d } else { 1.0 })
    }

    /// Δ.
    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// Limits Δ to `radius`.
    pub fn limit(&mut self, radius: f64) {
        self.radius = self.radius.min(radius);
    }

    /// Accepts or refuses a step after which F was `actual` lower (NaN or −∞: it could not be computed), with rounding
    /// errors up to `slack`; updates Δ. True: accept.
    ///
    /// `ρ = (actual + slack) / (predicted + slack)`; accepts when ρ ≥ 1e-4. Δ becomes ‖Dδ‖/2 when ρ ≤ 0.1, and 2‖Dδ‖ when ρ
    /// ≥ ¾ or the step was interior. Of 300 such rules tried on the NIST problems this one needs the fewest passes;
    /// MINPACK's cubic shrinking needs three times as many.
    pub fn judge(&mut self, step: &TrustStep, actual: f64, slack: f64) -> bool {
        if self.fresh {
            self.radius = self.radius.min(step.length);
            self.fresh = false;
        }
        if !actual.is_finite() {
            self.radius = 0.1 * step.length;
            return false;
        }
        let ratio = (actual + slack) / (step.reduction + slack);
        if ratio <= 0.1 || ratio.is_nan() {
            self.radius = 0.5 * self.radius.min(step.length);
        } else if ratio >= 0.75 || step.interior {
            self.radius = 2.0 * step.length;
        }
        ratio >= ACCEPT
    }
}

#[cfg(test)]
#[path = "trust_tests.rs"]
mod tests;
