//! `Candidate`: a fit of something that may be the target, and what speaks for and against it.
//!
//! What comes in: an [`Attempt`] of a [`Solver`]. What goes out: whether it is sure, likely, the same thing as another one, and where
//! it was looked for. It never knows how a search came to it.

use isophote_jit::Window;

use super::evidence::{Evidence, Ground};
use super::solver::{Attempt, Solver};
use super::window::share_inside;
use crate::estimate::Ending;
use crate::outline::shape;

/// What has a lower L, and looks otherwise than it did, is not taken.
const UNLIKE: f64 = -5.8;
/// What has higher log odds need not be looked for any further.
const LIKELY: f64 = 0.0;
/// Without a shape: fits that end this near to each other are of one thing, px.
const COINCIDENCE_PX: f64 = 3.0;
/// A fit of something that was seen with a size is of that when its area is the same but for this factor.
const ALIKE: f64 = 6.0;

/// What ground that is all bumps takes of the log odds of something faint, …
const BUMPS: f64 = 2.0;
/// … and of something of which hardly any is inside the frame; of what has its centre there three quarters of this at most.
const CUT: f64 = 8.0;
/// With less inside, the border cuts it off: what ground there is has to be known.
pub(super) const WHOLE: f64 = 0.9;

/// A fit of something that may be the target.
#[derive(Clone, Debug)]
pub(crate) struct Candidate {
    pub attempt: Attempt,
    /// Absent where the model does not say what is bright.
    pub evidence: Option<Evidence>,
    /// What is beside it, where that was looked at.
    pub ground: Option<Ground>,
    /// Whether it is where a track expects its target, once that track has asked.
    pub near: Option<bool>,
    /// It is no stronger than noise is now and then, and was taken because the document's image found it.
    pub is_faint: bool,
}

/// Something that may be the target.
#[derive(Clone, Debug, PartialEq)]
pub struct Sighting {
    /// Of the fit, all of the model's.
    pub parameters: Vec<f64>,
    /// For and against it; absent where the model does not say what is bright.
    pub evidence: Option<Evidence>,
}

impl Candidate {
    /// With the evidence of the fit alone.
    pub fn of(solver: &Solver, attempt: Attempt, ground: Option<Ground>) -> Candidate {
        let fit = attempt.fit.as_ref().filter(|_| attempt.is_good());
        let evidence = fit.and_then(|fit| Evidence::of(solver, fit, ground));
        Candidate { evidence, attempt, ground, near: None, is_faint: false }
    }

    /// Takes some of the log odds, for good.
    pub fn hold_against(&mut self, log_odds: f64) {
        self.evidence.iter_mut().for_each(|evidence| evidence.oddity += log_odds);
        self.ground.iter_mut().for_each(|ground| ground.oddity += log_odds);
    }

    /// Holds against something faint that such a share of the ground's variance is no noise: what tells it from noise does not tell
    /// it from bumps.
    pub fn doubt_among_bumps(&mut self, share: f64) {
        if self.evidence.is_some_and(|evidence| evidence.contrast < Evidence::CONTRAST_MIN) {
            self.hold_against(BUMPS * share);
        }
    }

    /// Holds against something that the border of the frame cuts off that such a share of the ground's variance is no noise, for
    /// good: any slope that ends at a border is like a part of a target. So is anything beside a border on a background that bends.
    pub fn doubt_cut_off(&mut self, solver: &Solver, whole: Window, share: f64) {
        let Some(fit) = &self.attempt.fit else { return };
        let inside = share_inside(solver.model(), &fit.parameters, whole);
        let share = if fit.choice.is_some_and(|choice| choice.is_bent()) { 1.0 } else { share };
        self.hold_against(CUT * share * (1.0 - inside));
    }

    /// True for what is likely whatever the border cuts off of it: hardly any, or no more than ground with such a share of bumps allows.
    pub fn stands(&self, solver: &Solver, whole: Window, bumps: Option<f64>) -> bool {
        let Some(fit) = &self.attempt.fit else { return false };
        let Some(bumps) = bumps else { return share_inside(solver.model(), &fit.parameters, whole) >= WHOLE };
        let mut doubted = self.clone();
        doubted.doubt_cut_off(solver, whole, bumps);
        doubted.is_likely()
    }

    /// The probability that it is the target.
    pub fn confidence(&self) -> Option<f64> {
        self.evidence.as_ref().map(Evidence::confidence)
    }

    /// True when it is the target with at least the probability that the session asks for, as far as that is known.
    pub fn is_sure(&self, solver: &Solver) -> bool {
        self.confidence().is_none_or(|confidence| confidence >= solver.options.confidence_min)
    }

    /// True for what is hardly a target, as far as that is known.
    pub fn is_unlike(&self) -> bool {
        self.log_odds().is_some_and(|log_odds| log_odds < UNLIKE)
    }

    /// The log odds of its evidence.
    pub fn log_odds(&self) -> Option<f64> {
        self.evidence.as_ref().map(Evidence::log_odds)
    }

    /// True for a fit on another background, or that hides more of the target than scattered outliers do.
    pub fn is_substitute(&self) -> bool {
        self.attempt.fit.as_ref().and_then(|fit| fit.choice).is_some_and(|choice| !choice.is_marginal())
    }

    /// The target, as far as the model can tell; what leaves parameters undetermined is not.
    pub(super) fn is_likely(&self) -> bool {
        let is_determined = || self.attempt.ending != Ending::Singular;
        self.log_odds().map_or_else(is_determined, |log_odds| log_odds >= LIKELY)
    }

    /// True when its centre lies inside the outline of something at `other`.
    pub fn coincides(&self, solver: &Solver, other: &[f64]) -> bool {
        self.attempt.fit.as_ref().is_some_and(|fit| is_inside(solver, &fit.parameters, other))
    }

    /// True when the centre of one of the two lies inside the outline of the other.
    pub(super) fn is_about(&self, solver: &Solver, other: &[f64]) -> bool {
        self.attempt.fit.as_ref().is_some_and(|fit| is_about(solver, &fit.parameters, other))
    }

    /// True when a fit ended inside the outline that it began with, is not of quite another size, leaves nothing undetermined,
    /// and met no saturated pixels, of which anything can be said.
    pub(super) fn stays(&self, solver: &Solver, start: &[f64]) -> bool {
        let Some(fit) = &self.attempt.fit else { return false };
        let sizes = solver.looks(&fit.parameters).0.zip(solver.looks(start).0);
        let is_alike = sizes.is_none_or(|(now, before)| (now - before).abs() <= ALIKE.ln());
        let is_clear = fit.worth.as_ref().is_some_and(|worth| worth.saturated == 0.0);
        is_alike && is_clear && self.attempt.ending != Ending::Singular && self.coincides(solver, start)
    }

    pub(super) fn rank(&self) -> f64 {
        self.evidence.as_ref().map_or(f64::NEG_INFINITY, Evidence::rank)
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
