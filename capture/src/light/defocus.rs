//! Defocus: blurs a plane of light with a Gaussian.

/// A separable Gaussian, truncated at four standard deviations and normalized to 1. It is sampled at pixel centres, so its
/// variance is σ² for σ ≥ 0.7 px, and smaller below.
pub(crate) struct Blur {
    /// Weights along x and y; the middle one belongs to the pixel itself.
    weights: [Vec<f32>; 2],
}

impl Blur {
    /// Kernel for frames with `axes` axes: a line is blurred only along itself.
    pub fn new(sigma_px: f64, axes: usize) -> Blur {
        let reach = (4.0 * sigma_px).ceil() as i64;
        let weights: Vec<f64> = (-reach..=reach).map(|k| libm::exp(-0.5 * (k as f64 / sigma_px).powi(2))).collect();
        let sum: f64 = weights.iter().sum();
        let weights: Vec<f32> = weights.iter().map(|weight| (weight / sum) as f32).collect();
        let along = if axes > 1 { weights.clone() } else { vec![1.0] };
        Blur { weights: [weights, along] }
    }

    /// Pixels needed on either side of the frame, along x and y.
    pub fn reach(&self) -> [usize; 2] {
        [0, 1].map(|axis| self.weights[axis].len() / 2)
    }

    /// Blurs `padded`, a plane larger than the frame by [`Blur::reach`] on every side; the frame is `width` px wide.
    pub fn apply(&self, padded: &[f32], width: usize) -> Vec<f32> {
        let [across, along] = &self.weights;
        let mut rows = vec![0.0f32; padded.len() / (width + across.len() - 1) * width];
        for (padded, row) in padded.chunks_exact(width + across.len() - 1).zip(rows.chunks_exact_mut(width)) {
            for (k, weight) in across.iter().enumerate() {
                row.iter_mut().zip(&padded[k..]).for_each(|(sum, light)| *sum += weight * light);
            }
        }
        let mut blurred = vec![0.0f32; rows.len() - (along.len() - 1) * width];
        for (y, row) in blurred.chunks_exact_mut(width).enumerate() {
            for (k, weight) in along.iter().enumerate() {
                let light = &rows[(y + k) * width..][..width];
                row.iter_mut().zip(light).for_each(|(sum, light)| *sum += weight * light);
            }
        }
        blurred
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A point becomes a Gaussian of variance σ²; uniform light is unchanged.
    #[test]
    fn a_point_becomes_a_gaussian() {
        for sigma_px in [0.7, 2.0, 5.5] {
            let blur = Blur::new(sigma_px, 2);
            let [reach, _] = blur.reach();
            let (width, height) = (2 * reach + 1, 2 * reach + 1);
            let padded_width = width + 2 * reach;
            let mut padded = vec![0.0; padded_width * (height + 2 * reach)];
            padded[2 * reach * padded_width + 2 * reach] = 1000.0;
            let blurred = blur.apply(&padded, width);
            assert_eq!(blurred.len(), width * height);
            let (mut sum, mut square) = (0.0, 0.0);
            for (i, light) in blurred.iter().enumerate() {
                let (x, y) = ((i % width) as f64 - reach as f64, (i / width) as f64 - reach as f64);
                let expected = 1000.0 / (std::f64::consts::TAU * sigma_px * sigma_px)
                    * libm::exp(-(x * x + y * y) / (2.0 * sigma_px * sigma_px));
                let light = f64::from(*light);
                assert!((light - expected).abs() < 1.0, "σ {sigma_px}, ({x}, {y}): {light} for {expected}");
                (sum, square) = (sum + light, square + light * x * x);
            }
            assert!((sum - 1000.0).abs() < 1e-2, "{sum}");
            let variance = square / sum;
            assert!((variance / (sigma_px * sigma_px) - 1.0).abs() < 0.01, "σ {sigma_px}: {variance}");
        }
        let even = Blur::new(2.0, 1).apply(&[7.0; 40], 24);
        assert!(even.len() == 24 && even.iter().all(|light| (light - 7.0).abs() < 1e-5));
    }
}
