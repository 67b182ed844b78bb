//! What is remembered of a pose beside its parameters: how well the document explains it, how it turns, and when its other side
//! was tried.
//!
//! What comes in: fits that are believed. What goes out: what is usual, and where the target may be turned to. It never knows a
//! frame.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::solver::{Attempt, Solver};
use crate::solve::backgrounds::MISFIT;
use crate::solve::exact;
use crate::solve::fit::Fit;

/// χ²/ν may be larger than the usual one by so many of its standard deviations, √(2/ν).
const SCATTER: f64 = 6.0;
/// By so many it asks for a second look at a fit of which nothing is known, which one in seven hundred does without need.
const DOUBTFUL: f64 = 3.0;
/// The usual χ²/ν is an average over so many fits.
const FITS: f64 = 8.0;
/// A target that turns by less than this from frame to frame is at rest, rad.
pub(super) const TURNED_LEAST: f64 = 0.02;
/// A turn goes on as it did where two in a row differ by less than this share.
const STEADY: f64 = 0.5;

/// What is remembered of a pose beside its parameters.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Past {
    /// χ²/ν of fits that were believed, in the mean.
    #[serde(with = "exact")]
    pub usual: Option<f64>,
    /// The angle to the mirrored pose when that one was tried, rad.
    #[serde(with = "exact")]
    pub tried: Option<f64>,
    /// Parameters with the orientation where it should be by now, if it turns evenly.
    #[serde(with = "exact")]
    turned: Option<Vec<f64>>,
    /// The last move.
    #[serde(with = "exact")]
    pub step: Option<Vector3<f64>>,
}

impl Past {
    /// Takes over a fit that was believed.
    pub fn saw(&mut self, solver: &Solver, last: Option<&[f64]>, attempt: &Attempt) {
        let (Some(geometry), Some(fit)) = (&solver.geometry, &attempt.fit) else { return };
        if let Some(reduced) = attempt.reduced().filter(|_| fit.choice.is_none()) {
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

    /// The target is nowhere: what is known of the document stays.
    pub fn lose(&mut self) {
        *self = Past { usual: self.usual, ..Past::default() };
    }

    /// Where a fit of this frame may begin as well.
    pub fn turned(&self) -> Option<&Vec<f64>> {
        self.turned.as_ref()
    }

    /// χ²/ν that asks for nothing.
    pub fn limit(&self, fit: &Fit) -> f64 {
        match self.usual {
            Some(usual) => usual.max(1.0) * noisy(fit, SCATTER).min(MISFIT),
            None => MISFIT,
        }
    }
}

/// χ²/ν that noise alone comes to, with so many of its standard deviations.
fn noisy(fit: &Fit, deviations: f64) -> f64 {
    let freedom = fit.worth.as_ref().map_or(1, |worth| worth.pixels.max(1)) as f64;
    1.0 + deviations * (2.0 / freedom).sqrt()
}

/// More is unexplained than the noise that a document states comes to.
pub(super) fn is_doubtful(fit: &Fit) -> bool {
    fit.worth.as_ref().and_then(|worth| worth.reduced).is_some_and(|reduced| reduced > noisy(fit, DOUBTFUL))
}
