//! `Tracker`: follows targets from frame to frame.
//!
//! What comes in: frames, in order. What goes out: one [`Estimate`] for each frame and target, always. It never knows where
//! frames come from nor what time it is.
//!
//! A target that is followed is fitted around where it should be by now. One that is not found there, and one that was never
//! found, is searched for in the whole frame, where the targets that are followed are left out. See [`crate::track`].

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
use crate::track::publish::{Told, estimate};
use crate::track::search::Search;
use crate::track::shared::{Carried, SharedParameters};
use crate::track::snapshot::{Restored, Snapshot, SnapshotError};
use crate::track::solver::{Attempt, Look, Solver};
use crate::track::window::Margin;
use crate::track::{Finding, Followed, MARGIN_PX, MARGIN_SHARE, NotTaken, Track};
use crate::verdict::Signs;
use isophote_frame::Frame;

/// Follows one target or several of the same model.
pub struct Tracker {
    pub(crate) solver: Solver,
    pub(super) tracks: Vec<Track>,
    advisor: Option<Advisor>,
    clock: FrameClock,
    /// What frames were fitted without.
    wanted: Option<Preparation>,
    /// What the last frame was fitted with.
    ready: FrameReadiness,
}

impl Tracker {
    /// A tracker that searches.
    ///
    /// # Errors
    /// When a start or constant is given that the model does not have, or one that cannot be.
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

    /// Takes another model from the next frame on. What both models have goes on: parameters of the same role, else of the
    /// same name, if they lie inside the new bounds; where targets are, how they move, and whether they are coasting, for
    /// models that have centres, or a pose, both. The rest starts anew. Starts and constants that the new model does not
    /// have are left alone: they belonged to the old one. The values are those of the first target.
    pub fn swap(&mut self, compiled: Arc<Compiled>, options: TrackerOptions) -> Carried {
        self.tracks.resize_with(options.targets, Track::default);
        let old = self.solver.compiled.clone();
        let shared = SharedParameters::of(&old, &compiled, &options);
        let first = self.tracks.first().and_then(|track| track.memory.warm.as_deref());
        let mut carried = shared.told(first);
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

    /// Another one that remembers what this one does: what it would say of a frame can be tried.
    pub fn fork(&self) -> Tracker {
        let solver = Solver::new(self.solver.compiled.clone(), self.solver.options.clone());
        let (tracks, clock) = (self.tracks.clone(), self.clock);
        let advisor = advisor_who_knows(&solver, self.advisor.as_ref().map(Advisor::known));
        Tracker { advisor, solver, tracks, clock, wanted: None, ready: self.ready }
    }

    /// Shows frames with what this tracker says of them, until it takes another model. It costs nothing before somebody looks.
    pub fn viewer(&self) -> Viewer {
        Viewer::new(self.solver.compiled.clone(), self.solver.options.clone())
    }

    /// Whether one of the targets is known well enough to begin the next fit there.
    pub fn is_following(&self) -> bool {
        self.tracks.iter().any(|track| track.memory.last_start().is_some())
    }

    /// What comes next does not go on from what was seen: targets keep their names, and are searched for.
    pub fn lose(&mut self) {
        self.tracks.iter_mut().for_each(|track| track.memory.lose());
    }

    /// What it was told beside the model.
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
        let Some(look) = self.solver.look(&frame) else { return Vec::new() };
        let given = self.solver.options.start_of(self.solver.model());
        let search = Search::run(&self.solver, &look, &given, Vec::new(), None);
        search.map(|search| search.sightings()).unwrap_or_default()
    }

    /// Fits one frame: what it says about the first target.
    pub fn track(&mut self, frame: &Frame) -> Estimate {
        let mut all = self.track_all(frame);
        all.swap_remove(0)
    }

    /// Fits one frame: what it says about each target, in the order of their numbers; never empty.
    pub fn track_all(&mut self, frame: &Frame) -> Vec<Estimate> {
        self.track_all_while(frame, &|| None::<Stop>)
    }

    /// What frames since the last call were fitted without, because it is prepared beside them: to be run on another thread.
    pub fn wanted(&mut self) -> Option<Preparation> {
        self.wanted.take()
    }

    /// The same, ended by `watch`, which is asked before every pass and every step of a search. A target whose fit was done by
    /// then is tracked, and so is one whose fit had reached a point that may be it when the budget was used up; of the others
    /// the frame says nothing, the ending says why, and they are remembered as they were. Where `watch` puts the search of all
    /// that may be looked at off, what was followed is looked for near where it should be.
    pub fn track_all_while(&mut self, frame: &Frame, watch: &dyn Watch) -> Vec<Estimate> {
        self.track_told(frame, None, watch)
    }

    /// The same of a frame that was fitted before, with what its fits had then ([`Tracker::readiness`]): from the same state, with
    /// a watch that ends it where it was ended, estimates are the same bit for bit.
    pub fn track_all_again(&mut self, frame: &Frame, ready: FrameReadiness, watch: &dyn Watch) -> Vec<Estimate> {
        self.track_told(frame, Some(ready), watch)
    }

    /// What the fits of the last frame had beside the model's own kernels.
    pub fn readiness(&self) -> FrameReadiness {
        self.ready
    }

    /// All that it remembers: what the next frames will be taken for depends on nothing else but the model and the options.
    pub fn snapshot(&self) -> Snapshot {
        let targets = self.tracks.iter().map(|track| track.memory.clone()).collect();
        Snapshot::of(self.solver.model().digest(), targets, self.clock, self.advisor.as_ref().map(Advisor::known))
    }

    /// Remembers what another tracker of the same model and options did.
    ///
    /// # Errors
    /// When it is of another version or model, or does not suit the options; nothing is changed then.
    pub fn restore(&mut self, snapshot: Snapshot) -> Result<(), SnapshotError> {
        let Restored { targets, clock, advice } = snapshot.open(&self.solver, self.tracks.len())?;
        self.tracks = targets.into_iter().map(|memory| Track { memory }).collect();
        self.clock = clock;
        self.advisor = advisor_who_knows(&self.solver, advice);
        self.wanted = None;
        Ok(())
    }

    /// What a fit of this frame shows of whether it is of the target: of `estimate`'s parameters. `None` for models that are no single
    /// target with an outline in two dimensions.
    pub fn signs(&self, frame: &Frame, estimate: &Estimate) -> Option<Signs> {
        let mended = self.solver.mended(frame);
        let look = self.solver.look(mended.as_ref())?;
        let degree = estimate.substitute.map_or(0, |substitute| substitute.degree);
        let others = self.solver.things(&look).beside(&self.solver, &estimate.parameters);
        self.solver.signs(&look, others, &estimate.parameters, (degree, estimate.ending))
    }

    fn track_told(&mut self, frame: &Frame, ready: Option<FrameReadiness>, watch: &dyn Watch) -> Vec<Estimate> {
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
            |ending| self.tracks.iter().map(|_| Finding::Missing(NotTaken::of(Attempt::none(ending)))).collect();
        let budget = FrameBudget::new(self.solver.options.work_max, watch);
        let look = self.solver.look(frame).map(|look| look.within(&budget).again(ready));
        let rows = self.tracks.iter().find_map(|track| track.memory.rows.variance());
        if let (Some(look), Some(variance)) = (&look, rows) {
            look.learn_rows(variance);
        }
        let outcomes: Vec<Finding> = match &look {
            Some(look) => self.outcomes(look, time_s).unwrap_or_else(|_| missing(Ending::NoKernel)),
            None => missing(Ending::WrongFrame),
        };
        let numbered = outcomes.into_iter().enumerate();
        let mut estimates: Vec<Estimate> =
            numbered.map(|(number, outcome)| self.take(number, outcome, frame, look.as_ref(), time_s)).collect();
        self.advise(look.as_ref(), &mut estimates);
        let wanted = look.as_ref().and_then(Look::wanted).cloned();
        self.wanted = wanted.or(self.wanted.take());
        self.ready = look.as_ref().map(|look| look.ready.found()).unwrap_or_default();
        estimates
    }

    /// Remembers what a frame said about a target, and says it.
    fn take(&mut self, number: usize, outcome: Finding, frame: &Frame, look: Option<&Look>, time_s: f64) -> Estimate {
        let name = name(self.solver.model(), self.tracks.len(), number);
        // Only a pose made of spots asks for it.
        let is_of_planes = frame.planes().len() == 1 || self.solver.model().observes_channels();
        let only = look.filter(|_| is_of_planes && self.solver.options.target.is_some());
        let limit = |look: &Look| match &outcome {
            Finding::Seen(candidate) => self.solver.limit(look, &candidate.attempt.fit.as_ref()?.parameters),
            _ => None,
        };
        let saturation = only.and_then(limit).unwrap_or(f64::INFINITY);
        let spend = |units| look.map_or(Ok(()), |look| look.spend(units));
        let told = Told {
            name,
            sequence: frame.sequence,
            capture_ns: frame.capture_ns,
            time_s,
            whole: look.map(|look| look.window),
            saturation,
            spend: &spend,
        };
        estimate(&self.solver, &mut self.tracks[number].memory, outcome, told)
    }

    fn advise(&mut self, look: Option<&Look>, estimates: &mut [Estimate]) {
        let Some((advisor, look)) = self.advisor.as_mut().zip(look) else { return };
        for (number, estimate) in estimates.iter_mut().enumerate() {
            estimate.exposure_advice = match estimate.state {
                TrackState::Tracking => advisor.advise(&self.solver, look, number, estimate),
                _ => advisor.dazzled(&self.solver, look, estimate),
            };
        }
    }

    /// Follows all, then searches for those that are not where they should be.
    fn outcomes(&self, look: &Look, time_s: f64) -> Result<Vec<Finding>, CompileFailure> {
        let solver = &self.solver;
        // What was lost is searched for in any case: its frame has a search's time from the beginning, or a fit where it was last
        // could use up the frame's own, again and again.
        let is_lost = self.tracks.iter().any(|track| track.memory.found && track.memory.seen_s().is_none());
        let mut postponed = if is_lost { look.search().err().map(Ending::from) } else { None };
        let followed = self.tracks.iter().map(|track| track.follow(solver, look, time_s));
        let mut followed = followed.collect::<Result<Vec<_>, _>>()?;
        separate(solver, &mut followed);
        let mut kept: Vec<Vec<f64>> = followed.iter().filter_map(kept).collect();
        let mut search = None;
        let mut outcomes: Vec<Option<Finding>> = Vec::new();
        outcomes.resize_with(followed.len(), || None);
        // Those that were seen lately choose before those that were lost, and these before those that were never found.
        let mut order: Vec<usize> = (0..followed.len()).collect();
        order.sort_by_key(|&number| {
            let memory = &self.tracks[number].memory;
            (memory.seen_s().is_none(), !memory.found)
        });
        let mut followed: Vec<Option<Followed>> = followed.into_iter().map(Some).collect();
        for number in order {
            let outcome = match followed[number].take() {
                Some(Followed::Kept(candidate)) => Finding::Seen(candidate),
                Some(Followed::Doubtful(doubtful)) => {
                    let track = &self.tracks[number];
                    if search.is_none() && postponed.is_none() && look.unfinished().is_none() {
                        postponed = look.search().err().map(Ending::from);
                        if postponed.is_none() {
                            let size_px = track.memory.size_px(solver);
                            let given = self.given(track, time_s);
                            search = Some(Search::run(solver, look, &given, kept.clone(), size_px)?);
                        }
                    }
                    match (look.unfinished(), &mut search) {
                        (None, Some(search)) => track.settle(solver, look, doubtful, search, time_s),
                        // What a search has not come to may be the target.
                        (ending, _) => {
                            let is_begun = ending.is_some();
                            let near = if is_begun { None } else { track.nearby(solver, look, &kept, time_s)? };
                            match near {
                                Some(candidate) => {
                                    kept.extend(candidate.attempt.fit.iter().map(|fit| fit.parameters.clone()));
                                    Finding::Seen(candidate)
                                }
                                None => {
                                    let ending = look.unfinished().or(postponed).unwrap_or_default();
                                    track.missing(solver, look, NotTaken::of(left(doubtful, ending)), time_s)
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
                    let before = self.tracks[number].memory.chosen.as_ref();
                    let candidate = match solver.resampled(look, &candidate.attempt, margin, before) {
                        Some(attempt) => Candidate { attempt, ..*candidate },
                        None => *candidate,
                    };
                    match candidate.attempt.ending {
                        // Nobody knows how far it is from a minimum.
                        Ending::NoDescent => {
                            let attempt = Attempt { rejection: Some(Rejection::Ending), ..candidate.attempt };
                            self.tracks[number].missing(solver, look, NotTaken::of(attempt), time_s)
                        }
                        _ => Finding::Seen(Box::new(candidate)),
                    }
                }
                outcome => outcome,
            });
        }
        Ok(outcomes.into_iter().flatten().collect())
    }

    /// Numbers that take the place of what a search sees: those that a swap has carried, the target being where it should be
    /// by now, else those of the session. Of several targets none is said to be anywhere.
    fn given(&self, track: &Track, time_s: f64) -> Vec<Option<f64>> {
        let model = self.solver.model();
        if let Some(warm) = track.memory.warm.as_ref().filter(|warm| warm.iter().any(Option::is_none)) {
            return track.memory.foreseen(&self.solver, warm.clone(), time_s);
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

/// What is said of a fit that is not believed when the frame has ended.
fn left(doubtful: Option<Box<Candidate>>, ending: Ending) -> Attempt {
    match doubtful.map(|candidate| candidate.attempt).filter(|attempt| attempt.ending == ending) {
        Some(attempt) => Attempt { rejection: attempt.rejection.or(Some(Rejection::Ending)), ..attempt },
        None => Attempt::none(ending),
    }
}

fn advisor(solver: &Solver) -> Option<Advisor> {
    let options = &solver.options;
    options.exposure.map(|goal| Advisor::new(goal, options.targets, solver))
}

fn advisor_who_knows(solver: &Solver, known: Option<Vec<Option<Best>>>) -> Option<Advisor> {
    let mut advisor = advisor(solver);
    if let Some((advisor, known)) = advisor.as_mut().zip(known) {
        advisor.know(known);
    }
    advisor
}

fn kept(followed: &Followed) -> Option<Vec<f64>> {
    match followed {
        Followed::Kept(candidate) => candidate.attempt.fit.as_ref().map(|fit| fit.parameters.clone()),
        Followed::Doubtful(_) => None,
    }
}

/// Of two tracks that ended on one thing the likelier keeps it.
fn separate(solver: &Solver, followed: &mut [Followed]) {
    for first in 0..followed.len() {
        for second in first + 1..followed.len() {
            let (Some(one), Some(other)) = (kept(&followed[first]), kept(&followed[second])) else { continue };
            let (Followed::Kept(a), Followed::Kept(b)) = (&followed[first], &followed[second]) else { continue };
            if a.coincides(solver, &other) || b.coincides(solver, &one) {
                let loser = if b.odds() > a.odds() { first } else { second };
                followed[loser] = Followed::Doubtful(None);
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
#[path = "short_tests.rs"]
mod short_tests;
#[cfg(test)]
#[path = "start_list_tests.rs"]
mod start_list_tests;
