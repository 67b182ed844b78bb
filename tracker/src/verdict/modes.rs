//! Evidence of residuals about a profile: projections of the residuals that a fit could not have absorbed (*modes*),
//! and their Bayes factor between a nearly right profile and another one.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

/// A definition: the prior median of the relative deviation of another object's profile.
const WRONG: f64 = 0.2;
/// A definition: the priors are log-normal about their medians, with this standard deviation, in e-folds.
const SCATTER: f64 = 0.8;
/// A budget: deviations for which the likelihood is computed, from `LEAST` to `MOST` at `POINTS` points in equal ratios.
const LEAST: f64 = 0.001;
const MOST: f64 = 1.5;
const POINTS: usize = 60;
/// Rounding: directions of smaller eigenvalues, as a share of the largest, are combinations of others.
const DISTINCT: f64 = 4e-4;
/// Rounding: the same for the Jacobian's columns, normalised to unit length: collinear parameters.
const TOGETHER: f64 = 1e-10;

/// Linear functions of residuals, with unit variance if the residuals are noise.
pub(super) struct Modes {
    /// A row per mode, a column per pixel: factors of residuals in pixel values.
    of_pixels: DMatrix<f64>,
    /// The variance that a relative deviation of 1 adds to each mode.
    pub response: DVector<f64>,
}

impl Modes {
    /// `jacobian` and `basis` have a row per pixel, `variances` an entry per pixel.
    pub fn new(jacobian: &DMatrix<f64>, basis: &DMatrix<f64>, variances: &[f64]) -> Option<Modes> {
        let weighed = |matrix: &DMatrix<f64>| {
            let mut matrix = matrix.clone();
            matrix.row_iter_mut().zip(variances).for_each(|(mut row, variance)| row /= variance.sqrt());
            matrix
        };
        let (mut jacobian, mut basis) = (weighed(jacobian), weighed(basis));
        for mut column in jacobian.column_iter_mut() {
            let length = column.norm();
            if length > 0.0 {
                column /= length;
            }
        }
        // Projects out the span of the Jacobian, which a fit absorbs; twice because of rounding.
        let inverse = pseudo_inverse(jacobian.tr_mul(&jacobian), TOGETHER)?;
        for _ in 0..2 {
            let taken = &inverse * jacobian.tr_mul(&basis);
            basis -= &jacobian * taken;
        }
        let count = basis.ncols() as f64;
        let products = basis.tr_mul(&basis);
        if products.iter().any(|value| !value.is_finite()) {
            return None;
        }
        let eigen = SymmetricEigen::new(products);
        let largest = eigen.eigenvalues.max();
        let kept: Vec<usize> =
            (0..basis.ncols()).filter(|i| eigen.eigenvalues[*i] > DISTINCT * largest && largest > 0.0).collect();
        let mut of_pixels = DMatrix::zeros(kept.len(), basis.nrows());
        for (row, &mode) in kept.iter().enumerate() {
            let direction = &basis * eigen.eigenvectors.column(mode) / eigen.eigenvalues[mode].sqrt();
            of_pixels.row_mut(row).tr_copy_from(&direction);
        }
        of_pixels.column_iter_mut().zip(variances).for_each(|(mut column, variance)| column /= variance.sqrt());
        let response = DVector::from_iterator(kept.len(), kept.iter().map(|&mode| eigen.eigenvalues[mode] / count));
        (!kept.is_empty()).then_some(Modes { of_pixels, response })
    }

    /// The modes of residuals or of any image.
    pub fn of(&self, values: &DVector<f64>) -> DVector<f64> {
        &self.of_pixels * values
    }

    /// The variance of each mode for these pixel variances.
    pub fn variances(&self, pixels: &[f64]) -> DVector<f64> {
        let mode =
            |row: usize| self.of_pixels.row(row).iter().zip(pixels).map(|(of, variance)| of * of * variance).sum();
        DVector::from_iterator(self.of_pixels.nrows(), (0..self.of_pixels.nrows()).map(mode))
    }
}

/// ln of the likelihood of the modes of one or more fits, for a range of relative deviations of the target's profile
/// from the document's: root mean squares as shares of the height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeviationLikelihood([f64; POINTS]);

impl DeviationLikelihood {
    /// `variances`: of modes without deviation.
    pub(super) fn new(modes: &DVector<f64>, response: &DVector<f64>, variances: &DVector<f64>) -> DeviationLikelihood {
        DeviationLikelihood(std::array::from_fn(|point| {
            let square = (2.0 * ln_deviation(point as f64)).exp();
            let term = |i: usize| {
                let variance = square * response[i] + variances[i];
                -0.5 * (variance.ln() + modes[i] * modes[i] / variance)
            };
            (0..modes.len()).map(term).sum()
        }))
    }

    /// ln of the likelihood ratio: the document's profile, off by `right` in the median, over another profile.
    pub(super) fn ln_bayes_factor(&self, right: f64) -> f64 {
        let about = |median: f64| {
            let prior = |point: usize| -0.5 * ((ln_deviation(point as f64) - median.ln()) / SCATTER).powi(2);
            let joint = (0..POINTS).map(|point| prior(point) + self.0[point]);
            ln_sum(joint) - ln_sum((0..POINTS).map(prior))
        };
        about(right) - about(WRONG)
    }

    /// The product of two likelihoods, as if independent given the profile.
    pub fn joined(&self, other: &DeviationLikelihood) -> DeviationLikelihood {
        DeviationLikelihood(std::array::from_fn(|point| self.0[point] + other.0[point]))
    }

    /// The likeliest deviation; the lower limit, 0.001, when the fits show none.
    pub fn most_likely(&self) -> f64 {
        let best = (0..POINTS).max_by(|a, b| self.0[*a].total_cmp(&self.0[*b])).unwrap_or(0);
        let around = |by: usize| (best + by).checked_sub(1).and_then(|point| self.0.get(point)).copied();
        // The vertex of the parabola through three points.
        let off = match [around(0), around(1), around(2)] {
            [Some(a), Some(b), Some(c)] if 2.0 * b > a + c => 0.5 * (a - c) / (a - 2.0 * b + c),
            _ => 0.0,
        };
        ln_deviation(best as f64 + off).exp()
    }
}

/// ln of the deviation at a grid point.
fn ln_deviation(point: f64) -> f64 {
    LEAST.ln() + (MOST / LEAST).ln() * point / (POINTS - 1) as f64
}

/// ln Σ exp.
fn ln_sum(logarithms: impl Iterator<Item = f64> + Clone) -> f64 {
    let most = logarithms.clone().fold(f64::NEG_INFINITY, f64::max);
    most + logarithms.map(|one| (one - most).exp()).sum::<f64>().ln()
}

/// The inverse in the span of eigenvectors whose eigenvalues exceed this share of the largest.
fn pseudo_inverse(matrix: DMatrix<f64>, least: f64) -> Option<DMatrix<f64>> {
    if matrix.iter().any(|value| !value.is_finite()) {
        return None;
    }
    let SymmetricEigen { eigenvectors, eigenvalues } = SymmetricEigen::new(matrix);
    let largest = eigenvalues.max();
    let inverse = eigenvalues.map(|value| if value > least * largest { value.recip() } else { 0.0 });
    Some(&eigenvectors * DMatrix::from_diagonal(&inverse) * eigenvectors.transpose())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn waves(pixels: usize, first: usize, count: usize) -> DMatrix<f64> {
        DMatrix::from_fn(pixels, count, |pixel, wave| ((pixel as f64 + 0.5) * 0.05 * (first + wave) as f64).cos())
    }

    #[test]
    fn columns_of_the_jacobian_are_projected_out() {
        let variances = vec![4.0; 400];
        let (jacobian, basis) = (waves(400, 0, 3), waves(400, 1, 6));
        let modes = Modes::new(&jacobian, &basis, &variances).unwrap();
        // Two of the six waves are columns of the Jacobian.
        assert_eq!(modes.response.len(), 4);
        assert!(modes.of(&(jacobian * DVector::from_vec(vec![3.0, -2.0, 5.0]))).norm() < 1e-9);
        assert!(modes.variances(&variances).iter().all(|variance| (variance - 1.0).abs() < 1e-9));
    }

    #[test]
    fn bayes_factor_accepts_two_per_cent_and_rejects_twenty() {
        let (response, variances) = (DVector::from_element(20, 1e4), DVector::from_element(20, 1.0));
        let of = |deviation: f64| {
            let modes = DVector::from_fn(20, |i, _| if i % 2 == 0 { 100.0 * deviation } else { -100.0 * deviation });
            DeviationLikelihood::new(&modes, &response, &variances)
        };
        let factor = |deviation: f64| of(deviation).ln_bayes_factor(0.02);
        assert!(factor(0.02) > 3.0 && factor(0.2) < -3.0, "{} {}", factor(0.02), factor(0.2));
        // A larger stated deviation admits profiles that are farther off.
        assert!(of(0.1).ln_bayes_factor(0.1) > 0.0 && factor(0.1) < 0.0, "{}", factor(0.1));
        // Without information the factor is neutral.
        let little = DeviationLikelihood::new(&DVector::zeros(20), &DVector::from_element(20, 0.01), &variances);
        assert!(little.ln_bayes_factor(0.02).abs() < 0.05, "{little:?}");
        // The likeliest deviation, whether of one fit or of several: 100² d² = response d² + 1.
        for deviation in [0.03_f64, 0.1] {
            let expected = (deviation.powi(2) - 1e-4).sqrt();
            for likelihood in [of(deviation), of(deviation).joined(&of(deviation))] {
                assert!((likelihood.most_likely() / expected - 1.0).abs() < 0.02, "{}", likelihood.most_likely());
            }
        }
        assert!(of(0.0).most_likely() < 0.0011);
    }
}
