//! A normal prior of the coefficients of a polynomial background, from the same modes elsewhere in the frame.

use nalgebra::{DMatrix, DVector};

use crate::solve::trust::Quadratic;

/// A normal prior, of mean zero, of the last parameters of a model.
pub(crate) struct Prior {
    /// The inverse of its covariance.
    precision: DMatrix<f64>,
}

impl Prior {
    /// Of the coefficients of `terms` after the first `given`, which the model itself has. The modes of a background are
    /// its projections on the terms, orthonormal over the pixels; each has mean zero and the mean square that it has in
    /// `elsewhere`, but at least `noise`. `terms` has a row per pixel, `elsewhere` a column of pixel values per place.
    pub fn new(terms: &DMatrix<f64>, given: usize, elsewhere: &DMatrix<f64>, noise: f64) -> Option<Prior> {
        let triangle = terms.tr_mul(terms).cholesky()?.unpack(); // terms = Q Lᵀ
        let modes = triangle.solve_lower_triangular(&terms.tr_mul(elsewhere))?;
        let square = |mode: usize| modes.row(mode).norm_squared() / elsewhere.ncols() as f64;
        let count = terms.ncols() - given;
        let inverse = DVector::from_fn(count, |mode, _| square(given + mode).max(noise).recip());
        let own = triangle.view((given, given), (count, count));
        Some(Prior { precision: own * DMatrix::from_diagonal(&inverse) * own.transpose() })
    }

    /// Of several groups of parameters.
    pub fn joined(priors: &[Prior]) -> Prior {
        let count = priors.iter().map(|prior| prior.precision.nrows()).sum();
        let (mut precision, mut at) = (DMatrix::zeros(count, count), 0);
        for Prior { precision: part } in priors {
            precision.view_mut((at, at), part.shape()).copy_from(part);
            at += part.nrows();
        }
        Prior { precision }
    }

    /// Adds `cᵀPc` to F, and its derivatives.
    pub fn add_to(&self, quadratic: &mut Quadratic, parameters: &[f64]) {
        let count = self.precision.nrows();
        let first = quadratic.gradient.len() - count;
        let coefficients = DVector::from_column_slice(&parameters[parameters.len() - count..]);
        let slope = &self.precision * &coefficients;
        quadratic.objective += coefficients.dot(&slope);
        let mut gradient = quadratic.gradient.rows_mut(first, count);
        gradient += 2.0 * slope;
        let mut hessian = quadratic.hessian.view_mut((first, first), (count, count));
        hessian += 2.0 * &self.precision;
    }

    /// −2 ln of the factor by which the coefficients reduce the evidence of a fit: their distance from zero, and the
    /// share of the prior's volume that is left (Laplace's approximation; D. MacKay, "Bayesian interpolation", Neural
    /// Computation 4, 1992).
    pub fn penalty(&self, parameters: &[f64], covariance: &DMatrix<f64>) -> Option<f64> {
        let count = self.precision.nrows();
        let first = covariance.nrows() - count;
        let coefficients = DVector::from_column_slice(&parameters[parameters.len() - count..]);
        let own = covariance.view((first, first), (count, count)).into_owned();
        let volumes = self.precision.clone().cholesky()?.ln_determinant() + own.cholesky()?.ln_determinant();
        Some(coefficients.dot(&(&self.precision * &coefficients)) - volumes)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::solve::trust::Curvature;

    /// One mode of a constant is given; the slope has the variance that it has elsewhere.
    #[test]
    fn coefficients_have_the_variance_of_their_modes_elsewhere() {
        let along = |pixel: usize| pixel as f64 - 4.5;
        let terms = DMatrix::from_fn(10, 2, |pixel, term| along(pixel).powi(term as i32));
        let elsewhere = DMatrix::from_fn(10, 4, |pixel, place| {
            100.0 * place as f64 + if place % 2 == 0 { 3.0 } else { -3.0 } * along(pixel)
        });
        let prior = Prior::new(&terms, 1, &elsewhere, 0.0).unwrap();
        let mut quadratic = Quadratic {
            objective: 5.0,
            gradient: DVector::zeros(3),
            hessian: DMatrix::zeros(3, 3),
            curvature: Curvature::GaussNewton,
        };
        prior.add_to(&mut quadratic, &[7.0, 8.0, 6.0]);
        assert!((quadratic.objective - 9.0).abs() < 1e-9, "{quadratic:?}"); // two standard deviations
        assert!((quadratic.gradient[2] - 4.0 / 3.0).abs() < 1e-9 && quadratic.gradient[1] == 0.0, "{quadratic:?}");
        assert!((quadratic.hessian[(2, 2)] - 2.0 / 9.0).abs() < 1e-9, "{quadratic:?}");
        // A fit that leaves a hundredth of the prior's deviation.
        let covariance = DMatrix::from_diagonal(&DVector::from_vec(vec![1.0, 1.0, 9e-4]));
        let expected = 4.0 + 2.0 * f64::ln(100.0);
        assert!((prior.penalty(&[7.0, 8.0, 6.0], &covariance).unwrap() - expected).abs() < 1e-9);
    }
}
