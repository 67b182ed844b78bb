//! The light of a spot on each pixel, sampled 8 × 8 per pixel.
//!
//! `v₁ f(s)` with `s = dᵀAd` and `f(s) = 1 + k₁s + k₂s² − (1 + k₁ + k₂)s³` where s < 1, else 0.

/// The notes' target: f = (1 − s)²(1 + s/2).
pub const PROFILE: [f64; 2] = [-1.5, 0.0];
/// Default samples along a side of a pixel.
pub const SAMPLES: usize = 8;
/// Time samples of an exposure with motion.
const INSTANTS: usize = 12;
/// Radius of a blur kernel, in standard deviations.
const BLUR_REACH: f64 = 4.0;

/// f(s) inside the rim for k₁ and k₂.
pub fn profile([k1, k2]: [f64; 2], s: f64) -> f64 {
    1.0 + s * (k1 + s * (k2 - s * (1.0 + k1 + k2)))
}

/// A = Rᵀ diag(1/m², 1/n²) R as xx, xy, yy; the major axis at `angle` to x.
pub fn shape([m, n]: [f64; 2], angle: f64) -> [f64; 3] {
    let (s, c) = angle.sin_cos();
    let (p, q) = (m.powi(-2), n.powi(-2));
    [p * c * c + q * s * s, (p - q) * s * c, p * s * s + q * c * c]
}

/// A spot.
#[derive(Clone, Copy, Debug)]
pub struct Spot {
    /// Centre at mid-exposure, px.
    pub centre: [f64; 2],
    /// A, px⁻²: xx, xy, yy.
    pub shape: [f64; 3],
    /// DN
    pub brightness: f64,
    /// Motion during an exposure, px.
    pub motion: [f64; 2],
    /// k₁ and k₂.
    pub profile: [f64; 2],
    /// Samples along a side of a pixel.
    pub samples: usize,
}

impl Spot {
    /// Adds the spot to `light`, a frame of `side` px.
    pub fn add_to(&self, light: &mut [f64], side: usize) {
        let ([bx, by], [a1, a2, a3]) = (self.centre, self.shape);
        let [dx, dy] = self.motion;
        let determinant = a1 * a3 - a2 * a2;
        let columns = reach(bx, (a3 / determinant).sqrt() + dx.abs() + 1.0, side);
        let rows = reach(by, (a1 / determinant).sqrt() + dy.abs() + 1.0, side);
        let instants = if dx == 0.0 && dy == 0.0 { 1 } else { INSTANTS };
        let scale = self.brightness / (self.samples * self.samples * instants) as f64;
        let sample = |k: usize| (k as f64 + 0.5) / self.samples as f64 - 0.5;
        for y in rows {
            for x in columns.clone() {
                let mut sum = 0.0;
                for instant in 0..instants {
                    let time = (instant as f64 + 0.5) / instants as f64 - 0.5;
                    let (cx, cy) = (bx + time * dx - x as f64, by + time * dy - y as f64);
                    for row in 0..self.samples {
                        let v = sample(row) - cy;
                        for column in 0..self.samples {
                            let u = sample(column) - cx;
                            let s = a1 * u * u + 2.0 * a2 * u * v + a3 * v * v;
                            sum += if s < 1.0 { profile(self.profile, s) } else { 0.0 };
                        }
                    }
                }
                light[y * side + x] += scale * sum;
            }
        }
    }
}

fn reach(middle: f64, radius: f64, side: usize) -> std::ops::Range<usize> {
    let first = (middle - radius).floor().max(0.0) as usize;
    first..((middle + radius).ceil().max(0.0) as usize + 1).min(side)
}

/// Convolves with a Gaussian, replicating the border.
pub fn blurred(light: &[f64], side: usize, deviation: f64) -> Vec<f64> {
    let radius = (BLUR_REACH * deviation + 0.5) as isize;
    let weights: Vec<f64> = (-radius..=radius).map(|k| (-0.5 * (k as f64 / deviation).powi(2)).exp()).collect();
    let total: f64 = weights.iter().sum();
    let along = |pixels: &[f64], step: usize, line: usize| -> Vec<f64> {
        let mut out = vec![0.0; pixels.len()];
        for i in 0..side {
            for j in 0..side {
                let at = |k: isize| pixels[i * line + (j as isize + k).clamp(0, side as isize - 1) as usize * step];
                out[i * line + j * step] =
                    (-radius..=radius).zip(&weights).map(|(k, w)| w * at(k)).sum::<f64>() / total;
            }
        }
        out
    };
    along(&along(light, 1, side), side, 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The volume under v₁ f(s) is v₁ π/√det A · ∫₀¹ f ds, and ∫f = 1 + k₁/2 + k₂/3 − (1 + k₁ + k₂)/4.
    #[test]
    fn spots_have_their_volume_and_centroid() {
        let [k1, k2] = PROFILE;
        for motion in [[0.0, 0.0], [4.0, -3.0]] {
            let (centre, shape) = ([40.3, 41.8], shape([20.0, 14.0], 0.7));
            let spot = Spot { centre, shape, brightness: 180.0, motion, profile: PROFILE, samples: SAMPLES };
            let mut light = vec![0.0; 96 * 96];
            spot.add_to(&mut light, 96);
            let sum: f64 = light.iter().sum();
            let mean = 1.0 + k1 / 2.0 + k2 / 3.0 - (1.0 + k1 + k2) / 4.0;
            let volume = 180.0 * std::f64::consts::PI * 20.0 * 14.0 * mean;
            assert!((sum / volume - 1.0).abs() < 1e-4, "{sum} for {volume}");
            let x = light.iter().enumerate().map(|(i, v)| (i % 96) as f64 * v).sum::<f64>() / sum;
            assert!((x - 40.3).abs() < 1e-3, "{x}");
        }
    }

    /// Variances add: blur increases the second moment about the centre by its variance.
    #[test]
    fn blur_adds_its_variance() {
        let (centre, shape) = ([48.0, 47.0], shape([12.0, 9.0], 0.3));
        let (motion, profile) = ([0.0; 2], PROFILE);
        let spot = Spot { centre, shape, brightness: 100.0, motion, profile, samples: SAMPLES };
        let mut light = vec![0.0; 96 * 96];
        spot.add_to(&mut light, 96);
        let variance = |light: &[f64]| {
            let sum: f64 = light.iter().sum();
            light.iter().enumerate().map(|(i, v)| ((i / 96) as f64 - 47.0).powi(2) * v).sum::<f64>() / sum
        };
        let grown = variance(&blurred(&light, 96, 2.0)) - variance(&light);
        assert!((grown - 4.0).abs() < 0.01, "{grown}");
    }
}
