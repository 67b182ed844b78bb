//! Row offsets: the variance of the independent offsets of a frame's rows, pixel values², stated by the camera's
//! document or learned.
//!
//! Row offsets make residuals differ from one row to the next by more than the noise of their pixels. Once detected,
//! fits model them, and each fit refines their variance.

use serde::{Deserialize, Serialize};

use super::solver::{Attempt, FrameContext, Solver};
use super::window::Margin;
use crate::sight::view::View;
use crate::solve::exact;
use crate::solve::fit::{Fit, fit};
use crate::solve::prepare::{MissingKernels, Preparation, Preparing};
use crate::solve::residuals::Over;
use crate::solve::stage_kernels::{CompileFailure, PixelHandling};

/// Length of the running mean of the variance, frames.
const MEMORY: u32 = 100;
/// Offsets are accepted when they explain this share of the excess of χ²/ν over 1.
const EXPLAINED: f64 = 0.5;

/// The running mean of the variance of row offsets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct RowLevel {
    frames: u32,
    #[serde(with = "exact")]
    variance: f64,
}

impl RowLevel {
    /// Adds a fit's variance. `residuals`: that from the residuals of a fit without offsets, used only as the first value.
    pub fn update(&mut self, fit: Option<f64>, residuals: Option<f64>) {
        let first = if self.frames == 0 { residuals } else { None };
        if let Some(seen) = fit.or(first) {
            self.frames = (self.frames + 1).min(MEMORY);
            self.variance += (seen - self.variance) / f64::from(self.frames);
        }
    }

    /// In pixel values²; `None` before the first value.
    pub fn variance(&self) -> Option<f64> {
        Some(self.variance).filter(|variance| self.frames > 0 && *variance > 0.0)
    }
}

impl Solver {
    /// True where the variance of row offsets is neither stated nor known, but can be measured.
    pub fn asks_for_rows(&self, context: &FrameContext) -> bool {
        context.row_variance().is_none() && self.options.camera.row_noise_e.is_none() && self.row_shares.len() == 1
    }

    /// A view with row offsets, where their variance is known and their kernels are ready.
    pub(super) fn with_rows<'a>(&self, context: &FrameContext, view: View<'a>, variance: Option<f64>) -> View<'a> {
        let Some(variance) = variance.filter(|_| !self.row_shares.is_empty()) else { return view };
        let is_ready = match self.options.preparing {
            Preparing::AtOnce => self.compiled.derives_rows(),
            Preparing::Beside => context.ready.rows(&self.compiled, &view.layout).unwrap_or_else(|| {
                context.request_kernels(Preparation::new(&self.compiled, &view, MissingKernels::Rows));
                false
            }),
        };
        if !is_ready {
            return view;
        }
        view.with_rows(self.row_shares.iter().map(|share| variance * share).collect())
    }

    /// The attempt, or one with row offsets where its residuals show them and they explain the misfit; then all later
    /// fits of the frame model them.
    pub(super) fn off_by_rows(
        &self,
        context: &FrameContext,
        attempt: Attempt,
        start: &[f64],
        margin: Margin,
    ) -> Result<Attempt, CompileFailure> {
        let Some((plain, reduced)) = attempt.fit.as_ref().zip(attempt.reduced_chi_square()) else { return Ok(attempt) };
        if !attempt.is_good() || !self.asks_for_rows(context) {
            return Ok(attempt);
        }
        let view = self.view(context, self.window(context, start, margin));
        let Some(variance) = self.row_variance(&view, plain) else { return Ok(attempt) };
        let view = self.with_rows(context, view, Some(variance));
        if view.row_variances.is_empty() {
            return Ok(attempt);
        }
        let mut again = fit(&self.compiled, &view, &self.constants, &plain.parameters, PixelHandling::SkipSaturated)?;
        let left = again.summary.as_ref().and_then(|summary| summary.reduced_chi_square);
        let is_explained = left.is_some_and(|left| left - 1.0 <= (1.0 - EXPLAINED) * (reduced - 1.0));
        if !is_explained || self.rejection(&again, &view, context.window).is_some() {
            return Ok(attempt);
        }
        context.learn_rows(variance);
        if let Some((last, earlier)) = again.stages.last_mut().zip(plain.stages.last()) {
            *last = last.clone().after(earlier);
        }
        Ok(Attempt { ending: again.ending, fit: Some(again), ..attempt })
    }

    /// The variance of a plane's row offsets, from a fit's residuals.
    fn row_variance(&self, view: &View, fit: &Fit) -> Option<f64> {
        let predictions = self.compiled.predictions()?;
        let seen = predictions.residuals(view, &fit.parameters, &self.constants, Over::Domain)?;
        self.of_plane(seen.first()?.row_variance(view.window.width)?)
    }

    /// The variance of offsets in a plane from that in `observed`; `None` where `observed` has several entries.
    pub(super) fn of_plane(&self, observed: f64) -> Option<f64> {
        if let [share] = self.row_shares[..] { Some(observed / share) } else { None }
    }
}

#[cfg(test)]
#[path = "rows_tests.rs"]
mod tests;
