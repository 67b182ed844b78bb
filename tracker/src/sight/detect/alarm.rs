//! How strong noise alone may be: from a rate of false alarms to a threshold.
//!
//! What comes in: the share of frames in which noise may be taken for a target, and how many independent places were looked at.
//! What goes out: a threshold in standard deviations, for each template. It never knows a picture.
//!
//! Of a smooth normal field in two dimensions so many maxima are expected above z, for z well above 1 (Adler, *The Geometry of
//! Random Fields*): `E = |S| √det Λ (2π)^(−3/2) z exp(−z²/2)`, with Λ the covariance of the field's gradient. |S| √det Λ is the
//! number of *places*; those of all templates are added up, which is a little too careful, for templates of neighbouring
//! sizes find the same noise.
//!
//! Noise of few photons is skewed. What that does to a sum of pixels is the first term of the Cornish–Fisher expansion:
//! z becomes z + γ (z² − 1)/6, with γ the skewness of the sum.

use super::template::Template;
use crate::sight::start::Sign;

/// From a share of frames to standard deviations.
#[derive(Clone, Copy, Debug)]
pub(super) struct Alarm {
    /// Of normal noise.
    pub z: f64,
}

/// Thresholds of a template.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Limits {
    /// For what is bright where the document is, …
    pub upright: f64,
    /// … and for its negative; absent where that is no target.
    pub reversed: Option<f64>,
}

/// Of ground that is all bumps the threshold is higher by this share: as what stands out is chosen by place, size and direction in
/// something that is not normal.
const BUMPS: f64 = 0.7;
/// No threshold is lower.
const LEAST: f64 = 3.0;
/// None is higher.
const MOST: f64 = 40.0;

impl Alarm {
    /// `rate` false alarms a frame in all of `places`.
    pub fn new(rate: f64, places: f64) -> Alarm {
        let expected = |z: f64| places * std::f64::consts::TAU.powf(-1.5) * z * (-0.5 * z * z).exp();
        let (mut low, mut high) = (LEAST, MOST);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if expected(middle) > rate { low = middle } else { high = middle }
        }
        Alarm { z: high }
    }

    /// For a template over pixels of that skewness. What is noise's own skewness cannot be told from a few bright pixels, so
    /// it never makes a threshold lower.
    pub fn limits(self, template: &Template, skewness: f64, sign: Option<Sign>) -> Limits {
        let shift = template.skewness * skewness * (self.z * self.z - 1.0) / 6.0;
        let at_least = |z: f64| z.max(self.z);
        Limits { upright: at_least(self.z + shift), reversed: sign.is_none().then(|| at_least(self.z - shift)) }
    }
}

impl Limits {
    /// The same where such a share of the variance is the ground's.
    pub fn among_bumps(self, share: f64) -> Limits {
        let higher = |limit: f64| limit * (1.0 + BUMPS * share);
        Limits { upright: higher(self.upright), reversed: self.reversed.map(higher) }
    }
}
