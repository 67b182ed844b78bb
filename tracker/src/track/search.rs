//! A search: fits everything in a frame that may be a target and is not followed already, the likeliest first.

use std::f64::consts::SQRT_2;

use super::allowance;
use super::candidate::{Candidate, Sighting, is_about};
use super::pixel_statistics::PixelStatistics;
use super::reconsider::{ResidualKind, StartOrigin};
use super::solver::{Attempt, FrameContext, Solver};
use super::verdicts::SceneObjects;
use super::window::Margin;
use crate::estimate::{Ending, Rejection};
use crate::sight::cold::{CandidateStarts, ColdStarts, FALSE_ALARMS, Resolution, TemplateStarts};
use crate::sight::detect::{DetectOptions, DetectionThreshold};
use crate::sight::mask::Mask;
use crate::solve::fit::StartKind;
use crate::solve::stage_kernels::{CompileFailure, PixelHandling};

/// A budget: margin of the window around a detected object, as a share of the domain.
const MARGIN_SHARE: f64 = 0.5;
/// A budget: margin added to that share, px.
const MARGIN_PX: f64 = 6.0;
/// Pictures of at least this many pixels are searched at half resolution.
const HALVED_PIXELS: usize = 100_000;
/// Least half width of a target for a search at half resolution, px.
const HALVED_PX: f64 = 6.0;

/// A definition: tolerance of an expected size, as a factor either way.
const SIZES_OFF: f64 = 2.1;

/// True for a fit that leaves more unexplained than noise does.
fn leaves_structure(solver: &Solver, attempt: &Attempt, statistics: PixelStatistics) -> bool {
    let residuals = statistics.residuals.filter(|_| solver.model().has_noise());
    !solver.is_fine(attempt, None) || residuals.is_some_and(|residuals| residuals.structure.is_significant())
}

/// The result of a search.
pub(crate) struct Search {
    candidates: Vec<Candidate>,
    claimed: Vec<bool>,
    /// The target's position was given, and it was found there.
    is_at_given_position: bool,
    /// Reported when there is no candidate: the first rejected fit.
    pub failure: Attempt,
    /// Parameters of the targets that are followed already.
    pub avoided: Vec<Vec<f64>>,
    /// The most massive object that no fit explains well.
    uncertain: Option<UncertainFit>,
    /// Objects that were fitted, and the work of their passes, without the first objects.
    fitted: usize,
    work: u64,
    /// Objects were skipped because the allowance was used up.
    is_cut: bool,
    objects: SceneObjects,
    /// The target was never seen: size and brightness are compared with the stated ones.
    is_first: bool,
}

/// A fit that leaves too much unexplained.
struct UncertainFit {
    attempt: Attempt,
    start: Vec<f64>,
    statistics: PixelStatistics,
    /// Only the correlation of its residuals is unexplained; fits with more misfit come first.
    is_fine: bool,
}

/// The best candidate, and its number.
pub(crate) struct Pick {
    pub index: usize,
    pub candidate: Candidate,
}

impl Search {
    /// Searches the whole window. `given` numbers override the estimated starts; `avoided`: parameters of targets that
    /// are followed already; `size_px`: half the target's width, when it is known. A large picture is searched at half
    /// resolution, and at full resolution only for small targets.
    pub fn run(
        solver: &Solver,
        context: &FrameContext,
        given: &[Option<f64>],
        avoided: Vec<Vec<f64>>,
        size_px: Option<f64>,
    ) -> Result<Search, CompileFailure> {
        let mut search = Search {
            candidates: Vec::new(),
            claimed: Vec::new(),
            is_at_given_position: false,
            failure: Attempt::none(Ending::NoTarget),
            avoided,
            uncertain: None,
            fitted: 0,
            work: 0,
            is_cut: false,
            objects: SceneObjects::default(),
            is_first: size_px.is_none(),
        };
        search.find(solver, context, given, size_px)?;
        if context.unfinished().is_some() {
            return Ok(search);
        }
        search.reconsider(solver, context)?;
        // A stable sort: of equal odds the most massive stays first.
        search.candidates.sort_by(|a, b| b.odds().total_cmp(&a.odds()));
        search.merge(solver);
        if solver.options.targets == 1 {
            search.weigh_rivals(solver);
        }
        search.claimed = vec![false; search.candidates.len()];
        if search.is_cut {
            let strongest = search.failure.strongest;
            search.failure = Attempt { strongest, ..Attempt::none(Ending::SearchLimit) };
        }
        Ok(search)
    }

    /// Fits the objects that stand out, and those that the document's own image detects.
    fn find(
        &mut self,
        solver: &Solver,
        context: &FrameContext,
        given: &[Option<f64>],
        size_px: Option<f64>,
    ) -> Result<(), CompileFailure> {
        if solver.bank.is_some() && (solver.options.snr_min.is_some() || solver.options.sizes_px.is_some()) {
            self.fit_detections(solver, context, given, size_px)?;
            // A filter does not find large things that fill much of a picture.
            return self.search_at(solver, context, given, Resolution::Full);
        }
        let [width, height, ..] = context.window.size();
        let coarse = width.min(height) > 1 && context.window.pixels() >= HALVED_PIXELS && solver.reaches();
        if coarse && size_px.is_none_or(|size| size >= HALVED_PX) {
            self.search_at(solver, context, given, Resolution::Halved)?;
        }
        if context.unfinished().is_some() {
            return Ok(());
        }
        let is_small = size_px.is_some_and(|size| size < HALVED_PX);
        let detects = solver.bank.is_some();
        if !coarse || (!detects && (is_small || (self.candidates.is_empty() && size_px.is_none()))) {
            self.search_at(solver, context, given, Resolution::Full)?;
        }
        if self.needs_more_candidates(solver) && context.unfinished().is_none() {
            self.fit_detections(solver, context, given, size_px)?;
        }
        // Small saturated targets stand out by themselves, and are lost at half resolution.
        if coarse && detects && is_small && self.candidates.is_empty() && context.unfinished().is_none() {
            self.search_at(solver, context, given, Resolution::Full)?;
        }
        Ok(())
    }

    /// Reconsiders the fit of the most massive object that no fit explains, where no other candidate is likely and well
    /// explained.
    fn reconsider(&mut self, solver: &Solver, context: &FrameContext) -> Result<(), CompileFailure> {
        // A faint object that a model explains does not rule out the massive one that it does not explain.
        let is_fine = |candidate: &Candidate| solver.is_fine(&candidate.attempt, None) && candidate.is_likely();
        let Some(UncertainFit { attempt, start, statistics, .. }) = self.uncertain.take() else { return Ok(()) };
        if self.candidates.iter().any(is_fine) {
            return Ok(());
        }
        let margin = Margin::even(MARGIN_SHARE, MARGIN_PX);
        let finer = solver.resampled(context, &attempt, margin, None);
        let is_resampled = finer.is_some();
        let (attempt, statistics) = match finer {
            Some(finer) => {
                let statistics = PixelStatistics::default().updated(solver, context, &finer);
                (finer, statistics)
            }
            None => (attempt, statistics),
        };
        let candidate = self.candidate(solver, context, attempt.clone(), statistics);
        let left = ResidualKind::Structure { is_sure: candidate.is_sure(solver) };
        if is_resampled {
            self.candidates.push(candidate);
            if !leaves_structure(solver, &attempt, statistics) {
                return Ok(());
            }
        }
        let had_rows = context.row_variance().is_some();
        let (attempt, stop) =
            solver.reconsidered(context, (attempt, left), &start, margin, None, StartOrigin::Search)?;
        self.is_cut |= stop.is_some();
        let has_rows = !had_rows && context.row_variance().is_some();
        if has_rows || attempt.choice().is_some() {
            let statistics = statistics.updated(solver, context, &attempt);
            let candidate = self.candidate(solver, context, attempt, statistics);
            // A curved background can make up for much of any profile.
            self.candidates.extend((candidate.is_likely() || !candidate.is_bent()).then_some(candidate));
        }
        Ok(())
    }

    fn search_at(
        &mut self,
        solver: &Solver,
        context: &FrameContext,
        given: &[Option<f64>],
        resolution: Resolution,
    ) -> Result<(), CompileFailure> {
        let masks = self.avoided.iter().filter_map(|parameters| solver.mask(context, parameters)).collect();
        let candidates_max = if solver.reaches() { solver.objects_max()[0] } else { 1 };
        let view = solver.view(context, context.window);
        let Some(found) =
            ColdStarts::search(solver.model(), &view, &solver.constants, given, candidates_max, masks, resolution)
        else {
            return Ok(());
        };
        self.objects.add(solver, context, &view, &found.candidates);
        // There may be more.
        self.is_cut |= candidates_max > 1 && found.candidates.len() >= candidates_max;
        let handling = if found.saturated > 0 { PixelHandling::SkipSaturated } else { PixelHandling::All };
        for starts in &found.candidates {
            if !solver.is_of_wanted_size(&starts.starts[0]) || self.is_taken(solver, &starts.starts[0]) {
                continue;
            }
            if self.is_spent(solver, context) {
                self.is_cut = true;
                break;
            }
            let attempt = self.try_all(solver, context, starts, handling)?;
            let (is_good, is_fine) = (attempt.is_good(), solver.is_fine(&attempt, None));
            let statistics = PixelStatistics::default().updated(solver, context, &attempt);
            if leaves_structure(solver, &attempt, statistics)
                && self.uncertain.as_ref().is_none_or(|before| before.is_fine && !is_fine)
            {
                let (attempt, start) = (attempt.clone(), starts.starts[0].clone());
                self.uncertain = Some(UncertainFit { attempt, start, statistics, is_fine });
            }
            if is_good {
                let candidate = self.candidate(solver, context, attempt, statistics);
                let is_avoided = self.avoided.iter().any(|other| candidate.coincides(solver, other));
                self.candidates.extend((!is_avoided).then_some(candidate));
                if found.is_at_given_position {
                    self.is_at_given_position = true;
                    break; // found at the given position
                }
            } else if self.failure.fit.is_none() {
                self.failure = attempt;
            }
        }
        Ok(())
    }

    fn candidate(
        &self,
        solver: &Solver,
        context: &FrameContext,
        attempt: Attempt,
        statistics: PixelStatistics,
    ) -> Candidate {
        let parameters = attempt.fit.as_ref().map(|fit| &fit.parameters);
        let around = parameters.map(|parameters| self.objects.around(solver, parameters)).unwrap_or_default();
        let off = attempt.fit.as_ref().filter(|_| self.is_first).map_or(0.0, |fit| solver.off_stated(&fit.parameters));
        let verdict = solver.verdict(context, &attempt, &around).map(|verdict| verdict.off_stated(off));
        Candidate::of(attempt, statistics, verdict)
    }

    /// True when no likely candidate was found, or several targets are wanted, unless one was found at a given position.
    fn needs_more_candidates(&self, solver: &Solver) -> bool {
        !self.is_at_given_position && (solver.options.targets > 1 || !self.candidates.iter().any(Candidate::is_likely))
    }

    /// Fits the detections of the document's own image, however faint.
    fn fit_detections(
        &mut self,
        solver: &Solver,
        context: &FrameContext,
        given: &[Option<f64>],
        size_px: Option<f64>,
    ) -> Result<(), CompileFailure> {
        let Some(bank) = &solver.bank else { return Ok(()) };
        let masks: Vec<Mask> = self.avoided.iter().filter_map(|parameters| solver.mask(context, parameters)).collect();
        let view = solver.view(context, context.window);
        let (model, constants) = (solver.model(), &solver.constants);
        let around = |size: f64| [size / SIZES_OFF, size * SIZES_OFF];
        // Templates one step of the bank outside of the wanted range respond to targets inside.
        let wanted = solver.options.sizes_px.map(|[least, most]| [least / SQRT_2, most * SQRT_2]);
        let sizes_px = wanted.or(size_px.map(around)).unwrap_or([0.0, f64::INFINITY]);
        let usual = DetectionThreshold::FalseAlarms(FALSE_ALARMS);
        let threshold = solver.options.snr_min.map_or(usual, DetectionThreshold::Snr);
        let count_max = solver.objects_max()[1];
        let criteria = DetectOptions { sign: None, sizes_px, masks: &masks, count_max, threshold };
        let Some(detected) = TemplateStarts::detect(model, &view, constants, given, bank, criteria) else {
            return Ok(());
        };
        self.failure.strongest = detected.strongest;
        self.objects.add(solver, context, &view, &detected.candidates);
        (self.fitted, self.work) = (0, 0);
        let handling = if detected.saturated > 0 { PixelHandling::SkipSaturated } else { PixelHandling::All };
        for (number, starts) in detected.candidates.iter().chain(&detected.larger).enumerate() {
            if number >= detected.candidates.len() && !self.needs_more_candidates(solver) {
                break;
            }
            if self.is_taken(solver, &starts.starts[0]) {
                continue;
            }
            if self.is_spent(solver, context) {
                self.is_cut = true;
                break;
            }
            let attempt = self.try_all(solver, context, starts, handling)?;
            let candidate = self.candidate_of_detection(solver, context, attempt, starts);
            if candidate.attempt.is_good() {
                let is_avoided = self.avoided.iter().any(|other| candidate.coincides(solver, other));
                self.candidates.extend((!is_avoided).then_some(candidate));
            } else if self.failure.fit.is_none() {
                self.failure = Attempt { strongest: detected.strongest, ..candidate.attempt };
            }
        }
        Ok(())
    }

    /// True where an acceptable candidate is.
    fn is_taken(&self, solver: &Solver, start: &[f64]) -> bool {
        let is_acceptable = |candidate: &&Candidate| candidate.is_likely() || candidate.is_sure(solver);
        let mut acceptable = self.candidates.iter().filter(is_acceptable);
        acceptable
            .any(|candidate| candidate.attempt.fit.as_ref().is_some_and(|fit| is_about(solver, &fit.parameters, start)))
    }

    /// With a single target, every other object as bright counts against each candidate.
    fn weigh_rivals(&mut self, solver: &Solver) {
        let parameters = |candidate: &Candidate| candidate.attempt.fit.as_ref().map(|fit| fit.parameters.clone());
        let found: Vec<Option<Vec<f64>>> = self.candidates.iter().map(parameters).collect();
        let odds: Vec<f64> = self.candidates.iter().map(Candidate::odds).collect();
        for (number, candidate) in self.candidates.iter_mut().enumerate() {
            let is_rival = |other: &usize| {
                let both = found[*other].as_ref().zip(found[number].as_ref());
                *other != number && both.is_some_and(|(rival, this)| self.objects.is_rival(solver, rival, this))
            };
            let rivals: Vec<usize> = (0..found.len()).filter(is_rival).collect();
            let all = rivals.iter().map(|other| odds[*other]).sum();
            let likeliest = rivals.into_iter().max_by(|a, b| odds[*a].total_cmp(&odds[*b]));
            let rival = likeliest.and_then(|other| solver.centre(found[other].as_ref()?));
            candidate.verdict = candidate.verdict.map(|verdict| verdict.among(all, rival));
        }
    }

    /// The candidate of a detection by the document's image. A fit that stays there is not rejected as faint, since the
    /// detection is significant already.
    fn candidate_of_detection(
        &self,
        solver: &Solver,
        context: &FrameContext,
        mut attempt: Attempt,
        starts: &CandidateStarts,
    ) -> Candidate {
        let stays = Candidate::of(attempt.clone(), PixelStatistics::default(), None).stays(solver, &starts.starts[0]);
        if attempt.rejection == Some(Rejection::Faint) && stays {
            attempt.rejection = None;
        }
        let statistics = PixelStatistics::default().updated(solver, context, &attempt);
        let candidate = self.candidate(solver, context, attempt, statistics);
        let verdict = candidate.verdict.map(|verdict| if stays { verdict.detected() } else { verdict });
        Candidate { verdict, ..candidate }
    }

    /// Keeps one of several fits of an object: the likeliest, or the one without its outliers.
    fn merge(&mut self, solver: &Solver) {
        let mut kept: Vec<Candidate> = Vec::new();
        for candidate in self.candidates.drain(..) {
            let is_same = |other: &&mut Candidate| {
                let both = candidate.attempt.fit.as_ref().zip(other.attempt.fit.as_ref());
                both.is_some_and(|(one, other)| is_about(solver, &one.parameters, &other.parameters))
            };
            match kept.iter_mut().find(is_same) {
                Some(other) if candidate.leaves_outliers_out() && other.is_plain() => *other = candidate,
                Some(_) => {}
                None => kept.push(candidate),
            }
        }
        self.candidates = kept;
    }

    /// The likeliest unclaimed candidate, accepted or not.
    pub fn best_unclaimed(&self) -> Option<Candidate> {
        self.best(|candidate| Some(candidate.clone())).map(|pick| pick.candidate)
    }

    /// The likeliest unclaimed candidate that `admit` accepts.
    pub fn best(&self, admit: impl Fn(&Candidate) -> Option<Candidate>) -> Option<Pick> {
        let free = self.candidates.iter().enumerate().filter(|(index, _)| !self.claimed[*index]);
        let admitted = free.filter_map(|(index, candidate)| Some(Pick { index, candidate: admit(candidate)? }));
        // The first of equals.
        admitted.reduce(|best, next| if next.candidate.odds() > best.candidate.odds() { next } else { best })
    }

    /// All candidates, for display.
    pub fn sightings(&self) -> Vec<Sighting> {
        let sighting = |candidate: &Candidate| {
            let parameters = candidate.attempt.fit.as_ref()?.parameters.clone();
            Some(Sighting { parameters, confidence: candidate.confidence() })
        };
        self.candidates.iter().filter_map(sighting).collect()
    }

    /// Marks a candidate as taken by a track.
    pub fn claim(&mut self, index: usize) {
        self.claimed[index] = true;
    }

    /// True when the fits have used up their allowance.
    fn is_spent(&self, solver: &Solver, context: &FrameContext) -> bool {
        self.fitted >= allowance::CANDIDATES_MIN && self.work > allowance::later_work(solver, context)
    }

    /// The best fit of one object, within its share of the allowance.
    fn try_all(
        &mut self,
        solver: &Solver,
        context: &FrameContext,
        starts: &CandidateStarts,
        handling: PixelHandling,
    ) -> Result<Attempt, CompileFailure> {
        let is_bounded = self.fitted >= allowance::CANDIDATES_MIN;
        let left = allowance::later_work(solver, context).saturating_sub(self.work);
        let budget = if is_bounded { left / allowance::SHARE } else { allowance::first_work(solver, context, starts) };
        let budget = context.budget(budget);
        let bounded = context.for_part(&budget);
        let (best, work) = best_of(solver, &bounded, starts, handling)?;
        self.fitted += 1;
        self.work += if is_bounded { work } else { 0 };
        self.is_cut |= bounded.unfinished().is_some();
        context.take_from(&bounded);
        Ok(best)
    }
}

/// The accepted fit with the smallest χ²/ν, if any is; of poses the likeliest. With the weighted pixels of all passes
/// of all fits.
fn best_of(
    solver: &Solver,
    context: &FrameContext,
    starts: &CandidateStarts,
    handling: PixelHandling,
) -> Result<(Attempt, u64), CompileFailure> {
    let margin = Margin::even(MARGIN_SHARE, MARGIN_PX);
    let mut work = 0;
    let mut best: Option<Attempt> = None;
    let mut others = Vec::new();
    // Fits from a wrong number of a list end in other minima, and may still be accepted.
    let is_listed = starts.alternatives.len() > 1;
    for (number, start) in starts.starts.iter().chain(&starts.alternatives).enumerate() {
        let is_last_resort = number >= starts.starts.len() && !is_listed;
        if is_last_resort && best.as_ref().is_some_and(Attempt::is_good) {
            break;
        }
        let attempt = solver.attempt(context, start, StartKind::Anywhere, handling, margin)?;
        let stages = attempt.fit.iter().flat_map(|fit| &fit.stages);
        let pixels = stages.map(|stage| u64::from(stage.passes) * stage.pixels_first).sum::<u64>();
        work += solver.compiled.weight() as u64 * pixels;
        let rank = |attempt: &Attempt| (!attempt.is_good(), attempt.reduced_chi_square().unwrap_or(f64::INFINITY));
        if best.as_ref().is_none_or(|best| rank(&attempt) < rank(best)) {
            others.extend(best.replace(attempt));
        } else {
            others.push(attempt);
        }
    }
    let best = solver.likeliest_pose(context, best.unwrap_or(Attempt::none(Ending::NoTarget)), others)?;
    Ok((solver.branched_cold(context, best, handling)?, work))
}
