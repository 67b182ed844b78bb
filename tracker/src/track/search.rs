//! A search: everything in a frame that may be a target, each verified by a fit, the likeliest first.
//!
//! What comes in: a frame, starting values that are given, and targets that are followed already. What goes out:
//! [`Candidate`]s. It never knows which track will take one.

use super::evidence::Evidence;
use super::memory::Memory;
use super::solver::{Attempt, Look, Solver};
use super::window::{Margin, shape};
use crate::cold::{Cold, Starts};
use crate::compiled::{CompileFailure, Control};
use crate::estimate::Ending;

/// Things that are fitted at most, …
const SIGHTS_MAX: usize = 24;
/// The window around a thing that was seen is larger than the domain by this share …
const MARGIN_SHARE: f64 = 0.5;
/// … and by so many px.
const MARGIN_PX: f64 = 6.0;
/// Without a shape: fits that end this near to each other are of one thing, px.
const COINCIDENCE_PX: f64 = 3.0;

/// A fit of something that may be the target.
#[derive(Clone, Debug)]
pub(crate) struct Candidate {
    pub attempt: Attempt,
    /// Absent where the model does not say what is bright.
    pub evidence: Option<Evidence>,
    /// Of a pixel of the background, where it was looked at.
    pub variance: Option<f64>,
}

/// Something that may be the target.
#[derive(Clone, Debug, PartialEq)]
pub struct Sighting {
    /// Of the fit, all of the model's.
    pub parameters: Vec<f64>,
    /// For and against it; absent where the model does not say what is bright.
    pub evidence: Option<Evidence>,
}

/// What a search came to.
pub(crate) struct Search {
    candidates: Vec<Candidate>,
    claimed: Vec<bool>,
    /// What to report when there is none: the best of the fits that are not believed.
    pub failure: Attempt,
    /// Parameters of the targets that were followed already.
    pub avoided: Vec<Vec<f64>>,
}

/// The best candidate, and its number.
pub(crate) struct Pick {
    pub index: usize,
    pub candidate: Candidate,
}

impl Candidate {
    /// With the evidence of the fit alone.
    pub fn of(solver: &Solver, attempt: Attempt, variance: Option<f64>) -> Candidate {
        let fit = attempt.fit.as_ref().filter(|_| attempt.is_good());
        let evidence = fit.and_then(|fit| Evidence::of(solver, fit, variance));
        Candidate { evidence, attempt, variance }
    }

    /// The probability that it is the target.
    pub fn confidence(&self) -> Option<f64> {
        self.evidence.as_ref().map(Evidence::confidence)
    }

    /// True when its centre lies inside the outline of something at `other`.
    pub fn coincides(&self, solver: &Solver, other: &[f64]) -> bool {
        let Some(fit) = &self.attempt.fit else { return false };
        let dimensions = solver.model().coordinates().len();
        solver.model().roles().iter().any(|roles| {
            let off: Vec<f64> =
                roles.centre.iter().map(|p| fit.parameters[p.index()] - other[p.index()]).collect();
            match shape(roles, dimensions, other).filter(|a| a.nrows() == off.len() && !off.is_empty()) {
                Some(a) => {
                    let term = |i: usize| (0..off.len()).map(|j| off[i] * a[(i, j)] * off[j]).sum::<f64>();
                    (0..off.len()).map(term).sum::<f64>() <= 1.0
                }
                None => !off.is_empty() && off.iter().map(|d| d * d).sum::<f64>() <= COINCIDENCE_PX.powi(2),
            }
        })
    }

    fn rank(&self) -> f64 {
        self.evidence.as_ref().map_or(f64::NEG_INFINITY, Evidence::rank)
    }
}

impl Search {
    /// Looks at the whole of what may be looked at. `given` numbers take the place of what is seen; `avoided` are the
    /// parameters of targets that are followed already.
    pub fn run(
        solver: &Solver,
        look: &Look,
        given: &[Option<f64>],
        avoided: Vec<Vec<f64>>,
    ) -> Result<Search, CompileFailure> {
        let mut search =
            Search { candidates: Vec::new(), claimed: Vec::new(), failure: Attempt::none(Ending::NoTarget), avoided };
        let masks = search.avoided.iter().filter_map(|parameters| solver.mask(look, parameters)).collect();
        let sights_max = if solver.reaches() { SIGHTS_MAX } else { 1 };
        let view = solver.view(look, look.window);
        let Some(cold) = Cold::look(solver.model(), &view, &solver.constants, given, sights_max, masks) else {
            return Ok(search);
        };
        for starts in &cold.sights {
            let attempt = best(solver, look, starts, cold.control)?;
            if attempt.is_good() {
                let candidate = Candidate::of(solver, attempt, cold.variance);
                let is_avoided = search.avoided.iter().any(|other| candidate.coincides(solver, other));
                search.candidates.extend((!is_avoided).then_some(candidate));
                if cold.is_placed {
                    break; // it was said where, and there it is
                }
            } else if search.failure.fit.is_none() {
                search.failure = attempt;
            }
        }
        // Stable: where there is no evidence the most massive stays first.
        search.candidates.sort_by(|a, b| b.rank().total_cmp(&a.rank()));
        search.merge(solver);
        search.claimed = vec![false; search.candidates.len()];
        Ok(search)
    }

    /// Of several fits of one thing the best remains.
    fn merge(&mut self, solver: &Solver) {
        let mut kept: Vec<Candidate> = Vec::new();
        for candidate in self.candidates.drain(..) {
            let parameters = |one: &Candidate| one.attempt.fit.as_ref().map(|fit| fit.parameters.clone());
            let same = |other: &Candidate| {
                let theirs = parameters(other).is_some_and(|other| candidate.coincides(solver, &other));
                theirs || parameters(&candidate).is_some_and(|ours| other.coincides(solver, &ours))
            };
            if !kept.iter().any(same) {
                kept.push(candidate);
            }
        }
        self.candidates = kept;
    }

    /// The likeliest that nobody has claimed, of those that `admit` lets through.
    pub fn best(&self, admit: impl Fn(&Candidate) -> Option<Candidate>) -> Option<Pick> {
        let free = self.candidates.iter().enumerate().filter(|(index, _)| !self.claimed[*index]);
        let admitted = free.filter_map(|(index, candidate)| Some(Pick { index, candidate: admit(candidate)? }));
        // The first of equals.
        admitted.reduce(|best, next| if next.candidate.rank() > best.candidate.rank() { next } else { best })
    }

    /// What there is, for people.
    pub fn sightings(&self, solver: &Solver) -> Vec<Sighting> {
        let sighting = |candidate: &Candidate| {
            let strangeness = Memory::default().strangeness(solver, &candidate.attempt);
            let evidence = candidate.evidence.map(|evidence| Evidence { strangeness, ..evidence });
            Some(Sighting { parameters: candidate.attempt.fit.as_ref()?.parameters.clone(), evidence })
        };
        self.candidates.iter().filter_map(sighting).collect()
    }

    /// A track has taken it.
    pub fn claim(&mut self, index: usize) {
        self.claimed[index] = true;
    }
}

/// The believable fit with the smallest χ²/ν, if any is.
fn best(solver: &Solver, look: &Look, starts: &Starts, control: Control) -> Result<Attempt, CompileFailure> {
    let margin = Margin::even(MARGIN_SHARE, MARGIN_PX);
    let mut best: Option<Attempt> = None;
    for start in starts.starts.iter().chain(&starts.tighter) {
        let last_resort = Some(start) == starts.tighter.as_ref();
        if last_resort && best.as_ref().is_some_and(Attempt::is_good) {
            break;
        }
        let attempt = solver.attempt(look, start, control, margin)?;
        let rank = |attempt: &Attempt| (!attempt.is_good(), attempt.reduced().unwrap_or(f64::INFINITY));
        if best.as_ref().is_none_or(|best| rank(&attempt) < rank(best)) {
            best = Some(attempt);
        }
    }
    Ok(best.unwrap_or(Attempt::none(Ending::NoTarget)))
}
