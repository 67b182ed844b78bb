//! Detection thresholds, in standard deviations, from a false-alarm rate and the number of independent places searched.
//!
//! For a smooth normal field in two dimensions the expected number of maxima above z, for z well above 1 (Adler, *The
//! Geometry of Random Fields*), is `E = |S| √det Λ (2π)^(−3/2) z exp(−z²/2)`, with Λ the covariance of the field's
//! gradient. |S| √det Λ is the number of *places*; those of all templates are added up, which is slightly conservative, as
//! templates of neighbouring sizes find the same noise.
//!
//! Noise of few photons is skewed. Its effect on a sum of pixels is the first term of the Cornish–Fisher expansion: z
//! becomes z + γ (z² − 1)/6, with γ the skewness of the sum.

use super::template::Template;
use crate::sight::start::Sign;

/// The threshold for a false-alarm rate.
#[derive(Clone, Copy, Debug)]
pub(super) struct FalseAlarmThreshold {
    /// For normal noise.
    pub z: f64,
}

/// Thresholds for a template.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Thresholds {
    /// For targets of the document's sign.
    pub upright: f64,
    /// For the negative; absent where that is no target.
    pub reversed: Option<f64>,
}

/// Relative increase of the threshold for background without noise, only bumps: peaks are chosen by position, size and
/// direction in something that is not normal.
const BUMPS: f64 = 0.7;
/// Lowest threshold.
const LEAST: f64 = 3.0;
/// Highest threshold.
const MOST: f64 = 40.0;

impl FalseAlarmThreshold {
    /// The threshold with `rate` false alarms per frame over all of `independent_positions`.
    pub fn new(rate: f64, independent_positions: f64) -> FalseAlarmThreshold {
        let expected = |z: f64| independent_positions * std::f64::consts::TAU.powf(-1.5) * z * (-0.5 * z * z).exp();
        let (mut low, mut high) = (LEAST, MOST);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if expected(middle) > rate { low = middle } else { high = middle }
        }
        FalseAlarmThreshold { z: high }
    }

    /// The thresholds for a template over pixels of this skewness. The noise's own skewness cannot be separated from a few
    /// bright pixels, so it never lowers a threshold.
    pub fn limits(self, template: &Template, skewness: f64, sign: Option<Sign>) -> Thresholds {
        let shift = template.skewness * skewness * (self.z * self.z - 1.0) / 6.0;
        let at_least = |z: f64| z.max(self.z);
        Thresholds { upright: at_least(self.z + shift), reversed: sign.is_none().then(|| at_least(self.z - shift)) }
    }
}

impl Thresholds {
    /// This threshold for both signs, or for the document's.
    pub fn even(least: f64, sign: Option<Sign>) -> Thresholds {
        Thresholds { upright: least, reversed: sign.is_none().then_some(least) }
    }

    /// The thresholds where this share of the variance is the background's.
    pub fn among_bumps(self, share: f64) -> Thresholds {
        let higher = |limit: f64| limit * (1.0 + BUMPS * share);
        Thresholds { upright: higher(self.upright), reversed: self.reversed.map(higher) }
    }
}
