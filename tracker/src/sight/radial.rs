//! A radial profile from the pixels of fitted frames, sampled more finely than any single frame.
//!
//! Each pixel has a distance from the centre, in the model's own unit, and a value above the background, relative to the
//! target's height. The result are samples of the least-squares cubic spline, as a document's table holds them.
//!
//! The unknowns are the spline's weights c; at s, with i = ⌊s/step⌋ and f the rest, the value is Σ wₖ(f) cᵢ₋₁₊ₖ, k = 0 … 3,
//! and a sample is (cᵢ₋₁ + 4 cᵢ + cᵢ₊₁)/6. Weights are mirrored at both ends, as in a table.

use nalgebra::{Cholesky, DMatrix, DVector};

/// Weight of the smoothness penalty on second differences, relative to an unknown's mean weight; matters where there are no
/// pixels.
const SMOOTHNESS: f64 = 1e-6;

/// The normal equations over pixels of fitted frames.
#[derive(Clone, Debug)]
pub struct ProfileMeasurement {
    step: f64,
    normal: DMatrix<f64>,
    right: DVector<f64>,
    /// Σ w y²
    total: f64,
    pixels: usize,
}

/// A measured profile.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasuredProfile {
    /// Distance between samples; the first is at 0.
    pub step: f64,
    /// 1 at the first, 0 at the last.
    pub values: Vec<f64>,
    /// Standard errors of `values`, from the pixels' scatter.
    pub errors: Vec<f64>,
    /// Number of pixels used.
    pub pixels: usize,
}

impl ProfileMeasurement {
    /// With `count` samples (at least four) from 0 to `reach`.
    pub fn new(reach: f64, count: usize) -> ProfileMeasurement {
        let count = count.max(4);
        let (normal, right) = (DMatrix::zeros(count, count), DVector::zeros(count));
        ProfileMeasurement { step: reach / (count - 1) as f64, normal, right, total: 0.0, pixels: 0 }
    }

    /// Adds a pixel: its distance, value, and weight (an inverse variance). Ignores pixels beyond `reach` and NaN.
    pub fn add(&mut self, s: f64, value: f64, weight: f64) {
        let count = self.right.len();
        let t = s / self.step;
        let is_inside = t >= 0.0 && t < (count - 1) as f64;
        if !is_inside || !value.is_finite() || !weight.is_finite() {
            return;
        }
        let cell = t as usize;
        let f = t - cell as f64;
        let g = 1.0 - f;
        let basis = [
            g * g * g / 6.0,
            (4.0 - 6.0 * f * f + 3.0 * f * f * f) / 6.0,
            (4.0 - 6.0 * g * g + 3.0 * g * g * g) / 6.0,
            f * f * f / 6.0,
        ];
        let coefficients: [usize; 4] = std::array::from_fn(|k| mirrored(cell + k, count));
        for (i, a) in coefficients.iter().zip(basis) {
            self.right[*i] += weight * a * value;
            coefficients.iter().zip(basis).for_each(|(j, b)| self.normal[(*i, *j)] += weight * a * b);
        }
        self.total += weight * value * value;
        self.pixels += 1;
    }

    /// The profile; `None` where the pixels do not determine it.
    pub fn finish(&self) -> Option<MeasuredProfile> {
        let count = self.right.len();
        let mut normal = self.normal.clone();
        let held = SMOOTHNESS * normal.trace() / count as f64;
        for i in 1..count - 1 {
            for (j, a) in [(i - 1, 1.0), (i, -2.0), (i + 1, 1.0)] {
                [(i - 1, 1.0), (i, -2.0), (i + 1, 1.0)].iter().for_each(|(k, b)| normal[(j, *k)] += held * a * b);
            }
        }
        let solved = Cholesky::new(normal)?;
        let weights = solved.solve(&self.right);
        let samples = DMatrix::from_fn(count, count, |i, j| {
            let row = [(0, 1.0 / 6.0), (1, 4.0 / 6.0), (2, 1.0 / 6.0)];
            row.iter().filter(|(k, _)| mirrored(i + k, count) == j).map(|(_, w)| w).sum()
        });
        let values = &samples * &weights;
        let rest = self.total - 2.0 * weights.dot(&self.right) + (&self.normal * &weights).dot(&weights);
        let variance = rest.max(0.0) / self.pixels.checked_sub(count).filter(|free| *free > 0)? as f64;
        let covariance = &samples * solved.inverse() * samples.transpose() * variance;
        let (top, bottom) = (values[0], values[count - 1]);
        let height = top - bottom;
        let is_whole = height > 0.0 && values.iter().all(|value| value.is_finite());
        // (value − bottom)/height, with the errors of top and bottom propagated.
        let error = |i: usize| {
            let share = (values[i] - bottom) / height;
            let slopes = [(i, 1.0), (0, -share), (count - 1, share - 1.0)];
            let pairs = slopes.iter().flat_map(|a| slopes.iter().map(move |b| (a, b)));
            pairs.map(|((i, a), (j, b))| a * b * covariance[(*i, *j)]).sum::<f64>().max(0.0).sqrt() / height
        };
        is_whole.then(|| MeasuredProfile {
            step: self.step,
            values: values.iter().map(|value| (value - bottom) / height).collect(),
            errors: (0..count).map(error).collect(),
            pixels: self.pixels,
        })
    }
}

/// Mirrored index of the weight at `index` − 1, from −1 to the count.
fn mirrored(index: usize, count: usize) -> usize {
    let i = index.abs_diff(1);
    if i < count { i } else { 2 * (count - 1) - i }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use isophote_symbolic::{Axis, Table};

    /// Pseudo-random in −1 … 1.
    fn noise(i: u64) -> f64 {
        let z = i.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    #[test]
    fn a_profile_is_recovered_within_its_errors() {
        let truth = |s: f64| (1.0 + (s / 2.0).powi(2)).powf(-2.0) * 0.8 + 0.1;
        let mut measurement = ProfileMeasurement::new(8.0, 33);
        for i in 0..40_000 {
            let s = 8.0 * (0.5 + 0.5 * noise(2 * i)).sqrt();
            measurement.add(s, truth(s) + 0.05 * noise(2 * i + 1), 1.0);
        }
        let profile = measurement.finish().unwrap();
        let (top, bottom) = (truth(0.0), truth(8.0));
        let axis = Axis { first: 0.0, step: profile.step, count: 33 };
        let table = Table::through(&[axis], &profile.values).unwrap();
        let mut squares = 0.0;
        for (i, error) in profile.errors.iter().enumerate().skip(2).take(28) {
            let s = profile.step * i as f64;
            let expected = (truth(s) - bottom) / (top - bottom);
            squares += ((table.value(&[s]) - expected) / error).powi(2) / 28.0;
            assert!(*error < 0.02, "{i}: {error}");
        }
        assert!((0.3..3.0).contains(&squares), "{squares}");
        assert_eq!((profile.values[0], profile.values[32], profile.pixels > 39_000), (1.0, 0.0, true));
    }

    #[test]
    fn too_few_pixels_have_no_profile() {
        let mut measurement = ProfileMeasurement::new(4.0, 9);
        assert_eq!(measurement.finish(), None);
        for s in [0.5, 1.5, 2.5, -1.0, 4.0, f64::NAN] {
            measurement.add(s, 1.0, 1.0);
        }
        assert_eq!(measurement.finish(), None);
    }
}
