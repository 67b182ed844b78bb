//! What the rows of frames are off by, each by something of its own: as the camera's document says, else learned along the way.
//!
//! What comes in: residuals of fits, and what fits of rows with offsets make of these. What goes out: the variance of offsets, in
//! pixel values². It never knows a document's parameters.
//!
//! Rows that are off say so by residuals that differ from one row to the next by more than their pixels' noise. From then on
//! fits know of offsets, and each says what they were.

use serde::{Deserialize, Serialize};

use super::solver::{Attempt, Look, Solver};
use super::window::Margin;
use crate::sight::view::View;
use crate::solve::exact;
use crate::solve::fit::{Fit, fit};
use crate::solve::prepare::{Lacking, Preparation, Preparing};
use crate::solve::residuals::Over;
use crate::solve::stage_kernels::{CompileFailure, Control};

/// The variance is that of so many of the last frames.
const MEMORY: u32 = 100;
/// Offsets are believed when they explain this share of what χ²/ν is larger than 1.
const EXPLAINED: f64 = 0.5;

/// What rows turned out to be off by: the mean over frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct RowLevel {
    frames: u32,
    #[serde(with = "exact")]
    variance: f64,
}

impl RowLevel {
    /// Takes in a fit's; `residuals`: what those of a fit that knew of none say.
    pub fn saw(&mut self, fit: Option<f64>, residuals: Option<f64>) {
        let first = if self.frames == 0 { residuals } else { None };
        if let Some(seen) = fit.or(first) {
            self.frames = (self.frames + 1).min(MEMORY);
            self.variance += (seen - self.variance) / f64::from(self.frames);
        }
    }

    /// In pixel values²; `None` until a frame has said so.
    pub fn variance(&self) -> Option<f64> {
        Some(self.variance).filter(|variance| self.frames > 0 && *variance > 0.0)
    }
}

impl Solver {
    /// True where rows' offsets are neither stated nor known, and could be.
    pub fn asks_for_rows(&self, look: &Look) -> bool {
        look.row_variance().is_none() && self.options.camera.row_noise_e.is_none() && self.row_shares.len() == 1
    }

    /// A view of rows that are off, where that is known and kernels are there for it.
    pub(super) fn with_rows<'a>(&self, look: &Look, view: View<'a>, variance: Option<f64>) -> View<'a> {
        let Some(variance) = variance.filter(|_| !self.row_shares.is_empty()) else { return view };
        let is_ready = match self.options.preparing {
            Preparing::AtOnce => self.compiled.derives_rows(),
            Preparing::Beside => look.ready.rows(&self.compiled, &view.layout).unwrap_or_else(|| {
                look.want(Preparation::new(&self.compiled, &view, Lacking::Rows));
                false
            }),
        };
        if !is_ready {
            return view;
        }
        view.with_rows(self.row_shares.iter().map(|share| variance * share).collect())
    }

    /// The attempt, or where its residuals say that rows are off, one that knows of it, when that explains what was left. From
    /// then on all fits of the frame know.
    pub(super) fn off_by_rows(
        &self,
        look: &Look,
        attempt: Attempt,
        start: &[f64],
        margin: Margin,
    ) -> Result<Attempt, CompileFailure> {
        let Some((plain, reduced)) = attempt.fit.as_ref().zip(attempt.reduced()) else { return Ok(attempt) };
        if !attempt.is_good() || !self.asks_for_rows(look) {
            return Ok(attempt);
        }
        let view = self.view(look, self.window(look, start, margin));
        let Some(variance) = self.row_variance(&view, plain) else { return Ok(attempt) };
        let view = self.with_rows(look, view, Some(variance));
        if view.row_variances.is_empty() {
            return Ok(attempt);
        }
        let mut again = fit(&self.compiled, &view, &self.constants, &plain.parameters, Control::Dropping)?;
        let left = again.worth.as_ref().and_then(|worth| worth.reduced);
        let is_explained = left.is_some_and(|left| left - 1.0 <= (1.0 - EXPLAINED) * (reduced - 1.0));
        if !is_explained || self.rejection(&again, &view, look.window).is_some() {
            return Ok(attempt);
        }
        look.learn_rows(variance);
        if let Some((last, earlier)) = again.stages.last_mut().zip(plain.stages.last()) {
            *last = last.clone().after(earlier);
        }
        Ok(Attempt { ending: again.ending, fit: Some(again), ..attempt })
    }

    /// What a fit's residuals say that rows of a plane are off by.
    fn row_variance(&self, view: &View, fit: &Fit) -> Option<f64> {
        let predictions = self.compiled.predictions()?;
        let seen = predictions.residuals(view, &fit.parameters, &self.constants, Over::Domain)?;
        self.of_plane(seen.first()?.row_variance(view.window.width)?)
    }

    /// The variance of offsets in a plane from that in what is observed; `None` where that is more than one value.
    pub(super) fn of_plane(&self, observed: f64) -> Option<f64> {
        if let [share] = self.row_shares[..] { Some(observed / share) } else { None }
    }
}

#[cfg(test)]
#[path = "rows_tests.rs"]
mod tests;
