//! Tracks: what is remembered of a target from frame to frame, and what a frame is believed to say about it.
//!
//! What comes in: frames as a [`Look`], a [`Solver`]. What goes out: for each target a [`Finding`]. It never knows a
//! session, nor how an estimate is published.
//!
//! ```text
//! predict ─► fit around the prediction ─► believed? ──────────────────────────────► remember
//!            └ astray ─► from the last estimate ┘ └ no ─► search, what is taken masked ─► the best that may be it, or
//!                                                           └ not now ─► search nearby     coast, or lose
//! ```

mod allowance;
mod branch;
pub(crate) mod candidate;
mod clock;
mod coordinate;
mod course;
pub(crate) mod disagreement;
mod elsewhere;
mod faint;
mod gone;
mod ground;
mod judged;
mod levels;
mod looks;
mod memory;
pub(crate) mod motion;
mod naming;
mod nearby;
mod noise;
mod past;
mod posed;
pub(crate) mod publish;
mod quality;
mod reconsider;
mod rival;
mod robust;
mod rows;
pub(crate) mod search;
pub(crate) mod shared;
pub(crate) mod snapshot;
pub(crate) mod solver;
pub(crate) mod tracker;
mod uneven;
pub(crate) mod window;

use crate::estimate::{Ending, Rejection};
use crate::options::TrackerOptions;
use crate::solve::fit::Begin;
use crate::solve::stage_kernels::{CompileFailure, Control};
use crate::track::motion::Predicted;
use crate::verdict::Verdict;
use candidate::Candidate;
use ground::Ground;
use memory::Memory;
use reconsider::{Left, StartOrigin};
use robust::HIDDEN_MOST;
use search::Search;
use solver::{Attempt, Look, Solver};
use window::Margin;

/// A reduced χ² this many times the last one asks for a second opinion.
const MISFIT: f64 = 9.0;
/// A brightness that changed by more than this factor from one frame to the next asks for one, too: a fit that lost its
/// target settles on whatever faint thing is near. So does an area.
const FADED: f64 = 4.0;
/// The window around a prediction is larger than the domain by this share, …
pub(crate) const MARGIN_SHARE: f64 = 0.1;
/// … by so many px, …
pub(crate) const MARGIN_PX: f64 = 3.0;
/// … and by so many standard deviations of the prediction, …
const MARGIN_DEVIATIONS: f64 = 3.0;
/// … but by no more than this, px.
pub(crate) const MARGIN_PX_MAX: f64 = 32.0;

/// Times that are sums of periods differ by less than this from what they should be.
const ROUNDING_S: f64 = 1e-6;

/// What a frame says about one target.
pub(crate) enum Finding {
    /// There it is.
    Seen(Box<Candidate>),
    /// It is not; where it should be by now.
    Coasting(NotTaken, Predicted),
    /// It is not, and nobody knows where it may be.
    Missing(NotTaken),
}

/// A fit that is not taken for the target, or none, and how likely it is of that.
pub(crate) struct NotTaken {
    pub attempt: Attempt,
    pub verdict: Option<Verdict>,
}

impl NotTaken {
    /// Without a verdict.
    pub fn of(attempt: Attempt) -> NotTaken {
        NotTaken { attempt, verdict: None }
    }
}

/// What became of the fit around the prediction.
pub(crate) enum Followed {
    /// Believed.
    Kept(Box<Candidate>),
    /// A good fit that needs a second opinion, a bad one, or none.
    Doubtful(Option<Box<Candidate>>),
}

/// One target.
#[derive(Clone, Debug, Default)]
pub(crate) struct Track {
    pub memory: Memory,
}

/// A prediction this sure, in half widths of the target, says where it is.
const SURE: f64 = 0.5;

impl Track {
    /// True for what may be taken for the target: it is of its size, or in its place, explained as well and of about its size.
    fn inherits(&self, solver: &Solver, candidate: &Candidate, time_s: f64) -> bool {
        let (looks, attempt) = (&self.memory.looks, &candidate.attempt);
        let choice = attempt.choice();
        if solver.fits_pose() || !looks.is_known() {
            return true;
        }
        let is_told = choice.is_none_or(|choice| choice.hidden <= HIDDEN_MOST);
        let is_as_before = || choice.is_none() && looks.may_have_become(solver, attempt, time_s);
        is_told
            && (looks.may_be(solver, attempt, time_s)
                || (is_as_before() && self.is_in_place(solver, candidate, time_s)))
    }

    /// Where it is expected, so surely that no other thing could be.
    fn is_in_place(&self, solver: &Solver, candidate: &Candidate, time_s: f64) -> bool {
        let (Some(predicted), Some(size_px)) = (self.memory.predicted(time_s), self.memory.size_px(solver)) else {
            return false;
        };
        let is_sure = (0..predicted.positions().count()).all(|place| predicted.deviation(place) <= SURE * size_px);
        is_sure && self.is_near(solver, candidate, time_s)
    }

    /// Fits around the prediction.
    pub fn follow(&self, solver: &Solver, look: &Look, time_s: f64) -> Result<Followed, CompileFailure> {
        let predicted = self.memory.predicted(time_s);
        let Some(start) = self.memory.start(solver, predicted.as_ref()) else { return Ok(Followed::Doubtful(None)) };
        let mut margin = Margin::even(MARGIN_SHARE, MARGIN_PX);
        if let Some(predicted) = predicted {
            for (axis, px) in margin.px.iter_mut().enumerate().take(solver.model().coordinates().len()) {
                *px = (*px + MARGIN_DEVIATIONS * predicted.deviation(axis)).min(MARGIN_PX_MAX);
            }
        }
        let control = if self.memory.clipped { Control::Dropping } else { Control::Plain };
        let (start, attempt) = self.nearest(solver, look, start, margin, control)?;
        if attempt.ending == Ending::NoTarget {
            return Ok(Followed::Doubtful(None));
        }
        let usual = self.memory.reduced;
        let left = self.left(solver, look, &attempt);
        let (attempt, _) =
            solver.reconsidered(look, (attempt, left), &start, margin, usual, StartOrigin::Prediction)?;
        let attempt = solver.branched(look, attempt, &start, &self.memory, control)?;
        let last = || self.memory.last_start();
        let attempt = solver.against_rival(look, attempt, (self.memory.rival.as_ref(), last), control)?;
        let ground = self.memory.ground.looked_at(solver, look, &attempt);
        let verdict = self.verdict(solver, look, &attempt, ground);
        let near = Some(self.memory.is_near(solver, &attempt, time_s));
        let is_lacking = look.wanted().is_some();
        let candidate = Candidate { near, is_lacking, ..Candidate::of(attempt, ground, verdict) };
        // What suddenly hides half of a target may be half of the target, elsewhere.
        let is_sudden = candidate.is_substitute() && self.memory.reduced.is_some() && !self.memory.is_substitute;
        let is_kept = !is_sudden
            && candidate.is_kept(solver)
            && self.is_expected(solver, &candidate.attempt)
            && self.is_near(solver, &candidate, time_s)
            && self.inherits(solver, &candidate, time_s);
        let candidate = Box::new(candidate);
        Ok(if is_kept { Followed::Kept(candidate) } else { Followed::Doubtful(Some(candidate)) })
    }

    /// What a fit leaves unexplained, which is asked when a target is seen first, and while a
    /// substitute takes its model's place.
    fn left(&self, solver: &Solver, look: &Look, attempt: &Attempt) -> Left {
        let is_asked = self.memory.is_substitute || self.memory.reduced.is_none();
        if !is_asked || !solver.model().has_noise() || solver.fits_pose() {
            return Left::Noise;
        }
        let ground = self.memory.ground.looked_at(solver, look, attempt);
        if ground.explains(attempt) {
            return Left::Ground;
        }
        match ground.own.is_some_and(|own| own.structure.is_told()) {
            true => {
                let verdict = self.verdict(solver, look, attempt, ground);
                Left::Structure { is_sure: Candidate::of(attempt.clone(), ground, verdict).is_kept(solver) }
            }
            false => Left::Noise,
        }
    }

    /// How likely the target is still followed: as before, while its residuals are as they were. Another document is of the same target.
    fn verdict(&self, solver: &Solver, look: &Look, attempt: &Attempt, ground: Ground) -> Option<Verdict> {
        let is_substitute = attempt.choice().is_some_and(|choice| !choice.is_marginal());
        let is_as_before = ground.own == self.memory.ground.own && is_substitute == self.memory.is_substitute;
        match self.memory.verdict {
            Some(before) if is_as_before || self.memory.looked().is_none() => Some(before),
            Some(before) => Some(before.joined(solver.verdict(look, attempt, before.others())?)),
            None => solver.verdict(look, attempt, 0.0),
        }
    }

    /// The fit from a prediction, or the better one from the last estimate where that one is not what was expected: a
    /// prediction may be farther off than the place that it began at. With the start that led to it.
    fn nearest(
        &self,
        solver: &Solver,
        look: &Look,
        start: Vec<f64>,
        margin: Margin,
        control: Control,
    ) -> Result<(Vec<f64>, Attempt), CompileFailure> {
        let attempt = solver.attempt(look, &start, Begin::Nearby(self.memory.chosen.as_ref()), control, margin)?;
        if self.memory.starts_at(&start)
            || (solver.is_fine(&attempt, self.memory.reduced) && self.is_expected(solver, &attempt))
        {
            return Ok((start, attempt));
        }
        let Some(last) = self.memory.last_start() else { return Ok((start, attempt)) };
        let view = || solver.view(look, solver.window(look, &last, margin));
        if attempt.ending == Ending::NoTarget && solver.is_gone(&view(), &last) {
            return Ok((start, attempt));
        }
        let again = solver.attempt(look, &last, Begin::Anywhere, control, margin)?;
        let rank = |attempt: &Attempt| (!attempt.is_good(), attempt.reduced().unwrap_or(f64::INFINITY));
        Ok(if rank(&again) < rank(&attempt) { (last, again) } else { (start, attempt) })
    }

    /// A good fit of what looks as it did.
    fn is_expected(&self, solver: &Solver, attempt: &Attempt) -> bool {
        attempt.is_good() && self.change(solver, attempt) <= FADED && !self.is_jump(attempt)
    }

    /// Decides after a search: the doubtful fit, the best candidate that nobody has taken, or nothing.
    pub fn settle(
        &self,
        solver: &Solver,
        look: &Look,
        doubtful: Option<Box<Candidate>>,
        search: &mut Search,
        time_s: f64,
    ) -> Finding {
        let suits = |candidate: &Candidate| {
            let looks_alike = self.change(solver, &candidate.attempt) <= FADED;
            let is_possible = !self.is_confirmed()
                || self.is_near(solver, candidate, time_s)
                || (solver.options.targets == 1 && looks_alike && !solver.is_veiled_pose(&candidate.attempt));
            is_possible
                && self.inherits(solver, candidate, time_s)
                && !self.is_other(candidate)
                && !solver.is_renamed(&candidate.attempt, &self.memory)
        };
        let is_taken = |candidate: &Candidate| {
            if self.is_confirmed() { candidate.is_kept(solver) } else { candidate.is_sure(solver) }
        };
        let found = search.best(|candidate| {
            let candidate = self.expecting(solver, look, candidate.clone(), time_s);
            let is_believed = solver.is_believed(&candidate.attempt, &self.memory.past);
            (is_believed && suits(&candidate) && is_taken(&candidate)).then_some(candidate)
        });
        let good = doubtful.as_ref().is_some_and(|warm| warm.attempt.is_good() && warm.is_kept(solver));
        match (doubtful.filter(|_| good), found) {
            (Some(warm), Some(found)) => {
                let (was, is) = (self.change(solver, &warm.attempt), self.change(solver, &found.candidate.attempt));
                let truer = was > FADED && is < was;
                let nearer = !self.is_near(solver, &warm, time_s) && self.is_near(solver, &found.candidate, time_s);
                let better = found.candidate.attempt.reduced() < warm.attempt.reduced();
                let plainer = warm.is_substitute()
                    && !found.candidate.is_substitute()
                    && self.is_near(solver, &found.candidate, time_s)
                    && solver.is_fine(&found.candidate.attempt, self.memory.reduced);
                if truer || nearer || better || plainer || !suits(&warm) {
                    search.claim(found.index);
                    return Finding::Seen(Box::new(found.candidate));
                }
                Finding::Seen(warm)
            }
            (None, Some(found)) => {
                search.claim(found.index);
                Finding::Seen(Box::new(found.candidate))
            }
            (Some(warm), None) if suits(&warm) && !self.is_taken(solver, &warm, search) => Finding::Seen(warm),
            _ => {
                let doubted = search.doubted().map(|candidate| self.expecting(solver, look, candidate, time_s));
                let why = doubted.as_ref().and_then(|candidate| match candidate {
                    candidate if is_taken(candidate) && suits(candidate) => None,
                    candidate if !suits(candidate) => Some(Rejection::Unlike),
                    candidate if candidate.is_ambiguous(solver) => Some(Rejection::OneOfSeveral),
                    _ => Some(Rejection::Unlikely),
                });
                let Some((candidate, rejection)) = doubted.zip(why) else {
                    return self.missing(solver, look, NotTaken::of(search.failure.clone()), time_s);
                };
                let strongest = search.failure.strongest;
                let attempt = Attempt { rejection: Some(rejection), strongest, ..candidate.attempt };
                self.missing(solver, look, NotTaken { attempt, verdict: candidate.verdict }, time_s)
            }
        }
    }

    fn missing(&self, solver: &Solver, look: &Look, not_taken: NotTaken, time_s: f64) -> Finding {
        let TrackerOptions { motion, .. } = &solver.options;
        let predicted = self.memory.predicted(time_s).filter(|_| self.is_confirmed() && self.memory.is_complete());
        let recent = self.memory.seen_s().is_some_and(|seen_s| time_s - seen_s <= motion.coast_s + ROUNDING_S);
        match predicted.filter(|_| recent) {
            Some(predicted) if inside(solver, look, &predicted) => Finding::Coasting(not_taken, predicted),
            _ => Finding::Missing(not_taken),
        }
    }

    /// The same candidate with what is known of the target, if it is that.
    fn expecting(&self, solver: &Solver, look: &Look, candidate: Candidate, time_s: f64) -> Candidate {
        let near = Some(self.memory.is_near(solver, &candidate.attempt, time_s));
        let known = self.memory.verdict.filter(|_| self.is_confirmed());
        let verdict = candidate.verdict.map(|now| known.map_or(now, |known| known.joined(now)));
        Candidate { near, verdict, is_lacking: look.wanted().is_some(), ..candidate }
    }

    fn is_confirmed(&self) -> bool {
        self.memory.measurements() >= looks::CONFIRMED
    }

    /// A followed target has taken the place: two tracks are one thing.
    fn is_taken(&self, solver: &Solver, candidate: &Candidate, search: &Search) -> bool {
        search.avoided.iter().any(|other| candidate.coincides(solver, other))
    }

    /// By which factor brightness or area changed since the last good fit, up or down; 1 where unknown.
    fn change(&self, solver: &Solver, attempt: &Attempt) -> f64 {
        let Some(fit) = &attempt.fit else { return 1.0 };
        let last = self.memory.looked().unwrap_or_default();
        let brightness = solver.brightness_change(last, &fit.parameters).unwrap_or(1.0);
        brightness.max(self.memory.area_change(solver, &fit.parameters))
    }

    /// A target that was explained, in its place something that is not, however like it in size.
    fn is_other(&self, candidate: &Candidate) -> bool {
        self.is_confirmed() && candidate.verdict.is_some() && !candidate.is_likely() && self.is_jump(&candidate.attempt)
    }

    /// A χ²/ν far above the last one.
    fn is_jump(&self, attempt: &Attempt) -> bool {
        let worth = attempt.fit.as_ref().and_then(|fit| fit.worth.as_ref());
        let known = worth.and_then(|worth| Some((worth.reduced?, worth.reduced_least)));
        let known = self.memory.reduced.zip(known);
        known.is_some_and(|(last, (reduced, least))| reduced > MISFIT * last.max(least))
    }

    /// Inside the gate, or no farther off than the target is large; true where nothing was expected.
    fn is_near(&self, solver: &Solver, candidate: &Candidate, time_s: f64) -> bool {
        candidate.near.unwrap_or_else(|| self.memory.is_near(solver, &candidate.attempt, time_s))
    }
}

/// The predicted centres lie in the part of the frame that may be looked at.
fn inside(solver: &Solver, look: &Look, predicted: &Predicted) -> bool {
    let (state, _) = predicted.places();
    let centres = solver.model().roles().iter().flat_map(|roles| roles.centre.iter().enumerate());
    let (first, size) = (look.window.first(), look.window.size());
    centres.zip(state.iter()).all(|((axis, _), at)| {
        let place = at - first[axis] as f64;
        place > -1.0 && place < size[axis] as f64
    })
}

#[cfg(test)]
mod tests;

#[cfg(test)]
mod confidence_tests;
#[cfg(test)]
mod faint_tests;
#[cfg(test)]
mod identity_tests;
#[cfg(test)]
mod jitter_tests;
#[cfg(test)]
mod robust_tests;
#[cfg(test)]
mod sampling_tests;
#[cfg(test)]
mod snapshot_tests;
#[cfg(test)]
mod swap_tests;
#[cfg(test)]
mod unknown_tests;
