//! Covariances, informations and Hessians, whose entries differ by many orders of magnitude (px beside px⁻²): by Cholesky,
//! after their diagonal is scaled to one.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// A positive definite matrix by its factors: `H = D L Lᵀ D` with D the root of its diagonal.
pub(crate) struct Definite {
    scale: DVector<f64>,
    factor: Cholesky<f64, Dyn>,
}

impl Definite {
    /// `None` when the matrix is not positive definite.
    pub fn of(hessian: &DMatrix<f64>) -> Option<Definite> {
        let scale = hessian.diagonal().map(f64::sqrt);
        if !scale.iter().all(|entry| *entry > 0.0) {
            return None;
        }
        let factor = scaled(hessian, &scale).cholesky()?;
        Some(Definite { scale, factor })
    }

    /// From D and L.
    pub fn of_factor(scale: DVector<f64>, factor: Cholesky<f64, Dyn>) -> Definite {
        Definite { scale, factor }
    }

    /// The diagonal of D.
    pub fn scale(&self) -> &DVector<f64> {
        &self.scale
    }

    /// True where no eigenvalue of `D⁻¹HD⁻¹` could be taken for zero. These have the sum n, so the product of all but the
    /// least is below `(n/(n − 1))ⁿ⁻¹ < e`.
    pub fn is_clear(&self, resolution: f64) -> bool {
        let n = self.scale.len() as f64;
        self.factor.determinant() > std::f64::consts::E * n * n * resolution
    }

    /// `−H⁻¹g`, and by how much F falls there.
    pub fn newton_step(&self, gradient: &DVector<f64>) -> (DVector<f64>, f64) {
        let delta = -self.factor.solve(&gradient.component_div(&self.scale)).component_div(&self.scale);
        let reduction = -0.5 * delta.dot(gradient);
        (delta, reduction)
    }

    /// H⁻¹.
    pub fn inverse(&self) -> DMatrix<f64> {
        let inverse = self.factor.inverse();
        let mean = |i, j| 0.5 * (inverse[(i, j)] + inverse[(j, i)]);
        DMatrix::from_fn(inverse.nrows(), inverse.ncols(), |i, j| mean(i, j) / (self.scale[i] * self.scale[j]))
    }

    /// `√(gᵀH⁻¹g)`.
    pub fn length(&self, gradient: &DVector<f64>) -> f64 {
        let gradient = gradient.component_div(&self.scale);
        gradient.dot(&self.factor.solve(&gradient)).max(0.0).sqrt()
    }

    /// The largest relative difference of another H, in whatever direction.
    pub fn differs(&self, other: &DMatrix<f64>) -> f64 {
        let lower = self.factor.l();
        let half = lower.solve_lower_triangular(&scaled(other, &self.scale));
        let whole = half.and_then(|half| lower.solve_lower_triangular(&half.transpose()));
        let eigenvalues = whole.map(|whole| (0.5 * (&whole + whole.transpose())).symmetric_eigenvalues());
        eigenvalues.map_or(f64::INFINITY, |values| values.iter().map(|value| (value - 1.0).abs()).fold(0.0, f64::max))
    }
}

/// `D⁻¹ M D⁻¹`.
pub(crate) fn scaled(matrix: &DMatrix<f64>, scale: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(scale.len(), scale.len(), |i, j| matrix[(i, j)] / (scale[i] * scale[j]))
}

/// The inverse; `None` when the matrix is not positive definite.
pub(crate) fn inverse(matrix: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    Some(Definite::of(matrix)?.inverse())
}
