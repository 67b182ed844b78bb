//! Correlation of a fit's residuals between pixels: how much of a target the model does not describe, whatever the noise
//! is.
//!
//! Noise of neighbouring pixels is independent, so the mean product of neighbouring residuals is the unexplained variance:
//! no formula for the noise is needed. Its correlation length follows from products of more distant residuals, assuming a
//! fall-off with distance as `exp(−d²/4s²)`: then 4πs² pixels share one residual (in two dimensions).

use serde::{Deserialize, Serialize};

use crate::solve::exact;
use crate::solve::residuals::ObservedResiduals;

/// Significance of the mean product, in its standard deviations.
const SCATTER: f64 = 3.0;
/// Fewest pairs of neighbours.
const PAIRS_MIN: usize = 20;
/// Distance of the other residuals, px.
const FAR: usize = 3;
/// Limits of the ratio of their products to those of neighbours.
const FALL: [f64; 2] = [0.02, 0.98];

/// Over the unsaturated pixels of a domain.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Structure {
    /// The share of the residuals' variance that is uncorrelated between neighbours: noise. 1 if consistent with noise
    /// alone.
    #[serde(with = "exact")]
    pub independent: f64,
    /// The correlated share times the number of pixels that share it, as far as noise cannot explain it: the term that a
    /// covariance with independent pixels lacks.
    #[serde(rename = "hanging", with = "exact", default)]
    pub correlated: f64,
}

/// A sum of products over pairs.
#[derive(Default)]
struct Products {
    pairs: usize,
    sum: f64,
}

impl Products {
    fn add(&mut self, a: f64, others: [Option<&f64>; 2]) {
        for b in others.into_iter().flatten().filter(|b| !b.is_nan()) {
            self.pairs += 1;
            self.sum += a * b;
        }
    }

    fn mean(&self) -> f64 {
        self.sum / self.pairs.max(1) as f64
    }
}

impl Structure {
    /// Over all observed values together; `None` with hardly any neighbours. Arguments: pixels per row, rows per slice, and
    /// dimensions.
    pub fn of(seen: &[ObservedResiduals], [width, height]: [usize; 2], dimensions: usize) -> Option<Structure> {
        let (mut near, mut far) = (Products::default(), Products::default());
        let (mut count, mut squares) = (0_usize, 0.0);
        for seen in seen {
            let clear = seen.residuals.iter().filter(|residual| !residual.saturated);
            let last = clear.clone().map(|residual| residual.pixel).max()?;
            let mut plane = vec![f64::NAN; last + 1];
            for residual in clear.clone() {
                plane[residual.pixel] = residual.whitened;
                (count, squares) = (count + 1, squares + residual.whitened * residual.whitened);
            }
            for residual in clear {
                let pixel = residual.pixel;
                let beside = |by: usize| {
                    let right = plane.get(pixel + by).filter(|_| pixel % width + by < width);
                    let below = plane.get(pixel + by * width).filter(|_| pixel / width % height + by < height);
                    [right, below]
                };
                near.add(residual.whitened, beside(1));
                far.add(residual.whitened, beside(FAR));
            }
        }
        let n = count as f64;
        if near.pairs < PAIRS_MIN {
            return None;
        }
        let noise = (squares / n - near.mean()).max(0.0);
        let common = (near.mean() - SCATTER * noise / (near.pairs as f64).sqrt()).max(0.0);
        if common == 0.0 {
            return Some(Structure { independent: 1.0, correlated: 0.0 });
        }
        // 4s² of exp(−1/4s²) and exp(−FAR²/4s²).
        let spread = |far: f64| (FAR * FAR - 1) as f64 / -(far / common).clamp(FALL[0], FALL[1]).ln();
        let pixels = |spread: f64| (std::f64::consts::PI * spread).powf(0.5 * dimensions as f64).clamp(1.0, n);
        let sure = far.mean() - SCATTER * noise / (far.pairs.max(1) as f64).sqrt();
        let correlated = common * n / squares * pixels(spread(sure));
        let independent = (noise * n / squares).min(1.0);
        Some(Structure { independent, correlated })
    }

    /// True if noise alone does not explain the residuals.
    pub fn is_significant(&self) -> bool {
        self.independent < 1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::residuals::Residual;

    const SIDE: usize = 60;

    /// Residuals of a prediction that rises along x.
    fn structure(residual: impl Fn(usize, usize) -> f64) -> Structure {
        let residuals = (0..SIDE * SIDE).map(|pixel| Residual {
            pixel,
            predicted: (pixel % SIDE) as f64,
            whitened: residual(pixel % SIDE, pixel / SIDE),
            deviation: 1.0,
            saturated: false,
        });
        let seen = ObservedResiduals { residuals: residuals.collect(), limit: f64::INFINITY };
        Structure::of(&[seen], [SIDE; 2], 2).unwrap_or_else(|| panic!("there are neighbours"))
    }

    /// Pseudo-random, in [−1, 1).
    fn noise(x: usize, y: usize) -> f64 {
        let mut bits = (x as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (y as u64).wrapping_mul(0xD134_2543_DE82_EF95);
        bits = (bits ^ (bits >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        bits = (bits ^ (bits >> 32)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (bits >> 40) as f64 / f64::from(1 << 23) - 1.0
    }

    #[test]
    fn noise_of_any_strength_has_no_structure() {
        for strength in [0.1, 1.0, 100.0] {
            let found = structure(|x, y| strength * noise(x, y));
            assert_eq!((found.correlated, found.is_significant()), (0.0, false), "{strength}");
        }
    }

    #[test]
    fn waves_in_noise_are_measured_by_share_and_size() {
        let [short, long] = [4.0, 12.0].map(|length: f64| {
            let wave = |at: usize| (std::f64::consts::TAU * at as f64 / length).sin();
            structure(|x, y| 4.0 * wave(x) * wave(y) + noise(x, y))
        });
        assert!(long.correlated > 3.0 * short.correlated, "{short:?} {long:?}");
        // The waves have a variance of 4, the noise of 1/3.
        assert!((long.independent - 1.0 / 13.0).abs() < 0.3, "{long:?}");
    }
}
