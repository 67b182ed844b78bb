//! How noisy frames are, beside what is stated: learned from the frames of a track.
//!
//! What comes in: χ²/ν of fits of a model that says how noisy a pixel is, and what hangs together in their residuals. What goes
//! out: by which factor the noise is larger than stated. It never knows a pixel.
//!
//! χ²/ν is the variance of the noise, in units of what is stated, where the model describes the target. What it does not describe
//! hangs together in neighbouring residuals, which is taken off ([`Structure`](crate::solve::structure::Structure)); where that is
//! much, nothing is learned, so that misfit does not pass for noise.

use serde::{Deserialize, Serialize};

use super::ground::Own;
use crate::solve::exact;

/// From so many frames on the noise is known.
const FRAMES: u32 = 10;
/// It is that of so many of the last frames.
const MEMORY: u32 = 300;
/// Pixels are not taken to be quieter than this share of what is stated: what is left of pictures without noise is their rounding,
/// which is none.
const LEAST: f64 = 0.5;
/// A frame says something when at least this share of its residuals' variance is noise.
const INDEPENDENT: f64 = 0.8;

/// The mean over frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct NoiseLevel {
    frames: u32,
    /// Of the variance over that which is stated.
    #[serde(with = "exact")]
    variance: f64,
}

impl NoiseLevel {
    /// Takes in a frame with that χ²/ν; `own`: of the target's pixels, when they were looked at one by one.
    pub fn saw(&mut self, reduced: f64, own: Own) {
        let independent = own.structure.independent;
        if independent < INDEPENDENT || !reduced.is_finite() {
            return;
        }
        self.frames = (self.frames + 1).min(MEMORY);
        self.variance += (reduced * independent - self.variance) / f64::from(self.frames);
    }

    /// The standard deviation of pixels over that which is stated; `None` until enough frames have said so.
    pub fn ratio(&self) -> Option<f64> {
        (self.frames >= FRAMES && self.variance > 0.0).then(|| self.variance.sqrt().max(LEAST))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::structure::Structure;

    fn own(independent: f64) -> Own {
        Own {
            structure: Structure { unexplained: 0.0, cell: 0.01, independent, hanging: 0.0 },
            reduced: 1.0,
            rows: None,
        }
    }

    #[test]
    fn the_noise_is_known_after_ten_frames_and_follows_slowly() {
        let mut level = NoiseLevel::default();
        (0..9).for_each(|_| level.saw(1.69, own(1.0)));
        assert_eq!(level.ratio(), None);
        level.saw(1.69, own(1.0));
        assert!((level.ratio().unwrap_or(0.0) - 1.3).abs() < 1e-12);
        (0..3000).for_each(|_| level.saw(1.0, own(1.0)));
        assert!((level.ratio().unwrap_or(0.0) - 1.0).abs() < 1e-3);
    }

    #[test]
    fn misfit_is_no_noise() {
        let mut level = NoiseLevel::default();
        (0..20).for_each(|_| level.saw(1.25, own(0.8)));
        assert!((level.ratio().unwrap_or(0.0) - 1.0).abs() < 1e-12, "what hangs together is taken off");
        (0..100).for_each(|_| level.saw(50.0, own(0.3)));
        assert!((level.ratio().unwrap_or(0.0) - 1.0).abs() < 1e-12, "and where it is most of it, nothing is learned");
    }
}
