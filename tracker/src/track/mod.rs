//! Tracks: follow each target from frame to frame, and decide on a [`Finding`] for it in each frame (a
//! [`FrameContext`]).
//!
//! ```text
//! predict ─► fit around the prediction ─► accepted? ──────────────────────────────► remember
//!            └ bad ─► from the last estimate ┘ └ no ─► search, taken objects masked ─► the best candidate, or
//!                                                        └ postponed ─► search nearby   coast, or lose
//! ```

mod allowance;
mod appearance;
mod branch;
pub(crate) mod candidate;
mod clock;
mod coordinate;
pub(crate) mod disagreement;
mod drift;
mod faint;
mod kalman_state;
mod levels;
mod memory;
pub(crate) mod motion;
mod naming;
mod nearby;
mod noise;
mod pixel_statistics;
mod pose_history;
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
mod verdicts;
pub(crate) mod window;

use crate::estimate::{Ending, Rejection};
use crate::options::TrackerOptions;
use crate::solve::fit::StartKind;
use crate::solve::stage_kernels::{CompileFailure, PixelHandling};
use crate::track::motion::Predicted;
use crate::verdict::{Surroundings, Verdict};
use candidate::Candidate;
use memory::Memory;
use pixel_statistics::PixelStatistics;
use reconsider::{ResidualKind, StartOrigin};
use robust::HIDDEN_MOST;
use search::Search;
use solver::{Attempt, FrameContext, Solver};
use window::Margin;

/// A χ²/ν this many times the last one makes a fit doubtful.
const MISFIT: f64 = 9.0;
/// Largest change of brightness and area, as a factor, of a target that is found away from the prediction.
const FADED: f64 = 4.0;
/// Margin of the window around a prediction, as a share of the domain.
pub(crate) const MARGIN_SHARE: f64 = 0.1;
/// Further margin, px.
pub(crate) const MARGIN_PX: f64 = 3.0;
/// Further margin, in standard deviations of the prediction.
const MARGIN_DEVIATIONS: f64 = 3.0;
/// Upper limit of both further margins together, px.
pub(crate) const MARGIN_PX_MAX: f64 = 32.0;

/// Largest rounding error of times that are sums of periods.
const ROUNDING_S: f64 = 1e-6;

/// The result of a frame for one target.
pub(crate) enum Finding {
    /// Seen.
    Seen(Box<Candidate>),
    /// Not seen; with its predicted position.
    Coasting(RejectedAttempt, Predicted),
    /// Not seen, and not coasting.
    Missing(RejectedAttempt),
}

/// A rejected fit, or none, with its verdict.
pub(crate) struct RejectedAttempt {
    pub attempt: Attempt,
    pub verdict: Option<Verdict>,
}

impl RejectedAttempt {
    /// An attempt without a verdict.
    pub fn of(attempt: Attempt) -> RejectedAttempt {
        RejectedAttempt { attempt, verdict: None }
    }
}

/// The result of the fit around the prediction.
pub(crate) enum TrackingFit {
    /// Accepted.
    Accepted(Box<Candidate>),
    /// A good fit that needs a search to confirm it, a bad one, or none.
    Uncertain(Option<Box<Candidate>>),
}

/// The track of one target.
#[derive(Clone, Debug, Default)]
pub(crate) struct Track {
    pub memory: Memory,
}

/// Largest standard deviation of a prediction that identifies a target by its position, in half widths of it.
const SURE: f64 = 0.5;

impl Track {
    /// True for a candidate that may be the target: it has its size, or is at its predicted position with a similar χ²/ν and size.
    fn may_be_target(&self, solver: &Solver, candidate: &Candidate, time_s: f64) -> bool {
        let (appearance, attempt) = (&self.memory.appearance, &candidate.attempt);
        let choice = attempt.choice();
        if solver.fits_pose() || !appearance.is_known() {
            return true;
        }
        let is_visible = choice.is_none_or(|choice| choice.hidden <= HIDDEN_MOST);
        let is_as_before = || choice.is_none() && appearance.may_have_become(solver, attempt, time_s);
        is_visible
            && (appearance.may_be(solver, attempt, time_s)
                || (is_as_before() && self.is_in_place(solver, candidate, time_s)))
    }

    /// True at the predicted position, if that is precise enough to exclude other objects.
    fn is_in_place(&self, solver: &Solver, candidate: &Candidate, time_s: f64) -> bool {
        let (Some(predicted), Some(size_px)) = (self.memory.predicted(time_s), self.memory.size_px(solver)) else {
            return false;
        };
        let is_sure =
            (0..predicted.positions().count()).all(|position| predicted.deviation(position) <= SURE * size_px);
        is_sure && self.is_near(solver, candidate, time_s)
    }

    /// Fits around the prediction.
    pub fn follow(&self, solver: &Solver, context: &FrameContext, time_s: f64) -> Result<TrackingFit, CompileFailure> {
        let predicted = self.memory.predicted(time_s);
        let Some(start) = self.memory.start(solver, predicted.as_ref()) else {
            return Ok(TrackingFit::Uncertain(None));
        };
        let mut margin = Margin::even(MARGIN_SHARE, MARGIN_PX);
        if let Some(predicted) = predicted {
            for (axis, px) in margin.px.iter_mut().enumerate().take(solver.model().coordinates().len()) {
                *px = (*px + MARGIN_DEVIATIONS * predicted.deviation(axis)).min(MARGIN_PX_MAX);
            }
        }
        let handling = if self.memory.clipped { PixelHandling::SkipSaturated } else { PixelHandling::All };
        let (start, attempt) = self.nearest(solver, context, start, margin, handling)?;
        if attempt.ending == Ending::NoTarget {
            return Ok(TrackingFit::Uncertain(None));
        }
        let usual = self.memory.reduced_chi_square;
        let left = self.left(solver, context, &attempt);
        let (attempt, _) =
            solver.reconsidered(context, (attempt, left), &start, margin, usual, StartOrigin::Prediction)?;
        let attempt = solver.branched(context, attempt, &start, &self.memory, handling)?;
        let last = || self.memory.last_start();
        let attempt = solver.against_rival(context, attempt, (self.memory.rival.as_ref(), last), handling)?;
        let statistics = self.memory.statistics.updated(solver, context, &attempt);
        let verdict = self.verdict(solver, context, &attempt, statistics);
        let near = Some(self.memory.is_near(solver, &attempt, time_s));
        let lacks_kernels = context.requested_kernels().is_some();
        let candidate = Candidate { near, lacks_kernels, ..Candidate::of(attempt, statistics, verdict) };
        let is_kept = candidate.is_kept(solver)
            && self.is_expected(&candidate.attempt)
            && self.is_near(solver, &candidate, time_s)
            && self.may_be_target(solver, &candidate, time_s);
        let candidate = Box::new(candidate);
        Ok(if is_kept { TrackingFit::Accepted(candidate) } else { TrackingFit::Uncertain(Some(candidate)) })
    }

    /// The kind of residuals of a fit, analysed when a target is seen first, and while a substitute replaces its model.
    fn left(&self, solver: &Solver, context: &FrameContext, attempt: &Attempt) -> ResidualKind {
        let is_asked = self.memory.is_substitute || self.memory.reduced_chi_square.is_none();
        if !is_asked || !solver.model().has_noise() || solver.fits_pose() {
            return ResidualKind::Noise;
        }
        let statistics = self.memory.statistics.updated(solver, context, attempt);
        match statistics.residuals.is_some_and(|residuals| residuals.structure.is_significant()) {
            true => {
                let verdict = self.verdict(solver, context, attempt, statistics);
                ResidualKind::Structure { is_sure: Candidate::of(attempt.clone(), statistics, verdict).is_kept(solver) }
            }
            false => ResidualKind::Noise,
        }
    }

    /// The verdict on a followed target: the one before, while its residuals are unchanged, and across a change of document.
    fn verdict(
        &self,
        solver: &Solver,
        context: &FrameContext,
        attempt: &Attempt,
        statistics: PixelStatistics,
    ) -> Option<Verdict> {
        let is_substitute = attempt.choice().is_some_and(|choice| !choice.is_marginal());
        let is_as_before =
            statistics.residuals == self.memory.statistics.residuals && is_substitute == self.memory.is_substitute;
        match self.memory.verdict {
            Some(before) if is_as_before || self.memory.seen_parameters().is_none() => Some(before),
            Some(before) => Some(before.joined(solver.verdict(context, attempt, &before.surroundings())?)),
            None => solver.verdict(context, attempt, &Surroundings::default()),
        }
    }

    /// The fit from the prediction, or, where that is unexpected, the better one from the last estimate, which may be closer. With
    /// its start.
    fn nearest(
        &self,
        solver: &Solver,
        context: &FrameContext,
        start: Vec<f64>,
        margin: Margin,
        handling: PixelHandling,
    ) -> Result<(Vec<f64>, Attempt), CompileFailure> {
        let attempt = solver.attempt(
            context,
            &start,
            StartKind::Nearby(self.memory.sampling_choice.as_ref()),
            handling,
            margin,
        )?;
        if self.memory.starts_at(&start)
            || (solver.is_fine(&attempt, self.memory.reduced_chi_square) && self.is_expected(&attempt))
        {
            return Ok((start, attempt));
        }
        let Some(last) = self.memory.last_start() else { return Ok((start, attempt)) };
        let again = solver.attempt(context, &last, StartKind::Anywhere, handling, margin)?;
        let rank = |attempt: &Attempt| (!attempt.is_good(), attempt.reduced_chi_square().unwrap_or(f64::INFINITY));
        Ok(if rank(&again) < rank(&attempt) { (last, again) } else { (start, attempt) })
    }

    /// True for a good fit without a jump of χ²/ν.
    fn is_expected(&self, attempt: &Attempt) -> bool {
        attempt.is_good() && !self.is_jump(attempt)
    }

    /// Decides after a search: the doubtful fit, the best unclaimed candidate, or none.
    pub fn decide(
        &self,
        solver: &Solver,
        context: &FrameContext,
        uncertain: Option<Box<Candidate>>,
        search: &mut Search,
        time_s: f64,
    ) -> Finding {
        let suits = |candidate: &Candidate| {
            let looks_alike = self.change(solver, &candidate.attempt) <= FADED;
            let is_possible = !self.is_confirmed()
                || self.is_near(solver, candidate, time_s)
                || (solver.options.targets == 1 && looks_alike && !solver.is_occluded_pose(&candidate.attempt));
            is_possible
                && self.may_be_target(solver, candidate, time_s)
                && !solver.is_renamed(&candidate.attempt, &self.memory)
        };
        let is_taken = |candidate: &Candidate| {
            if self.is_confirmed() { candidate.is_kept(solver) } else { candidate.is_sure(solver) }
        };
        let found = search.best(|candidate| {
            let candidate = self.for_this_track(solver, context, candidate.clone(), time_s);
            let is_believed = solver.is_believed(&candidate.attempt, &self.memory.pose_history);
            (is_believed && suits(&candidate) && is_taken(&candidate)).then_some(candidate)
        });
        let good = uncertain.as_ref().is_some_and(|warm| warm.attempt.is_good() && warm.is_kept(solver));
        match (uncertain.filter(|_| good), found) {
            (Some(warm), Some(found)) => {
                let nearer = !self.is_near(solver, &warm, time_s) && self.is_near(solver, &found.candidate, time_s);
                if nearer || !suits(&warm) {
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
                let best_unclaimed =
                    search.best_unclaimed().map(|candidate| self.for_this_track(solver, context, candidate, time_s));
                let why = best_unclaimed.as_ref().and_then(|candidate| match candidate {
                    candidate if is_taken(candidate) && suits(candidate) => None,
                    candidate if !suits(candidate) => Some(Rejection::Unlike),
                    candidate if candidate.is_ambiguous(solver) => Some(Rejection::OneOfSeveral),
                    _ => Some(Rejection::Unlikely),
                });
                let Some((candidate, rejection)) = best_unclaimed.zip(why) else {
                    return self.missing(solver, context, RejectedAttempt::of(search.failure.clone()), time_s);
                };
                let strongest = search.failure.strongest;
                let attempt = Attempt { rejection: Some(rejection), strongest, ..candidate.attempt };
                self.missing(solver, context, RejectedAttempt { attempt, verdict: candidate.verdict }, time_s)
            }
        }
    }

    fn missing(&self, solver: &Solver, context: &FrameContext, rejected: RejectedAttempt, time_s: f64) -> Finding {
        let TrackerOptions { motion, .. } = &solver.options;
        let predicted = self.memory.predicted(time_s).filter(|_| self.is_confirmed() && self.memory.is_complete());
        let recent = self.memory.seen_s().is_some_and(|seen_s| time_s - seen_s <= motion.coast_s + ROUNDING_S);
        match predicted.filter(|_| recent) {
            Some(predicted) if inside(solver, context, &predicted) => Finding::Coasting(rejected, predicted),
            _ => Finding::Missing(rejected),
        }
    }

    /// The candidate with its distance and verdict as those of this target.
    fn for_this_track(&self, solver: &Solver, context: &FrameContext, candidate: Candidate, time_s: f64) -> Candidate {
        let near = Some(self.memory.is_near(solver, &candidate.attempt, time_s));
        let known = self.memory.verdict.filter(|_| self.is_confirmed());
        let verdict = candidate.verdict.map(|now| known.map_or(now, |known| known.joined(now)));
        Candidate { near, verdict, lacks_kernels: context.requested_kernels().is_some(), ..candidate }
    }

    fn is_confirmed(&self) -> bool {
        self.memory.measurements() >= appearance::CONFIRMED
    }

    /// True when another followed target is there: two tracks of one object.
    fn is_taken(&self, solver: &Solver, candidate: &Candidate, search: &Search) -> bool {
        search.avoided.iter().any(|other| candidate.coincides(solver, other))
    }

    /// The factor by which brightness or area changed since the last good fit, at least 1; 1 where unknown.
    fn change(&self, solver: &Solver, attempt: &Attempt) -> f64 {
        let Some(fit) = &attempt.fit else { return 1.0 };
        let last = self.memory.seen_parameters().unwrap_or_default();
        let brightness = solver.brightness_change(last, &fit.parameters).unwrap_or(1.0);
        brightness.max(self.memory.area_change(solver, &fit.parameters))
    }

    /// True when χ²/ν is far above the last one.
    fn is_jump(&self, attempt: &Attempt) -> bool {
        let summary = attempt.fit.as_ref().and_then(|fit| fit.summary.as_ref());
        let known =
            summary.and_then(|summary| Some((summary.reduced_chi_square?, summary.expected_reduced_chi_square)));
        let known = self.memory.reduced_chi_square.zip(known);
        known.is_some_and(|(last, (reduced, least))| reduced > MISFIT * last.max(least))
    }

    /// See [`Memory::is_near`].
    fn is_near(&self, solver: &Solver, candidate: &Candidate, time_s: f64) -> bool {
        candidate.near.unwrap_or_else(|| self.memory.is_near(solver, &candidate.attempt, time_s))
    }
}

/// True when the predicted centres lie inside the window of the frame.
fn inside(solver: &Solver, context: &FrameContext, predicted: &Predicted) -> bool {
    let (state, _) = predicted.positions_with_covariance();
    let centres = solver.model().roles().iter().flat_map(|roles| roles.centre.iter().enumerate());
    let (first, size) = (context.window.first(), context.window.size());
    centres.zip(state.iter()).all(|((axis, _), at)| {
        let position = at - first[axis] as f64;
        position > -1.0 && position < size[axis] as f64
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
