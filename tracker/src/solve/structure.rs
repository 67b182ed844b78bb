//! What hangs together in a fit's residuals: how much of a target the model does not describe, whatever the noise is.
//!
//! What comes in: the residuals of a fit. What goes out: [`Structure`]. It never knows a target or a track.
//!
//! Noise of neighbouring pixels is independent, so the mean product of neighbouring residuals is what the model leaves
//! unexplained: no formula for the noise is needed. How far it hangs together follows from products of residuals that are
//! farther apart, as if these fell with the distance as `exp(−d²/4s²)`: then 4πs² pixels have one residual in common (in
//! two dimensions). The
//! fewer such cells a target has, the more of what it is taken for may be the work of one of them.

use serde::{Deserialize, Serialize};

use crate::solve::exact;
use crate::solve::residuals::Seen;

/// The mean product may be larger than 0 by so many of its standard deviations.
const SCATTER: f64 = 3.0;
/// Fewer pairs of neighbours say nothing.
const PAIRS_MIN: usize = 20;
/// The other residuals are so far apart, px.
const FAR: usize = 3;
/// Their products are not less than this share of those of neighbours, nor more than that share.
const FALL: [f64; 2] = [0.02, 0.98];

/// Of the pixels of a domain that are not saturated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Structure {
    /// The variance of what the model leaves unexplained over that of its prediction, less what noise may look like.
    #[serde(with = "exact")]
    pub unexplained: f64,
    /// The share of the domain's pixels that have one residual in common.
    #[serde(with = "exact")]
    pub cell: f64,
    /// The share of the residuals' variance that neighbours do not have in common: noise. 1 where noise alone may look so.
    #[serde(with = "exact")]
    pub independent: f64,
    /// The share that neighbours do have in common, for each pixel that has it in common, as far as noise cannot look so: what a
    /// covariance that counts pixels as independent lacks.
    #[serde(with = "exact", default)]
    pub hanging: f64,
}

/// A sum of products.
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
    /// Of all observed values together; `None` where there are hardly any neighbours. Of a picture with rows of so many pixels,
    /// slices of so many rows, and so many dimensions.
    pub fn of(seen: &[Seen], [width, height]: [usize; 2], dimensions: usize) -> Option<Structure> {
        let (mut near, mut far) = (Products::default(), Products::default());
        let (mut count, mut squares) = (0_usize, 0.0);
        let (mut weights, mut light, mut light_squares) = (0.0, 0.0, 0.0);
        for seen in seen {
            let clear = seen.residuals.iter().filter(|residual| !residual.saturated);
            let last = clear.clone().map(|residual| residual.pixel).max()?;
            let mut plane = vec![f64::NAN; last + 1];
            for residual in clear.clone() {
                plane[residual.pixel] = residual.whitened;
                (count, squares) = (count + 1, squares + residual.whitened * residual.whitened);
                let (weight, predicted) = (residual.deviation.powi(-2), residual.predicted);
                weights += weight;
                light += weight * predicted;
                light_squares += weight * predicted * predicted;
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
        // Of the light over the background that suits it best: noise that grows with the light makes all whitened pixels alike.
        let light = (light_squares - light * light / weights) / n;
        if near.pairs < PAIRS_MIN || light <= 0.0 {
            return None;
        }
        let noise = (squares / n - near.mean()).max(0.0);
        let common = (near.mean() - SCATTER * noise / (near.pairs as f64).sqrt()).max(0.0);
        if common == 0.0 {
            return Some(Structure { unexplained: 0.0, cell: 1.0 / n, independent: 1.0, hanging: 0.0 });
        }
        // 4s² of exp(−1/4s²) and exp(−FAR²/4s²).
        let spread = |far: f64| (FAR * FAR - 1) as f64 / -(far / common).clamp(FALL[0], FALL[1]).ln();
        let pixels = |spread: f64| (std::f64::consts::PI * spread).powf(0.5 * dimensions as f64).clamp(1.0, n);
        let likely = spread(far.mean());
        let cell = pixels(likely) / n;
        let sure = far.mean() - SCATTER * noise / (far.pairs.max(1) as f64).sqrt();
        let hanging = common * n / squares * pixels(spread(sure));
        let independent = (noise * n / squares).min(1.0);
        let unexplained = common * (1.0 / likely).exp() / light;
        Some(Structure { unexplained, cell, independent, hanging })
    }

    /// True where noise alone does not look so.
    pub fn is_told(&self) -> bool {
        self.independent < 1.0
    }

    /// What may pretend to be a target: the smaller, the more cells there are that do not.
    pub fn share(&self) -> f64 {
        self.unexplained * self.cell
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
        let seen = Seen { residuals: residuals.collect(), limit: f64::INFINITY };
        Structure::of(&[seen], [SIDE; 2], 2).unwrap_or_else(|| panic!("there are neighbours"))
    }

    /// Of a bump that is 3 % off all over, when its noise is stated to grow with it.
    #[test]
    fn light_is_light_where_noise_grows_with_it_as_well() {
        let residuals = (0..SIDE * SIDE).map(|pixel| {
            let [x, y] = [pixel % SIDE, pixel / SIDE].map(|at| at as f64 - 29.5);
            let bump = 150.0 * (-(x * x + y * y) / 400.0).exp();
            let deviation = 1.0_f64.hypot(0.03 * bump);
            let off = 0.03 * bump * (std::f64::consts::TAU * x / 15.0).sin();
            Residual { pixel, predicted: 50.0 + bump, whitened: off / deviation, deviation, saturated: false }
        });
        let seen = Seen { residuals: residuals.collect(), limit: f64::INFINITY };
        let structure = Structure::of(&[seen], [SIDE; 2], 2).unwrap();
        assert!(structure.unexplained < 0.003, "{structure:?}");
    }

    /// In [−1, 1).
    fn noise(x: usize, y: usize) -> f64 {
        let mut bits = (x as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (y as u64).wrapping_mul(0xD134_2543_DE82_EF95);
        bits = (bits ^ (bits >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        bits = (bits ^ (bits >> 32)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (bits >> 40) as f64 / f64::from(1 << 23) - 1.0
    }

    #[test]
    fn noise_hides_nothing_however_strong_it_is() {
        for strength in [0.1, 1.0, 100.0] {
            assert_eq!(structure(|x, y| strength * noise(x, y)).unexplained, 0.0, "{strength}");
        }
    }

    #[test]
    fn waves_are_found_in_noise_with_their_share_and_their_size() {
        let variance = (SIDE * SIDE - 1) as f64 / 12.0;
        let [short, long] = [4.0, 12.0].map(|length: f64| {
            let wave = |at: usize| (std::f64::consts::TAU * at as f64 / length).sin();
            let found = structure(|x, y| 4.0 * wave(x) * wave(y) + noise(x, y));
            (found, 4.0 / variance)
        });
        assert!(long.0.cell > 3.0 * short.0.cell, "{short:?} {long:?}");
        assert!((long.0.unexplained / long.1 - 1.0).abs() < 0.5, "{long:?}");
    }
}
