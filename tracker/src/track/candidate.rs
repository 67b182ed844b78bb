//! `Candidate`: a fit of an object that may be the target, with its evidence.

use super::pixel_statistics::PixelStatistics;
use super::solver::{Attempt, Solver};
use crate::estimate::Ending;
use crate::outline::shape;
use crate::verdict::Verdict;

/// A definition: below this probability a track has lost its target.
const LOST: f64 = 0.25;
/// Without a shape: fits this close to each other are of one object, px.
const COINCIDENCE_PX: f64 = 3.0;
/// Largest ratio of areas between a fit and the detection that it started from.
const ALIKE: f64 = 6.0;

/// A fit of an object that may be the target.
#[derive(Clone, Debug)]
pub(crate) struct Candidate {
    pub attempt: Attempt,
    /// Absent where the model allows none.
    pub verdict: Option<Verdict>,
    /// Statistics of its pixels.
    pub statistics: PixelStatistics,
    /// Whether it is where a track expects its target; set by that track.
    pub near: Option<bool>,
    /// Another fit was skipped because its kernels were not ready.
    pub lacks_kernels: bool,
}

/// An object that may be the target.
#[derive(Clone, Debug, PartialEq)]
pub struct Sighting {
    /// All parameters of the model, from the fit.
    pub parameters: Vec<f64>,
    /// The probability that it is the target, where it is known.
    pub confidence: Option<f64>,
}

impl Candidate {
    /// A fit that no track has judged yet.
    pub fn of(attempt: Attempt, statistics: PixelStatistics, verdict: Option<Verdict>) -> Candidate {
        Candidate { attempt, verdict, statistics, near: None, lacks_kernels: false }
    }

    /// The probability that it is the target.
    pub fn confidence(&self) -> Option<f64> {
        self.verdict.as_ref().map(Verdict::probability)
    }

    /// True for an acceptable target: a lone object, or one of at least the session's minimum probability, or of an unknown one.
    pub fn is_sure(&self, solver: &Solver) -> bool {
        self.is_likelier(solver.options.confidence_min)
    }

    /// The same for a followed target, with a lower limit.
    pub fn is_kept(&self, solver: &Solver) -> bool {
        self.is_likelier(solver.options.confidence_min.min(LOST))
    }

    /// True for a candidate that would be sure if nothing else were in the frame.
    pub fn is_ambiguous(&self, solver: &Solver) -> bool {
        self.verdict.is_some_and(|verdict| verdict.among(0.0, None).probability() >= solver.options.confidence_min)
    }

    fn is_likelier(&self, least: f64) -> bool {
        self.verdict.is_none_or(|verdict| verdict.is_alone() || verdict.probability() >= least)
    }

    /// True for a fit on another background, or one that leaves out more of the target than scattered outliers.
    pub fn is_substitute(&self) -> bool {
        self.attempt.choice().is_some_and(|choice| !choice.is_marginal())
    }

    /// True for a fit of every pixel.
    pub fn is_plain(&self) -> bool {
        self.attempt.choice().is_none()
    }

    /// True for the plain model fitted without scattered outliers.
    pub fn leaves_outliers_out(&self) -> bool {
        self.attempt.choice().is_some_and(|choice| choice.is_marginal())
    }

    /// True for a fit on a background of degree 2 or more.
    pub fn is_bent(&self) -> bool {
        self.attempt.choice().is_some_and(|choice| choice.is_bent())
    }

    /// True when it is likelier the target than not; without a verdict, when the fit determines all parameters.
    pub(super) fn is_likely(&self) -> bool {
        let is_determined = || self.attempt.ending != Ending::Singular;
        self.verdict.map_or_else(is_determined, |verdict| verdict.odds() >= 1.0)
    }

    /// True when its centre lies inside the outline of an object with parameters `other`.
    pub fn coincides(&self, solver: &Solver, other: &[f64]) -> bool {
        self.attempt.fit.as_ref().is_some_and(|fit| is_inside(solver, &fit.parameters, other))
    }

    /// True when a fit converged inside its start's outline, at a similar size, with all parameters determined, and without
    /// saturated pixels, whose light is unknown.
    pub(super) fn stays(&self, solver: &Solver, start: &[f64]) -> bool {
        let Some(fit) = &self.attempt.fit else { return false };
        let sizes = solver.ln_size_and_brightness(&fit.parameters).0.zip(solver.ln_size_and_brightness(start).0);
        let is_alike = sizes.is_none_or(|(now, before)| (now - before).abs() <= ALIKE.ln());
        let is_clear = fit.summary.as_ref().is_some_and(|summary| summary.saturated == 0.0);
        is_alike && is_clear && self.attempt.ending == Ending::SmallStep && self.coincides(solver, start)
    }

    /// The sort key of candidates.
    pub(super) fn odds(&self) -> f64 {
        self.verdict.as_ref().map_or(0.0, Verdict::odds)
    }
}

/// True when the centre of one of the two lies inside the outline of the other.
pub(super) fn is_about(solver: &Solver, one: &[f64], other: &[f64]) -> bool {
    is_inside(solver, one, other) || is_inside(solver, other, one)
}

/// True when the centre of the target with parameters `centre` lies inside the outline of the one with `outline`.
fn is_inside(solver: &Solver, centre: &[f64], outline: &[f64]) -> bool {
    let dimensions = solver.model().coordinates().len();
    solver.model().roles().iter().any(|roles| {
        let off: Vec<f64> = roles.centre.iter().map(|p| centre[p.index()] - outline[p.index()]).collect();
        match shape(roles, dimensions, outline).filter(|a| a.nrows() == off.len() && !off.is_empty()) {
            Some(a) => {
                let term = |i: usize| (0..off.len()).map(|j| off[i] * a[(i, j)] * off[j]).sum::<f64>();
                (0..off.len()).map(term).sum::<f64>() <= 1.0
            }
            None => !off.is_empty() && off.iter().map(|d| d * d).sum::<f64>() <= COINCIDENCE_PX.powi(2),
        }
    })
}
