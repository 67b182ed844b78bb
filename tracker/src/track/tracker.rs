//! `Tracker`: follows targets from frame to frame. Every frame gets one [`Estimate`] per target. It reads no clock and
//! no source.
//!
//! A target that is followed is fitted around its predicted position. One that is not found there, or was never found,
//! is searched for in the whole frame, with the followed targets masked. See [`crate::track`].

use std::sync::Arc;

use isophote_symbolic::Model;

use crate::budget::{FrameBudget, Stop, Watch};
use crate::estimate::{Ending, Estimate, Rejection, TrackState};
use crate::exposure::{Advisor, Best, is_advisable};
use crate::options::{TrackError, TrackerOptions};
use crate::preview::Viewer;
use crate::solve::compiled::Compiled;
use crate::solve::prepare::Preparation;
use crate::solve::readiness::FrameReadiness;
use crate::solve::stage_kernels::CompileFailure;
use crate::track::candidate::{Candidate, Sighting};
use crate::track::clock::FrameClock;
use crate::track::publish::{EstimateInputs, estimate};
use crate::track::search::Search;
use crate::track::shared::{Carried, SharedParameters};
use crate::track::snapshot::{Restored, Snapshot, SnapshotError};
use crate::track::solver::{Attempt, FrameContext, Solver};
use crate::track::window::Margin;
use crate::track::{Finding, MARGIN_PX, MARGIN_SHARE, RejectedAttempt, Track, TrackingFit};
use crate::verdict::Signs;
use isophote_frame::Frame;

/// Follows one target or several of the same model.
pub struct Tracker {
    pub(crate) solver: Solver,
    pub(super) tracks: Vec<Track>,
    advisor: Option<Advisor>,
    clock: FrameClock,
    /// Kernels that frames were fitted without.
    wanted: Option<Preparation>,
    /// Kernels of the last frame's fits beside the model's own.
    ready: FrameReadiness,
}

impl Tracker {
    /// A tracker that has not found any target yet.
    ///
    /// # Errors
    /// When a start or constant is unknown to the model or invalid, or the precisions of `compiled` and `options` differ.
    pub fn new(compiled: Arc<Compiled>, options: TrackerOptions) -> Result<Tracker, TrackError> {
        options.check(compiled.model())?;
        if options.precision != compiled.precision() {
            return Err(TrackError::Precision { wanted: options.precision, compiled: compiled.precision() });
        }
        let tracks = vec![Track::default(); options.targets];
        let solver = Solver::new(compiled, options);
        let (clock, ready) = (FrameClock::default(), FrameReadiness::default());
        Ok(Tracker { advisor: advisor(&solver), solver, tracks, clock, wanted: None, ready })
    }

    /// The model's kernels.
    pub fn compiled(&self) -> &Arc<Compiled> {
        &self.solver.compiled
    }

    /// Switches to another model from the next frame on. Carried over: parameters of the same role, else of the same
    /// name, if they lie inside the new bounds; positions, motion and coasting, for models that both have centres, or
    /// both a pose. The rest starts anew. Starts and constants that the new model does not have are ignored: they
    /// belonged to the old one. The values are those of the first target.
    pub fn swap(&mut self, compiled: Arc<Compiled>, options: TrackerOptions) -> Carried {
        self.tracks.resize_with(options.targets, Track::default);
        let old = self.solver.compiled.clone();
        let shared = SharedParameters::of(&old, &compiled, &options);
        let first = self.tracks.first().and_then(|track| track.memory.warm.as_deref());
        let mut carried = shared.report(first);
        for track in &mut self.tracks {
            track.memory = track.memory.swapped(&shared);
        }
        self.solver = Solver::new(compiled.clone(), options);
        self.wanted = None;
        self.advisor = advisor(&self.solver);
        let moving = self.names().into_iter().zip(&self.tracks).filter(|(_, track)| track.memory.measurements() > 0);
        carried.moving = moving.map(|(name, _)| name).collect();
        carried
    }

    /// A copy with the same memory, to try a frame without changing this tracker.
    pub fn fork(&self) -> Tracker {
        let solver = Solver::new(self.solver.compiled.clone(), self.solver.options.clone());
        let (tracks, clock) = (self.tracks.clone(), self.clock);
        let advisor = restored_advisor(&solver, self.advisor.as_ref().map(Advisor::known));
        Tracker { advisor, solver, tracks, clock, wanted: None, ready: self.ready }
    }

    /// A viewer that renders frames with this tracker's estimates, until a swap. It costs nothing before its first use.
    pub fn viewer(&self) -> Viewer {
        Viewer::new(self.solver.compiled.clone(), self.solver.options.clone())
    }

    /// Whether the next fit can start from the last position of at least one target.
    pub fn is_following(&self) -> bool {
        self.tracks.iter().any(|track| track.memory.last_start().is_some())
    }

    /// Discards positions and motion: targets keep their names, and are searched for.
    pub fn lose(&mut self) {
        self.tracks.iter_mut().for_each(|track| track.memory.lose());
    }

    /// Its options.
    pub fn options(&self) -> &TrackerOptions {
        &self.solver.options
    }

    /// True where estimates of this model may carry advice about exposure.
    pub fn advises_exposure(&self) -> bool {
        is_advisable(&self.solver, self.solver.options.exposure.unwrap_or_default())
    }

    /// The targets' ids, in the order of their numbers.
    pub fn names(&self) -> Vec<String> {
        (0..self.tracks.len()).map(|number| name(self.solver.model(), self.tracks.len(), number)).collect()
    }

    /// Everything in a frame that may be the target, each verified by a fit, the likeliest first; nothing is remembered.
    /// Empty where nothing stands out, and where the frame does not suit the model.
    pub fn sightings(&self, frame: &Frame) -> Vec<Sighting> {
        let frame = self.solver.mended(frame);
        let Some(context) = self.solver.context(&frame) else { return Vec::new() };
        let given = self.solver.options.start_of(self.solver.model());
        let search = Search::run(&self.solver, &context, &given, Vec::new(), None);
        search.map(|search| search.sightings()).unwrap_or_default()
    }

    /// Fits one frame; the first target's estimate.
    pub fn track(&mut self, frame: &Frame) -> Estimate {
        let mut all = self.track_all(frame);
        all.swap_remove(0)
    }

    /// Fits one frame; an estimate per target, in the order of their numbers; never empty.
    pub fn track_all(&mut self, frame: &Frame) -> Vec<Estimate> {
        self.track_all_while(frame, &|| None::<Stop>)
    }

    /// Kernels that frames since the last call lacked, to be prepared on another thread.
    pub fn wanted(&mut self) -> Option<Preparation> {
        self.wanted.take()
    }

    /// [`Tracker::track_all`], stopped by `watch`, which is asked before every pass and every step of a search. A
    /// target whose fit was done by then is tracked, and so is one whose fit had reached an acceptable point when the
    /// budget was used up; for the others the ending says why not, and their memory is unchanged. Where `watch`
    /// postpones the search of the whole window, targets that were followed are searched for near their expected
    /// positions.
    pub fn track_all_while(&mut self, frame: &Frame, watch: &dyn Watch) -> Vec<Estimate> {
        self.track_with_readiness(frame, None, watch)
    }

    /// [`Tracker::track_all_while`] for a frame that was fitted before, with the kernels that its fits had then
    /// ([`Tracker::readiness`]): from the same state, with a watch that stops it at the same point, estimates are the
    /// same bit for bit.
    pub fn track_all_again(&mut self, frame: &Frame, ready: FrameReadiness, watch: &dyn Watch) -> Vec<Estimate> {
        self.track_with_readiness(frame, Some(ready), watch)
    }

    /// The kernels that the fits of the last frame had beside the model's own.
    pub fn readiness(&self) -> FrameReadiness {
        self.ready
    }

    /// Its complete state: later estimates depend on nothing else but the frames, the model and the options.
    pub fn snapshot(&self) -> Snapshot {
        let targets = self.tracks.iter().map(|track| track.memory.clone()).collect();
        Snapshot::of(self.solver.model().digest(), targets, self.clock, self.advisor.as_ref().map(Advisor::known))
    }

    /// Restores the state of another tracker of the same model and options.
    ///
    /// # Errors
    /// When it is of another version or model, or does not suit the options; nothing is changed then.
    pub fn restore(&mut self, snapshot: Snapshot) -> Result<(), SnapshotError> {
        let Restored { targets, clock, advice } = snapshot.open(&self.solver, self.tracks.len())?;
        self.tracks = targets.into_iter().map(|memory| Track { memory }).collect();
        self.clock = clock;
        self.advisor = restored_advisor(&self.solver, advice);
        self.wanted = None;
        Ok(())
    }

    /// The evidence in this frame that `estimate`'s parameters are of the target. `None` for models that are no single
    /// target with an outline in two dimensions.
    pub fn signs(&self, frame: &Frame, estimate: &Estimate) -> Option<Signs> {
        let mended = self.solver.mended(frame);
        let context = self.solver.context(mended.as_ref())?;
        let degree = estimate.substitute.map_or(0, |substitute| substitute.degree);
        let around = self.solver.objects(&context).around(&self.solver, &estimate.parameters);
        self.solver.signs(&context, &around, &estimate.parameters, (degree, estimate.ending))
    }

    fn track_with_readiness(
        &mut self,
        frame: &Frame,
        ready: Option<FrameReadiness>,
        watch: &dyn Watch,
    ) -> Vec<Estimate> {
        let mended = self.solver.mended(frame);
        let frame = mended.as_ref();
        let grey; // colour frames for a one-channel model
        let frame = match self.solver.model().channels().len() == 1 && frame.planes().len() == 3 {
            true => {
                grey = frame.luma();
                &grey
            }
            false => frame,
        };
        let time_s = self.clock.time_s(frame, self.solver.options.motion.period_s);
        let missing =
            |ending| self.tracks.iter().map(|_| Finding::Missing(RejectedAttempt::of(Attempt::none(ending)))).collect();
        let budget = FrameBudget::new(self.solver.options.work_max, watch);
        let context = self.solver.context(frame).map(|context| context.with_budget(&budget).with_readiness(ready));
        let rows = self.tracks.iter().find_map(|track| track.memory.rows.variance());
        if let (Some(context), Some(variance)) = (&context, rows) {
            context.learn_rows(variance);
        }
        let outcomes: Vec<Finding> = match &context {
            Some(context) => self.outcomes(context, time_s).unwrap_or_else(|_| missing(Ending::NoKernel)),
            None => missing(Ending::WrongFrame),
        };
        let numbered = outcomes.into_iter().enumerate();
        let mut estimates: Vec<Estimate> =
            numbered.map(|(number, outcome)| self.take(number, outcome, frame, context.as_ref(), time_s)).collect();
        self.advise(context.as_ref(), &mut estimates);
        let requested = context.as_ref().and_then(FrameContext::requested_kernels).cloned();
        self.wanted = requested.or(self.wanted.take());
        self.ready = context.as_ref().map(|context| context.ready.found()).unwrap_or_default();
        estimates
    }

    /// Stores a frame's outcome for a target in memory, and makes its estimate.
    fn take(
        &mut self,
        number: usize,
        outcome: Finding,
        frame: &Frame,
        context: Option<&FrameContext>,
        time_s: f64,
    ) -> Estimate {
        let name = name(self.solver.model(), self.tracks.len(), number);
        // Only a pose from the spots' ellipses needs the limit.
        let is_of_planes = frame.planes().len() == 1 || self.solver.model().observes_channels();
        let only = context.filter(|_| is_of_planes && self.solver.options.target.is_some());
        let limit = |context: &FrameContext| match &outcome {
            Finding::Seen(candidate) => self.solver.limit(context, &candidate.attempt.fit.as_ref()?.parameters),
            _ => None,
        };
        let saturation = only.and_then(limit).unwrap_or(f64::INFINITY);
        let spend = |units| context.map_or(Ok(()), |context| context.spend(units));
        let inputs = EstimateInputs {
            name,
            sequence: frame.sequence,
            capture_ns: frame.capture_ns,
            time_s,
            usable_window: context.map(|context| context.window),
            saturation,
            spend: &spend,
        };
        estimate(&self.solver, &mut self.tracks[number].memory, outcome, inputs)
    }

    fn advise(&mut self, context: Option<&FrameContext>, estimates: &mut [Estimate]) {
        let Some((advisor, context)) = self.advisor.as_mut().zip(context) else { return };
        // Of targets without a prediction, the same for all.
        let mut unplaced = None;
        for (number, estimate) in estimates.iter_mut().enumerate() {
            estimate.exposure_advice = match estimate.state {
                TrackState::Tracking => advisor.advise(&self.solver, context, number, estimate),
                TrackState::Coasting => advisor.dazzled(&self.solver, context, estimate),
                TrackState::Searching | TrackState::Lost => {
                    unplaced.get_or_insert_with(|| advisor.dazzled(&self.solver, context, estimate)).clone()
                }
            };
        }
    }

    /// Follows all targets, then searches for those that are not where they are predicted.
    fn outcomes(&self, context: &FrameContext, time_s: f64) -> Result<Vec<Finding>, CompileFailure> {
        let solver = &self.solver;
        // Lost targets are searched for in any case: the search is requested first, or a fit at the last position could
        // use up the frame's own budget, again and again.
        let is_lost = self.tracks.iter().any(|track| track.memory.found && track.memory.seen_s().is_none());
        let mut postponed = if is_lost { context.search().err().map(Ending::from) } else { None };
        let followed = self.tracks.iter().map(|track| track.follow(solver, context, time_s));
        let mut followed = followed.collect::<Result<Vec<_>, _>>()?;
        separate(solver, &mut followed);
        let mut kept: Vec<Vec<f64>> = followed.iter().filter_map(kept).collect();
        let mut search = None;
        let mut outcomes: Vec<Option<Finding>> = Vec::new();
        outcomes.resize_with(followed.len(), || None);
        // Targets that were seen lately choose first, then lost ones, then those that were never found.
        let mut order: Vec<usize> = (0..followed.len()).collect();
        order.sort_by_key(|&number| {
            let memory = &self.tracks[number].memory;
            (memory.seen_s().is_none(), !memory.found)
        });
        let mut followed: Vec<Option<TrackingFit>> = followed.into_iter().map(Some).collect();
        for number in order {
            let outcome = match followed[number].take() {
                Some(TrackingFit::Accepted(candidate)) => Finding::Seen(candidate),
                Some(TrackingFit::Uncertain(uncertain)) => {
                    let track = &self.tracks[number];
                    if search.is_none() && postponed.is_none() && context.unfinished().is_none() {
                        postponed = context.search().err().map(Ending::from);
                        if postponed.is_none() {
                            let size_px = track.memory.size_px(solver);
                            let given = self.given(track, time_s);
                            search = Some(Search::run(solver, context, &given, kept.clone(), size_px)?);
                        }
                    }
                    match (context.unfinished(), &mut search) {
                        (None, Some(search)) => track.decide(solver, context, uncertain, search, time_s),
                        // The target may be in the part that a search has not reached.
                        (ending, _) => {
                            let is_begun = ending.is_some();
                            let near = if is_begun { None } else { track.nearby(solver, context, &kept, time_s)? };
                            match near {
                                Some(candidate) => {
                                    kept.extend(candidate.attempt.fit.iter().map(|fit| fit.parameters.clone()));
                                    Finding::Seen(candidate)
                                }
                                None => {
                                    let ending = context.unfinished().or(postponed).unwrap_or_default();
                                    track.missing(solver, context, RejectedAttempt::of(left(uncertain, ending)), time_s)
                                }
                            }
                        }
                    }
                }
                None => continue,
            };
            let margin = Margin::even(MARGIN_SHARE, MARGIN_PX);
            outcomes[number] = Some(match outcome {
                Finding::Seen(candidate) => {
                    let before = self.tracks[number].memory.sampling_choice.as_ref();
                    let candidate = match solver.resampled(context, &candidate.attempt, margin, before) {
                        Some(attempt) => Candidate { attempt, ..*candidate },
                        None => *candidate,
                    };
                    match candidate.attempt.ending {
                        // Its distance from a minimum is unknown.
                        Ending::NoDescent => {
                            let attempt = Attempt { rejection: Some(Rejection::Ending), ..candidate.attempt };
                            self.tracks[number].missing(solver, context, RejectedAttempt::of(attempt), time_s)
                        }
                        _ => Finding::Seen(Box::new(candidate)),
                    }
                }
                outcome => outcome,
            });
        }
        Ok(outcomes.into_iter().flatten().collect())
    }

    /// Numbers that override the starts of a search: those that a swap carried over, at the predicted position, else
    /// those of the session, but of several targets without centres.
    fn given(&self, track: &Track, time_s: f64) -> Vec<Option<f64>> {
        let model = self.solver.model();
        if let Some(warm) = track.memory.warm.as_ref().filter(|warm| warm.iter().any(Option::is_none)) {
            return track.memory.with_predicted_position(&self.solver, warm.clone(), time_s);
        }
        let mut given = self.solver.options.start_of(model);
        if self.tracks.len() > 1 {
            for parameter in model.roles().iter().flat_map(|roles| &roles.centre) {
                given[parameter.index()] = None;
            }
        }
        given
    }
}

/// The attempt of a doubtful fit, when the frame ended before it was settled.
fn left(uncertain: Option<Box<Candidate>>, ending: Ending) -> Attempt {
    match uncertain.map(|candidate| candidate.attempt).filter(|attempt| attempt.ending == ending) {
        Some(attempt) => Attempt { rejection: attempt.rejection.or(Some(Rejection::Ending)), ..attempt },
        None => Attempt::none(ending),
    }
}

fn advisor(solver: &Solver) -> Option<Advisor> {
    let options = &solver.options;
    options.exposure.map(|goal| Advisor::new(goal, options.targets, solver))
}

fn restored_advisor(solver: &Solver, known: Option<Vec<Option<Best>>>) -> Option<Advisor> {
    let mut advisor = advisor(solver);
    if let Some((advisor, known)) = advisor.as_mut().zip(known) {
        advisor.know(known);
    }
    advisor
}

fn kept(followed: &TrackingFit) -> Option<Vec<f64>> {
    match followed {
        TrackingFit::Accepted(candidate) => candidate.attempt.fit.as_ref().map(|fit| fit.parameters.clone()),
        TrackingFit::Uncertain(_) => None,
    }
}

/// Of two tracks that ended on one object the likelier keeps it.
fn separate(solver: &Solver, followed: &mut [TrackingFit]) {
    for first in 0..followed.len() {
        for second in first + 1..followed.len() {
            let (Some(one), Some(other)) = (kept(&followed[first]), kept(&followed[second])) else { continue };
            let (TrackingFit::Accepted(a), TrackingFit::Accepted(b)) = (&followed[first], &followed[second]) else {
                continue;
            };
            if a.coincides(solver, &other) || b.coincides(solver, &one) {
                let loser = if b.odds() > a.odds() { first } else { second };
                followed[loser] = TrackingFit::Uncertain(None);
            }
        }
    }
}

/// The target's id.
fn name(model: &Model, targets: usize, number: usize) -> String {
    match model.roles() {
        [roles] if targets == 1 => roles.name.clone().unwrap_or_else(|| "0".to_string()),
        _ => number.to_string(),
    }
}

#[cfg(test)]
#[path = "tracker_tests.rs"]
mod tests;

#[cfg(test)]
#[path = "circular_start_tests.rs"]
mod circular_start_tests;

#[cfg(test)]
#[path = "bounded_tests.rs"]
mod bounded_tests;
#[cfg(test)]
#[path = "defects_tests.rs"]
mod defects_tests;

#[cfg(test)]
#[path = "many_tests.rs"]
mod many_tests;
#[cfg(test)]
#[path = "short_tests.rs"]
mod short_tests;
#[cfg(test)]
#[path = "start_list_tests.rs"]
mod start_list_tests;
