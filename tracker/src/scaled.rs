//! Cholesky factorisation of covariances, information matrices and Hessians, whose entries differ by many orders of
//! magnitude (px beside px⁻²), after scaling their diagonal to one.
//!
//! A frame factorises a dozen of them, of a few rows each: plain row-major storage that is reused.

use nalgebra::{DMatrix, DVector};

/// The factors of a positive definite matrix: `H = D L Lᵀ D` with D the root of its diagonal.
#[derive(Default)]
pub(crate) struct Definite {
    /// The diagonal of D.
    scale: Vec<f64>,
    /// L by rows, entries above the diagonal unused; the diagonal is stored inverted.
    factor: Vec<f64>,
    /// Scratch of [`Definite::newton_step`]: D x.
    scaled: Vec<f64>,
}

impl Definite {
    /// Sets D for a matrix whose rows and columns were rescaled.
    pub fn scaled_to(&mut self, matrix: &DMatrix<f64>) {
        self.scale.iter_mut().zip(matrix.diagonal().iter()).for_each(|(scale, entry)| *scale = entry.sqrt());
    }

    /// Empty, with capacity for `count` rows.
    pub fn with_capacity(count: usize) -> Definite {
        let [scale, factor, scaled] = [count, count * count, count].map(Vec::with_capacity);
        Definite { scale, factor, scaled }
    }

    /// `None` when the matrix is not positive definite.
    pub fn of(matrix: &DMatrix<f64>) -> Option<Definite> {
        let mut definite = Definite::default();
        definite.become_of(matrix, matrix.nrows(), |row| row).then_some(definite)
    }

    /// Factorises the rows and columns that `index_of` numbers, reusing memory; false when not positive definite.
    pub fn become_of(&mut self, matrix: &DMatrix<f64>, count: usize, index_of: impl Fn(usize) -> usize) -> bool {
        let (rows, entries) = (matrix.nrows(), matrix.as_slice());
        self.scale.clear();
        self.scale.extend((0..count).map(|i| entries[index_of(i) * (rows + 1)].sqrt()));
        self.factor.clear();
        self.factor.resize(count * count, 0.0);
        for i in 0..count {
            let (row, own) = (index_of(i), self.scale[i]);
            let factor = &mut self.factor[i * count..][..=i];
            for (j, entry) in factor.iter_mut().enumerate() {
                *entry = entries[index_of(j) * rows + row] / (own * self.scale[j]);
            }
        }
        self.scale.iter().all(|entry| *entry > 0.0) && factorised(&mut self.factor, count)
    }

    /// From D and `D⁻¹HD⁻¹`.
    pub fn of_scaled(scale: &DVector<f64>, scaled: &DMatrix<f64>) -> Option<Definite> {
        let definite = Definite::of(scaled)?;
        let scale = definite.scale.iter().zip(scale.iter()).map(|(inner, outer)| inner * outer).collect();
        Some(Definite { scale, ..definite })
    }

    /// The diagonal of D.
    pub fn scale(&self) -> DVector<f64> {
        DVector::from_column_slice(&self.scale)
    }

    fn row(&self, i: usize) -> &[f64] {
        let n = self.scale.len();
        &self.factor[i * n..][..=i]
    }

    /// True when no eigenvalue of `D⁻¹HD⁻¹` is numerically zero. They sum to n, so the product of all but the least is
    /// below `(n/(n − 1))ⁿ⁻¹ < e`.
    pub fn is_clear(&self, resolution: f64) -> bool {
        let n = self.scale.len() as f64;
        let determinant = (0..self.scale.len()).map(|i| self.row(i)[i].powi(-2)).product::<f64>();
        determinant > std::f64::consts::E * n * n * resolution
    }

    /// `x` becomes `L⁻¹ x`; its entries before `first` are 0.
    fn lower(&self, x: &mut [f64], first: usize) {
        for i in first..x.len() {
            let row = self.row(i);
            x[i] = (x[i] - dot(&row[first..i], &x[first..i])) * row[i];
        }
    }

    /// `x` becomes `L⁻ᵀ x`, from `first` on.
    fn upper(&self, x: &mut [f64], first: usize) {
        for i in (first..x.len()).rev() {
            let row = self.row(i);
            let own = x[i] * row[i];
            x[i] = own;
            x[first..i].iter_mut().zip(&row[first..i]).for_each(|(x, entry)| *x -= entry * own);
        }
    }

    /// Writes `−H⁻¹g` to `delta`; returns the predicted reduction of F. `gradient`: entries of the factorised rows.
    pub fn newton_step(&mut self, gradient: impl Iterator<Item = f64> + Clone, delta: &mut Vec<f64>) -> f64 {
        let mut scaled = std::mem::take(&mut self.scaled);
        scaled.clear();
        scaled.extend(gradient.clone().zip(&self.scale).map(|(slope, scale)| slope / scale));
        self.lower(&mut scaled, 0);
        self.upper(&mut scaled, 0);
        delta.clear();
        delta.extend(scaled.iter().zip(&self.scale).map(|(step, scale)| -step / scale));
        self.scaled = scaled;
        -0.5 * delta.iter().zip(gradient).map(|(step, slope)| step * slope).sum::<f64>()
    }

    /// H⁻¹.
    pub fn inverse(&self) -> DMatrix<f64> {
        let n = self.scale.len();
        let mut inverse = DMatrix::identity(n, n);
        for (j, column) in inverse.as_mut_slice().chunks_exact_mut(n.max(1)).enumerate() {
            // The upper triangle is copied from the lower one.
            self.lower(column, j);
            self.upper(column, j);
            column.iter_mut().zip(&self.scale).for_each(|(entry, scale)| *entry /= scale * self.scale[j]);
        }
        inverse.fill_upper_triangle_with_lower_triangle();
        inverse
    }

    /// `√(gᵀH⁻¹g)`.
    pub fn length(&self, gradient: &DVector<f64>) -> f64 {
        let mut scaled: Vec<f64> = gradient.iter().zip(&self.scale).map(|(slope, scale)| slope / scale).collect();
        self.lower(&mut scaled, 0);
        dot(&scaled, &scaled).sqrt()
    }

    /// The largest relative difference of another H, over all directions.
    pub fn differs(&self, other: &DMatrix<f64>) -> f64 {
        let n = self.scale.len();
        let mut whole = DMatrix::from_fn(n, n, |i, j| other[(i, j)] / (self.scale[i] * self.scale[j]));
        // L⁻¹ from the left, and, transposed, once more.
        for _ in 0..2 {
            whole.as_mut_slice().chunks_exact_mut(n.max(1)).for_each(|column| self.lower(column, 0));
            whole.transpose_mut();
        }
        if !whole.iter().all(|entry| entry.is_finite()) {
            return f64::INFINITY;
        }
        let eigenvalues = (0.5 * (&whole + whole.transpose())).symmetric_eigenvalues();
        eigenvalues.iter().map(|value| (value - 1.0).abs()).fold(0.0, f64::max)
    }
}

/// Largest factor by which an entry of a diagonal may change.
const CHANGE: f64 = 8.0;

/// Scales rows and columns symmetrically to this diagonal; returns the mean relative change of its entries, infinite
/// when one changes by more than [`CHANGE`] or is NaN.
pub(crate) fn to_diagonal(matrix: &mut DMatrix<f64>, diagonal: &[f64]) -> f64 {
    let n = diagonal.len();
    let mut changed = 0.0_f64;
    for (i, wanted) in diagonal.iter().enumerate() {
        let share = wanted / matrix[(i, i)];
        let is_measured = (1.0 / CHANGE..=CHANGE).contains(&share);
        changed += if is_measured { (share - 1.0).abs() / n as f64 } else { f64::INFINITY };
        let scale = share.sqrt();
        for j in 0..n {
            matrix[(i, j)] *= scale;
            matrix[(j, i)] *= scale;
        }
    }
    changed
}

/// Dot product over the shorter length.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Replaces the lower triangle by L with inverted diagonal; false when not positive definite.
fn factorised(rows: &mut [f64], n: usize) -> bool {
    for i in 0..n {
        let (above, below) = rows.split_at_mut(i * n);
        let row = &mut below[..=i];
        for (j, other) in above.chunks_exact(n).enumerate() {
            row[j] = (row[j] - dot(&row[..j], &other[..j])) * other[j];
        }
        let square = row[i] - dot(&row[..i], &row[..i]);
        if square.is_nan() || square <= 0.0 {
            return false;
        }
        row[i] = square.sqrt().recip();
    }
    true
}

/// `D⁻¹ M D⁻¹`.
pub(crate) fn scaled(matrix: &DMatrix<f64>, scale: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(scale.len(), scale.len(), |i, j| matrix[(i, j)] / (scale[i] * scale[j]))
}

/// The inverse; `None` when the matrix is not positive definite.
pub(crate) fn inverse(matrix: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    Some(Definite::of(matrix)?.inverse())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Positive definite, of entries between 1e-8 and 1e8.
    fn matrix(n: usize) -> DMatrix<f64> {
        let root = DMatrix::from_fn(n, n, |i, j| if i == j { 2.0 } else { ((3 * i + 7 * j) % 5) as f64 / 5.0 - 0.4 });
        let scale = DVector::from_fn(n, |i, _| 10f64.powi(4 - 8 * (i as i32 % 2)));
        let product = &root * root.transpose();
        DMatrix::from_fn(n, n, |i, j| product[(i, j)] * scale[i] * scale[j])
    }

    #[test]
    fn factors_are_those_of_the_matrix() {
        let (mut definite, mut delta) = (Definite::default(), Vec::new());
        for n in [5, 1, 3, 7] {
            let matrix = matrix(n);
            assert!(definite.become_of(&matrix, n, |row| row));
            let identity = definite.inverse() * &matrix;
            assert!((identity - DMatrix::identity(n, n)).amax() < 1e-6, "{n}");
            // D⁻¹HD⁻¹ has the determinant of the root, squared.
            let unit = scaled(&matrix, &definite.scale());
            let clear = unit.determinant() / (std::f64::consts::E * (n * n) as f64);
            assert!(definite.is_clear(0.999 * clear) && !definite.is_clear(1.001 * clear), "{n}");
            let gradient = DVector::from_fn(n, |i, _| matrix[(i, i)].sqrt() * (i as f64 - 1.3));
            let reduction = definite.newton_step(gradient.iter().copied(), &mut delta);
            let back = &matrix * DVector::from_column_slice(&delta) + &gradient;
            assert!(
                back.iter().zip(gradient.iter()).all(|(left, slope)| left.abs() < 1e-9 * slope.abs()),
                "{n}: {back}"
            );
            assert!((2.0 * reduction - definite.length(&gradient).powi(2)).abs() < 1e-9 * reduction, "{n}");
            assert!((definite.differs(&(1.25 * &matrix)) - 0.25).abs() < 1e-9 && definite.differs(&matrix) < 1e-9);
        }
    }

    #[test]
    fn a_subset_of_rows_is_factorised() {
        let whole = matrix(5);
        let rows = [3, 0, 4];
        let part = whole.select_rows(&rows).select_columns(&rows);
        let mut definite = Definite::default();
        assert!(definite.become_of(&whole, 3, |row| rows[row]));
        let other = Definite::of(&part).map(|other| other.inverse());
        assert_eq!(Some(definite.inverse()), other);
    }

    #[test]
    fn indefinite_singular_and_nan_matrices_have_no_factors() {
        let mut flat = matrix(3);
        flat.set_column(2, &flat.column(1).into_owned());
        flat.set_row(2, &flat.row(1).into_owned());
        let mut bent = matrix(3);
        bent[(0, 1)] *= 100.0;
        bent[(1, 0)] *= 100.0;
        let unknown = DMatrix::from_element(2, 2, f64::NAN);
        for matrix in [flat, bent, -matrix(2), unknown] {
            assert!(Definite::of(&matrix).is_none(), "{matrix}");
        }
    }
}
