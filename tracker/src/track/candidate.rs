//! `Candidate`: a fit of something that may be the target, and what speaks for and against it.
//!
//! What comes in: an [`Attempt`] of a [`Solver`]. What goes out: whether it is sure, likely, the same thing as another one, and where
//! it was looked for. It never knows how a search came to it.

use super::ground::Ground;
use super::solver::{Attempt, Solver};
use crate::estimate::Ending;
use crate::outline::shape;
use crate::verdict::Verdict;

/// A definition: a track whose target is less likely than this has lost it.
const LOST: f64 = 0.25;
/// Without a shape: fits that end this near to each other are of one thing, px.
const COINCIDENCE_PX: f64 = 3.0;
/// A fit of something that was seen with a size is of that when its area is the same but for this factor.
const ALIKE: f64 = 6.0;

/// A fit of something that may be the target.
#[derive(Clone, Debug)]
pub(crate) struct Candidate {
    pub attempt: Attempt,
    /// Absent where the model does not allow one.
    pub verdict: Option<Verdict>,
    /// Knowledge of its pixels and of those beside it.
    pub ground: Ground,
    /// Whether it is where a track expects its target, once that track has asked.
    pub near: Option<bool>,
    /// Another fit would have been tried, had its kernels been there.
    pub is_lacking: bool,
}

/// Something that may be the target.
#[derive(Clone, Debug, PartialEq)]
pub struct Sighting {
    /// Of the fit, all of the model's.
    pub parameters: Vec<f64>,
    /// The probability that it is the target, where that can be told.
    pub confidence: Option<f64>,
}

impl Candidate {
    /// A fit of which nothing else is known yet.
    pub fn of(attempt: Attempt, ground: Ground, verdict: Option<Verdict>) -> Candidate {
        Candidate { attempt, verdict, ground, near: None, is_lacking: false }
    }

    /// The probability that it is the target.
    pub fn confidence(&self) -> Option<f64> {
        self.verdict.as_ref().map(Verdict::probability)
    }

    /// True for what is taken for the target: a lone thing, and what is the target with at least the probability that the session asks
    /// for, as far as that is known.
    pub fn is_sure(&self, solver: &Solver) -> bool {
        self.is_likelier(solver.options.confidence_min)
    }

    /// The same of a target that is followed.
    pub fn is_kept(&self, solver: &Solver) -> bool {
        self.is_likelier(solver.options.confidence_min.min(LOST))
    }

    /// True for what would be taken if nothing else were in the frame.
    pub fn is_ambiguous(&self, solver: &Solver) -> bool {
        self.verdict.is_some_and(|verdict| verdict.among(0.0, None).probability() >= solver.options.confidence_min)
    }

    fn is_likelier(&self, least: f64) -> bool {
        self.verdict.is_none_or(|verdict| verdict.is_alone() || verdict.probability() >= least)
    }

    /// True for a fit on another background, or that hides more of the target than scattered outliers do.
    pub fn is_substitute(&self) -> bool {
        self.attempt.choice().is_some_and(|choice| !choice.is_marginal())
    }

    /// True for a fit of every pixel.
    pub fn is_plain(&self) -> bool {
        self.attempt.choice().is_none()
    }

    /// True for a fit that leaves scattered outliers out, and is else the plain one.
    pub fn leaves_outliers_out(&self) -> bool {
        self.attempt.choice().is_some_and(|choice| choice.is_marginal())
    }

    /// True for a fit on a background that bends.
    pub fn is_bent(&self) -> bool {
        self.attempt.choice().is_some_and(|choice| choice.is_bent())
    }

    /// Likelier the target than not, as far as the model can tell; what leaves parameters undetermined is not.
    pub(super) fn is_likely(&self) -> bool {
        let is_determined = || self.attempt.ending != Ending::Singular;
        self.verdict.map_or_else(is_determined, |verdict| verdict.odds() >= 1.0)
    }

    /// True when its centre lies inside the outline of something at `other`.
    pub fn coincides(&self, solver: &Solver, other: &[f64]) -> bool {
        self.attempt.fit.as_ref().is_some_and(|fit| is_inside(solver, &fit.parameters, other))
    }

    /// True when a fit converged inside the outline that it began with, is not of quite another size, leaves nothing undetermined,
    /// and met no saturated pixels, of which anything can be said.
    pub(super) fn stays(&self, solver: &Solver, start: &[f64]) -> bool {
        let Some(fit) = &self.attempt.fit else { return false };
        let sizes = solver.looks(&fit.parameters).0.zip(solver.looks(start).0);
        let is_alike = sizes.is_none_or(|(now, before)| (now - before).abs() <= ALIKE.ln());
        let is_clear = fit.worth.as_ref().is_some_and(|worth| worth.saturated == 0.0);
        is_alike && is_clear && self.attempt.ending == Ending::SmallStep && self.coincides(solver, start)
    }

    /// By which the likeliest of several is taken.
    pub(super) fn odds(&self) -> f64 {
        self.verdict.as_ref().map_or(0.0, Verdict::odds)
    }
}

/// True when the centre of one of the two lies inside the outline of the other.
pub(super) fn is_about(solver: &Solver, one: &[f64], other: &[f64]) -> bool {
    is_inside(solver, one, other) || is_inside(solver, other, one)
}

/// True when the centre of something lies inside the outline of something else.
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
