//! The inverse of a covariance or of an information, whose entries differ by many orders of magnitude (px beside px⁻²): by
//! Cholesky, after its diagonal is scaled to one.

use nalgebra::DMatrix;

/// `None` when the matrix is not positive definite.
pub(crate) fn inverse(matrix: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let scale = matrix.diagonal().map(|entry| entry.sqrt().recip());
    if !scale.iter().all(|s| s.is_finite()) {
        return None;
    }
    let n = scale.len();
    let scaled = DMatrix::from_fn(n, n, |i, j| scale[i] * matrix[(i, j)] * scale[j]);
    let inverse = scaled.cholesky()?.inverse();
    Some(DMatrix::from_fn(n, n, |i, j| scale[i] * inverse[(i, j)] * scale[j]))
}
