//! Pixel statistics of a fit: the correlation of its residuals, and the scale of its covariance.

use isophote_symbolic::Model;
use serde::{Deserialize, Serialize};

use super::solver::{Attempt, FrameContext, Solver};
use crate::solve::exact;
use crate::solve::fit::Fit;
use crate::solve::passes::FitSummary;
use crate::solve::structure::Structure;

/// A budget: a target's residuals are analysed again when χ²/ν has changed by this factor.
pub(super) const GROWN: f64 = 1.35;
/// A definition: a χ²/ν that exceeds 1 by this many standard deviations, √(2/ν), is significant.
pub(super) const SCATTER: f64 = 3.0;

/// Pixel statistics of a target.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct PixelStatistics {
    /// From the last analysis of its residuals.
    #[serde(rename = "own")]
    pub residuals: Option<ResidualStatistics>,
}

/// Residuals of the pixels of a target's domain.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ResidualStatistics {
    pub structure: Structure,
    /// χ²/ν of that fit.
    #[serde(rename = "reduced", with = "exact")]
    pub reduced_chi_square: f64,
    /// The variance of the rows' offsets, pixel values², where the fit did not include them.
    #[serde(with = "exact", default)]
    pub rows: Option<f64>,
}

impl PixelStatistics {
    /// Analyses the residuals of a fit, unless this was done at about the same χ²/ν.
    pub fn updated(self, solver: &Solver, context: &FrameContext, attempt: &Attempt) -> PixelStatistics {
        let fit = attempt.fit.as_ref().filter(|_| attempt.is_good() && !solver.fits_pose());
        let Some((fit, reduced_chi_square)) = fit.zip(attempt.reduced_chi_square()) else { return self };
        let is_as_it_was = |residuals: ResidualStatistics| {
            reduced_chi_square <= GROWN * residuals.reduced_chi_square
                && residuals.reduced_chi_square <= GROWN * reduced_chi_square
        };
        if fit.choice.is_some() || self.residuals.is_some_and(is_as_it_was) {
            return self;
        }
        let residuals = solver.structure(context, fit).map(|(structure, rows)| ResidualStatistics {
            structure,
            reduced_chi_square,
            rows,
        });
        PixelStatistics { residuals: residuals.or(self.residuals) }
    }
}

/// Degrees of freedom ν, at least 1.
pub(super) fn freedom(solver: &Solver, summary: &FitSummary) -> f64 {
    summary.pixels.saturating_sub(solver.compiled.last_parameters().len() as u64).max(1) as f64
}

/// The excess of χ²/ν that is not significant.
fn scatter(solver: &Solver, summary: &FitSummary) -> f64 {
    SCATTER * (2.0 / freedom(solver, summary)).sqrt()
}

/// The factor on a covariance that assumes independent pixels with the stated noise. `noise`: the variance of pixels over the
/// stated one, measured in earlier frames. This frame's residuals count beyond the scatter of such noise, and their correlated
/// share times the number of pixels that share it; without `noise` in the model the covariance already follows χ²/ν.
pub(super) fn scale(solver: &Solver, fit: &Fit, statistics: PixelStatistics, noise: f64) -> f64 {
    let Some(summary) = &fit.summary else { return noise };
    let residuals = statistics.residuals.filter(|_| fit.choice.is_none() && !solver.fits_pose());
    let [independent, correlated] =
        residuals.map_or([1.0, 0.0], |residuals| [residuals.structure.independent, residuals.structure.correlated]);
    match summary.reduced_chi_square.filter(|_| solver.model().has_noise()) {
        Some(reduced) => noise.max(reduced * independent - noise * scatter(solver, summary)) + reduced * correlated,
        None => noise + correlated,
    }
}

/// ln L: `−½ (χ² + Σ ln σ² + n ln 2π)`; without `noise`, with the most likely variance, `−½ n (ln (2π F/n) + 1)`.
pub(crate) fn log_likelihood(summary: &FitSummary, model: &Model) -> Option<f64> {
    let n = summary.pixels as f64;
    let turn = std::f64::consts::TAU;
    let value = match model.has_noise() {
        true => -0.5 * (summary.objective + n * turn.ln()),
        false => -0.5 * n * ((turn * summary.objective / n).ln() + 1.0),
    };
    value.is_finite().then_some(value)
}
