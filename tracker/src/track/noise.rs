//! The ratio of a track's noise to the stated noise, learned from fits of a model that states its noise.
//!
//! χ²/ν is the variance of the noise in units of the stated variance, where the model describes the target. Misfit
//! correlates neighbouring residuals and is subtracted ([`Structure`](crate::solve::structure::Structure)); where it is
//! large, nothing is learned, so that misfit does not pass for noise.

use serde::{Deserialize, Serialize};

use super::pixel_statistics::ResidualStatistics;
use crate::solve::exact;

/// Frames before a ratio is reported.
const FRAMES: u32 = 10;
/// Length of the running mean, frames.
const MEMORY: u32 = 300;
/// A definition: the least ratio that covariances count. Less noise than that does not bound errors of sampling, which are kept
/// below the stated noise.
const LEAST: f64 = 0.5;
/// A frame counts when at least this share of its residuals' variance is noise.
const INDEPENDENT: f64 = 0.8;

/// The running mean over frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct NoiseLevel {
    frames: u32,
    /// Variance over the stated variance.
    #[serde(with = "exact")]
    variance: f64,
}

impl NoiseLevel {
    /// Adds a frame of this χ²/ν; `residuals`: the target's own pixels.
    pub fn update(&mut self, reduced: f64, residuals: ResidualStatistics) {
        let independent = residuals.structure.independent;
        if independent < INDEPENDENT || !reduced.is_finite() {
            return;
        }
        self.frames = (self.frames + 1).min(MEMORY);
        self.variance += (reduced * independent - self.variance) / f64::from(self.frames);
    }

    /// The standard deviation of pixels over the stated one; `None` before enough frames.
    pub fn measured(&self) -> Option<f64> {
        (self.frames >= FRAMES && self.variance > 0.0).then(|| self.variance.sqrt())
    }

    /// The same for covariances.
    pub fn ratio(&self) -> Option<f64> {
        self.measured().map(|ratio| ratio.max(LEAST))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::structure::Structure;

    fn residuals(independent: f64) -> ResidualStatistics {
        ResidualStatistics {
            structure: Structure { independent, correlated: 0.0 },
            reduced_chi_square: 1.0,
            rows: None,
        }
    }

    #[test]
    fn the_ratio_needs_ten_frames_and_follows_slowly() {
        let mut level = NoiseLevel::default();
        (0..9).for_each(|_| level.update(1.69, residuals(1.0)));
        assert_eq!(level.ratio(), None);
        level.update(1.69, residuals(1.0));
        assert!((level.ratio().unwrap_or(0.0) - 1.3).abs() < 1e-12);
        (0..3000).for_each(|_| level.update(1.0, residuals(1.0)));
        assert!((level.ratio().unwrap_or(0.0) - 1.0).abs() < 1e-3);
    }

    #[test]
    fn misfit_does_not_count_as_noise() {
        let mut level = NoiseLevel::default();
        (0..20).for_each(|_| level.update(1.25, residuals(0.8)));
        assert!((level.ratio().unwrap_or(0.0) - 1.0).abs() < 1e-12, "what hangs together is taken off");
        (0..100).for_each(|_| level.update(50.0, residuals(0.3)));
        assert!((level.ratio().unwrap_or(0.0) - 1.0).abs() < 1e-12, "and where it is most of it, nothing is learned");
    }
}
