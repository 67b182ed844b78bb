//! A profile from fitted frames: what a target looks like from its middle outwards, more finely than any one frame has it.
//!
//! What comes in: of each pixel how far it is from the middle, in whatever the model counts distances in, and what it reads
//! above the ground, in shares of the target's height. What goes out: samples of the cubic spline that fits all of them best
//! (linear least squares), as a table of a document has them. It must never know a frame, or a model.
//!
//! The unknowns are the spline's weights c; at s, with i = ⌊s/step⌋ and f the rest, the value is Σ wₖ(f) cᵢ₋₁₊ₖ, k = 0 … 3, and
//! a sample is (cᵢ₋₁ + 4 cᵢ + cᵢ₊₁)/6. Weights are mirrored at both ends, as those of a table are.

use nalgebra::{Cholesky, DMatrix, DVector};

/// Of the mean weight of an unknown: how much its second difference is held to 0, which counts where there are no pixels.
const SMOOTHNESS: f64 = 1e-6;

/// Pixels of fitted frames, added up.
#[derive(Clone, Debug)]
pub struct ProfileMeasurement {
    step: f64,
    normal: DMatrix<f64>,
    right: DVector<f64>,
    /// Σ w y²
    total: f64,
    pixels: usize,
}

/// The profile.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasuredProfile {
    /// From a sample to the next; the first is at 0.
    pub step: f64,
    /// 1 at the first, 0 at the last.
    pub values: Vec<f64>,
    /// Standard errors of those, from what the pixels differ by.
    pub errors: Vec<f64>,
    /// Pixels that it was measured with.
    pub pixels: usize,
}

impl ProfileMeasurement {
    /// Of `count` samples (at least four) from 0 to `reach`.
    pub fn new(reach: f64, count: usize) -> ProfileMeasurement {
        let count = count.max(4);
        let (normal, right) = (DMatrix::zeros(count, count), DVector::zeros(count));
        ProfileMeasurement { step: reach / (count - 1) as f64, normal, right, total: 0.0, pixels: 0 }
    }

    /// A pixel: its place, its value, and how much it counts (an inverse variance). What is further out, or no number, is
    /// left out.
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
        let places: [usize; 4] = std::array::from_fn(|k| mirrored(cell + k, count));
        for (i, a) in places.iter().zip(basis) {
            self.right[*i] += weight * a * value;
            places.iter().zip(basis).for_each(|(j, b)| self.normal[(*i, *j)] += weight * a * b);
        }
        self.total += weight * value * value;
        self.pixels += 1;
    }

    /// The spline; `None` where the pixels do not say what it is.
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
        // (value − bottom)/height, of which top and bottom are as unsure as the rest.
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

/// The weight at one less than `place`, from −1 to the count.
fn mirrored(place: usize, count: usize) -> usize {
    let i = place.abs_diff(1);
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
    fn a_profile_comes_back_within_its_errors() {
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
    fn too_few_pixels_say_nothing() {
        let mut measurement = ProfileMeasurement::new(4.0, 9);
        assert_eq!(measurement.finish(), None);
        for s in [0.5, 1.5, 2.5, -1.0, 4.0, f64::NAN] {
            measurement.add(s, 1.0, 1.0);
        }
        assert_eq!(measurement.finish(), None);
    }
}
