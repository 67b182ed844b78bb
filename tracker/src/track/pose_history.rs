//! A pose's history beside its parameters: the usual χ²/ν, the rotation from frame to frame, and when the mirrored pose
//! was tried.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::solver::{Attempt, Solver};
use crate::solve::backgrounds::MISFIT;
use crate::solve::exact;
use crate::solve::fit::Fit;

/// Allowed excess of χ²/ν over the usual one, in its standard deviations, √(2/ν).
const SCATTER: f64 = 6.0;
/// Excess that asks for a second look at a fit without history, which one in seven hundred has by chance.
const DOUBTFUL: f64 = 3.0;
/// Length of the running mean of χ²/ν, fits.
const FITS: f64 = 8.0;
/// A target that turns by less than this from frame to frame is at rest, rad.
pub(super) const TURNED_LEAST: f64 = 0.02;
/// Two successive turns that differ by less than this share continue a steady rotation.
const STEADY: f64 = 0.5;

/// A pose's history beside its parameters.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct PoseHistory {
    /// Running mean of χ²/ν of the accepted fits.
    #[serde(with = "exact")]
    pub usual: Option<f64>,
    /// The angle to the mirrored pose when that was tried, or the least since, rad.
    #[serde(with = "exact")]
    pub tried: Option<f64>,
    /// Parameters with the orientation extrapolated by a frame, if the rotation is steady.
    #[serde(with = "exact")]
    turned: Option<Vec<f64>>,
    /// The last rotation vector.
    #[serde(with = "exact")]
    pub step: Option<Vector3<f64>>,
}

impl PoseHistory {
    /// Adds an accepted fit.
    pub fn update(&mut self, solver: &Solver, last: Option<&[f64]>, attempt: &Attempt) {
        let (Some(geometry), Some(fit)) = (&solver.geometry, &attempt.fit) else { return };
        if let Some(reduced) = attempt.reduced_chi_square().filter(|_| fit.choice.is_none()) {
            let usual = self.usual.unwrap_or(reduced);
            self.usual = Some(usual + (reduced - usual) / FITS);
        }
        let here = geometry.to_mirrored(&fit.parameters);
        self.tried = match attempt.is_other_tried {
            true => Some(here),
            false => self.tried.map(|tried| tried.min(here)),
        };
        let last = last.filter(|last| last.len() == fit.parameters.len() && last.iter().all(|value| value.is_finite()));
        let step = last.map(|last| geometry.turn(last, &fit.parameters));
        let is_even = |(now, before): (Vector3<f64>, Vector3<f64>)| {
            now.norm() > TURNED_LEAST && (now - before).norm() < STEADY * now.norm()
        };
        let even = step.zip(self.step).filter(|pair| is_even(*pair));
        self.turned = even.map(|(now, _)| geometry.turned(&fit.parameters, &now));
        self.step = step;
    }

    /// The target is lost: only the usual χ²/ν is kept.
    pub fn lose(&mut self) {
        *self = PoseHistory { usual: self.usual, ..PoseHistory::default() };
    }

    /// A further start for this frame's fit.
    pub fn turned(&self) -> Option<&Vec<f64>> {
        self.turned.as_ref()
    }

    /// The largest χ²/ν that needs no second look.
    pub fn limit(&self, fit: &Fit) -> f64 {
        match self.usual {
            Some(usual) => usual.max(1.0) * noisy(fit, SCATTER).min(MISFIT),
            None => MISFIT,
        }
    }
}

/// χ²/ν of noise alone, plus `deviations` times its standard deviation.
fn noisy(fit: &Fit, deviations: f64) -> f64 {
    let freedom = fit.summary.as_ref().map_or(1, |summary| summary.pixels.max(1)) as f64;
    1.0 + deviations * (2.0 / freedom).sqrt()
}

/// True when a fit leaves more unexplained than the stated noise accounts for.
pub(super) fn is_doubtful(fit: &Fit) -> bool {
    fit.summary
        .as_ref()
        .and_then(|summary| summary.reduced_chi_square)
        .is_some_and(|reduced| reduced > noisy(fit, DOUBTFUL))
}
