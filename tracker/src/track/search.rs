//! A search: everything in a frame that may be a target, each verified by a fit, the likeliest first.
//!
//! What comes in: a frame, starting values that are given, and targets that are followed already. What goes out:
//! [`Candidate`]s. It never knows which track will take one.

use super::allowance;
use super::candidate::{Candidate, Sighting};
use super::evidence::{Evidence, Ground};
use super::memory::Memory;
use super::peers::{self, Outstanding};
use super::reconsider::{Left, StartOrigin};
use super::solver::{Attempt, Look, Solver};
use super::window::Margin;
use crate::estimate::{Ending, Rejection};
use crate::sight::cold::{Cold, Grain, Spotted, Starts};
use crate::sight::mask::Mask;
use crate::solve::fit::Begin;
use crate::solve::stage_kernels::{CompileFailure, Control};

/// Things that are fitted at most, …
const SIGHTS_MAX: usize = 24;
/// The window around a thing that was seen is larger than the domain by this share …
const MARGIN_SHARE: f64 = 0.5;
/// … and by so many px.
const MARGIN_PX: f64 = 6.0;
/// Pictures of so many pixels are looked at four pixels at a time …
const HALVED_PIXELS: usize = 100_000;
/// … for targets that are not narrower than this from the middle to the rim, px.
const HALVED_PX: f64 = 6.0;
/// Where nothing is known but looks, one of several things must be the target with this probability.
const AMONG_OTHERS: f64 = 0.88;

/// ln of the log-likelihood ratio, against background alone, of what the document's image has found: 4.5 standard deviations,
/// ln (4.5²/2). The filter's own are those of its sums; on uneven ground a fit finds less.
const SIGNIFICANT: f64 = 2.315;
/// A thing's energy is at most so many times that of a box of its size and height.
const ENERGY: f64 = 4.0;

/// How much of what there is has to be fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scope {
    /// The likeliest thing, and no other one that could not be likelier.
    Likeliest,
    /// Everything.
    All,
}

/// What a search came to.
pub(crate) struct Search {
    candidates: Vec<Candidate>,
    claimed: Vec<bool>,
    /// It was said where the target is, and there it was.
    is_placed: bool,
    /// What to report when there is none: the best of the fits that are not believed.
    pub failure: Attempt,
    /// Parameters of the targets that were followed already.
    pub avoided: Vec<Vec<f64>>,
    /// The most massive thing that no fit explains well.
    doubtful: Option<Doubtful>,
    scope: Scope,
    /// Nothing is known of how the target looks.
    is_first: bool,
    /// Things that were fitted, and how many pixels that took in all passes, but for the first ones.
    fitted: usize,
    work: u64,
    /// Things were left because it had used up what it may.
    is_cut: bool,
    /// What stands out by itself.
    things: Vec<Outstanding>,
    /// The share of the ground's variance that is no noise, where that was looked at.
    bumps: Option<f64>,
}

/// A fit that leaves too much unexplained.
struct Doubtful {
    attempt: Attempt,
    start: Vec<f64>,
    ground: Option<Ground>,
    /// All that it leaves unexplained is what hangs together in its residuals: what others leave comes before.
    is_fine: bool,
}

/// The best candidate, and its number.
pub(crate) struct Pick {
    pub index: usize,
    pub candidate: Candidate,
}

impl Search {
    /// Looks at the whole of what may be looked at. `given` numbers take the place of what is seen; `avoided` are the
    /// parameters of targets that are followed already. `size_px`: half the target's width, when it is known. A large
    /// picture is looked at four pixels at a time, and pixel by pixel only for what is small.
    pub fn run(
        solver: &Solver,
        look: &Look,
        given: &[Option<f64>],
        avoided: Vec<Vec<f64>>,
        size_px: Option<f64>,
        scope: Scope,
    ) -> Result<Search, CompileFailure> {
        // Where looks are known, the likeliest is not the largest.
        let is_first = size_px.is_none() && solver.given_looks() == (None, None);
        let is_known = !is_first || solver.options.targets > 1;
        let mut search = Search {
            candidates: Vec::new(),
            claimed: Vec::new(),
            is_placed: false,
            failure: Attempt::none(Ending::NoTarget),
            avoided,
            doubtful: None,
            scope: if is_known { Scope::All } else { scope },
            is_first,
            fitted: 0,
            work: 0,
            is_cut: false,
            things: Vec::new(),
            bumps: None,
        };
        search.find(solver, look, given, size_px)?;
        if look.unfinished().is_some() {
            return Ok(search);
        }
        search.reconsider(solver, look)?;
        if search.is_open(solver) {
            let bumps = search.bumps.unwrap_or(0.0);
            search.candidates.iter_mut().for_each(|one| one.doubt_cut_off(solver, look.window, bumps));
            peers::weigh(solver, look, &mut search.candidates, &search.things);
        }
        // Stable: where there is no evidence the most massive stays first.
        search.candidates.sort_by(|a, b| b.rank().total_cmp(&a.rank()));
        search.merge(solver);
        search.weigh_rivals(solver);
        search.claimed = vec![false; search.candidates.len()];
        if search.is_cut && search.candidates.is_empty() {
            let strongest = search.failure.strongest;
            search.failure = Attempt { strongest, ..Attempt::none(Ending::SearchLimit) };
        }
        Ok(search)
    }

    /// Fits what stands out, and what the document's own image finds.
    fn find(
        &mut self,
        solver: &Solver,
        look: &Look,
        given: &[Option<f64>],
        size_px: Option<f64>,
    ) -> Result<(), CompileFailure> {
        let [width, height, ..] = look.window.size();
        let coarse = width.min(height) > 1 && look.window.pixels() >= HALVED_PIXELS && solver.reaches();
        if coarse && size_px.is_none_or(|size| size >= HALVED_PX) {
            self.look(solver, look, given, Grain::Halved)?;
        }
        if look.unfinished().is_some() {
            return Ok(());
        }
        let is_small = size_px.is_some_and(|size| size < HALVED_PX);
        let detects = solver.bank.is_some();
        if !coarse || (!detects && (is_small || (self.candidates.is_empty() && size_px.is_none()))) {
            self.look(solver, look, given, Grain::Full)?;
        }
        if self.is_wanting(solver, look) && look.unfinished().is_none() {
            self.spot(solver, look, given, size_px)?;
        }
        // What is small and saturated stands out by itself, and is lost where four pixels are looked at as one.
        if coarse && detects && is_small && self.candidates.is_empty() && look.unfinished().is_none() {
            self.look(solver, look, given, Grain::Full)?;
        }
        Ok(())
    }

    /// Looks for what may hide the most massive thing that no fit explains, where nothing else is likely to be the target.
    fn reconsider(&mut self, solver: &Solver, look: &Look) -> Result<(), CompileFailure> {
        // Something faint that a model explains says nothing of the massive thing that it does not explain.
        let is_fine = |candidate: &Candidate| solver.is_fine(&candidate.attempt, None) && candidate.is_likely();
        let Some(Doubtful { attempt, start, ground, .. }) = self.doubtful.take() else { return Ok(()) };
        if self.candidates.iter().any(is_fine) {
            return Ok(());
        }
        let margin = Margin::even(MARGIN_SHARE, MARGIN_PX);
        let had_rows = look.row_variance().is_some();
        let plain = Candidate::of(solver, attempt.clone(), ground);
        let is_sure = plain.is_sure(solver) && !self.is_guess(solver, &plain);
        let left = Left::Structure { is_sure };
        let (attempt, stop) = solver.reconsidered(look, (attempt, left), &start, margin, None, StartOrigin::Search)?;
        self.is_cut |= stop.is_some();
        let has_rows = !had_rows && look.row_variance().is_some();
        if has_rows || attempt.fit.as_ref().is_some_and(|fit| fit.choice.is_some()) {
            let ground = ground.map(|ground| self.looked_at(ground, solver, look, &attempt));
            self.candidates.push(Candidate::of(solver, attempt, ground));
        }
        Ok(())
    }

    fn look(
        &mut self,
        solver: &Solver,
        look: &Look,
        given: &[Option<f64>],
        grain: Grain,
    ) -> Result<(), CompileFailure> {
        let masks = self.avoided.iter().filter_map(|parameters| solver.mask(look, parameters)).collect();
        let sights_max = if solver.reaches() { SIGHTS_MAX } else { 1 };
        let view = solver.view(look, look.window);
        let Some(cold) = Cold::look(solver.model(), &view, &solver.constants, given, sights_max, masks, grain) else {
            return Ok(());
        };
        self.things.extend(cold.sights.iter().filter_map(|starts| Outstanding::of(solver, look, starts)));
        let limit = view.saturation.iter().copied().fold(f64::INFINITY, f64::min);
        let ground = cold.variance.map(|variance| Ground::new(variance, limit));
        let control = if cold.saturated > 0 { Control::Dropping } else { Control::Plain };
        for starts in &cold.sights {
            if self.is_beaten(starts, cold.variance) {
                break;
            }
            if self.is_spent(look) {
                self.is_cut = true;
                break;
            }
            let attempt = self.try_all(solver, look, starts, control)?;
            let (is_good, is_fine) = (attempt.is_good(), solver.is_fine(&attempt, None));
            let seen = ground.filter(|_| is_good).map(|ground| self.looked_at(ground, solver, look, &attempt));
            let own = seen.and_then(|seen| seen.own).filter(|_| solver.model().has_noise());
            let is_left = !is_fine || own.is_some_and(|own| own.structure.is_told());
            let is_explained = seen.is_some_and(|seen| seen.explains(&attempt));
            if is_left && !is_explained && self.doubtful.as_ref().is_none_or(|before| before.is_fine && !is_fine) {
                let (attempt, start) = (attempt.clone(), starts.starts[0].clone());
                let ground = seen.or(ground);
                self.doubtful = Some(Doubtful { attempt, start, ground, is_fine });
            }
            if is_good {
                let candidate = Candidate::of(solver, attempt, seen);
                let is_avoided = self.avoided.iter().any(|other| candidate.coincides(solver, other));
                self.candidates.extend((!is_avoided).then_some(candidate));
                if cold.is_placed {
                    self.is_placed = true;
                    break; // it was said where, and there it is
                }
            } else if self.failure.fit.is_none() {
                self.failure = attempt;
            }
        }
        Ok(())
    }

    fn looked_at(&self, ground: Ground, solver: &Solver, look: &Look, attempt: &Attempt) -> Ground {
        match self.is_first {
            true => {
                ground.seen_first(solver, look, attempt).looked_at(solver, look, attempt).with_profile(solver, attempt)
            }
            false => ground.looked_at(solver, look, attempt),
        }
    }

    /// Nothing was found that is likely to be the target, or more than one thing is looked for. What the border cuts off is not, until
    /// the ground is known.
    fn is_wanting(&self, solver: &Solver, look: &Look) -> bool {
        let is_settled =
            |one: &Candidate| one.is_likely() && (!self.is_open(solver) || one.stands(solver, look.window, self.bumps));
        !self.is_placed && (solver.options.targets > 1 || !self.candidates.iter().any(is_settled))
    }

    /// Fits what the document's own image finds, however faint.
    fn spot(
        &mut self,
        solver: &Solver,
        look: &Look,
        given: &[Option<f64>],
        size_px: Option<f64>,
    ) -> Result<(), CompileFailure> {
        let Some(bank) = &solver.bank else { return Ok(()) };
        let masks: Vec<Mask> = self.avoided.iter().filter_map(|parameters| solver.mask(look, parameters)).collect();
        let view = solver.view(look, look.window);
        let (model, constants) = (solver.model(), &solver.constants);
        let Some(spotted) = Spotted::look(model, &view, constants, given, bank, size_px, &masks) else { return Ok(()) };
        (self.failure.strongest, self.bumps) = (spotted.strongest, Some(spotted.bumps));
        (self.fitted, self.work) = (0, 0);
        let control = if spotted.saturated > 0 { Control::Dropping } else { Control::Plain };
        let limit = view.saturation.iter().copied().fold(f64::INFINITY, f64::min);
        let ground = Some(Ground::new(spotted.variance, limit));
        for (number, starts) in spotted.sights.iter().chain(&spotted.wholes).enumerate() {
            if number >= spotted.sights.len() && !self.is_wanting(solver, look) {
                break;
            }
            let is_known = |candidate: &Candidate| candidate.coincides(solver, &starts.starts[0]);
            if self.candidates.iter().filter(|candidate| candidate.is_likely()).any(is_known) {
                continue;
            }
            if self.is_spent(look) {
                self.is_cut = true;
                break;
            }
            let attempt = self.try_all(solver, look, starts, control)?;
            let mut candidate = self.spotted(solver, look, attempt, starts, ground);
            if self.is_first {
                candidate.doubt_among_bumps(spotted.bumps);
            }
            if candidate.attempt.is_good() {
                let is_avoided = self.avoided.iter().any(|other| candidate.coincides(solver, other));
                self.candidates.extend((!is_avoided).then_some(candidate));
            } else if self.failure.fit.is_none() {
                self.failure = Attempt { strongest: spotted.strongest, ..candidate.attempt };
            }
        }
        Ok(())
    }

    /// Nothing is known but looks, and one thing is the target.
    fn is_open(&self, solver: &Solver) -> bool {
        self.is_first && !self.is_placed && solver.options.targets == 1
    }

    /// What else there is speaks against each.
    fn weigh_rivals(&mut self, solver: &Solver) {
        if !self.is_open(solver) {
            return;
        }
        let strong = self.candidates.iter().map(|candidate| candidate.evidence.filter(|_| !candidate.is_faint));
        let strong: Vec<Option<Evidence>> = strong.collect();
        for (number, candidate) in self.candidates.iter_mut().enumerate() {
            let Some(evidence) = candidate.evidence else { continue };
            let others = strong.iter().enumerate().filter(|(other, _)| *other != number);
            let rivals = others.filter_map(|(_, other)| Some(evidence.odds_against(other.as_ref()?))).sum();
            candidate.evidence.iter_mut().for_each(|evidence| evidence.rivals = rivals);
            candidate.ground.iter_mut().for_each(|ground| ground.rivals = rivals);
        }
    }

    /// A fit of what the document's image has found. That there is something has been decided: a fit that stays there need not
    /// decide again.
    fn spotted(
        &self,
        solver: &Solver,
        look: &Look,
        attempt: Attempt,
        starts: &Starts,
        ground: Option<Ground>,
    ) -> Candidate {
        let ground = ground.map(|ground| self.looked_at(ground, solver, look, &attempt));
        let candidate = Candidate::of(solver, attempt, ground);
        match candidate.attempt.rejection {
            Some(Rejection::Faint) if candidate.stays(solver, &starts.starts[0]) => {
                let attempt = Attempt { rejection: None, ..candidate.attempt.clone() };
                let taken = Candidate { is_faint: true, ..Candidate::of(solver, attempt, ground) };
                if taken.evidence.is_some_and(|evidence| evidence.significance >= SIGNIFICANT) {
                    taken
                } else {
                    candidate
                }
            }
            _ => candidate,
        }
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

    /// True when one of several things must be taken on looks alone, and this one is not likely to be the target. A single
    /// thing is taken even so: a rough model is better than none.
    /// Whoever says how the target looks, takes several or wants whatever there is does not guess.
    pub fn is_guess(&self, solver: &Solver, candidate: &Candidate) -> bool {
        let options = &solver.options;
        if options.confidence_min == 0.0 || options.targets > 1 || solver.given_looks() != (None, None) {
            return false;
        }
        let is_doubtful = candidate.evidence.is_none_or(|evidence| evidence.confidence_alone() < AMONG_OTHERS);
        is_doubtful
            && self.candidates.iter().any(|candidate| candidate.evidence.is_some())
            && !self.is_placed
            && peers::has_others(solver, candidate, &self.candidates, &self.things)
    }

    /// The likeliest that nobody has claimed, whether it is taken or not.
    pub fn doubted(&self) -> Option<Candidate> {
        self.best(|candidate| Some(candidate.clone())).map(|pick| pick.candidate)
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

    /// Fits have used their share of the picture.
    fn is_spent(&self, look: &Look) -> bool {
        self.fitted >= allowance::SIGHTS_MIN && self.work > allowance::of_all(look)
    }

    /// Whatever a fit says of it, something else is likelier: the light that it has is the most that a model can explain.
    fn is_beaten(&self, starts: &Starts, variance: Option<f64>) -> bool {
        let Some((energy, variance)) = starts.energy.zip(variance).filter(|_| self.scope == Scope::Likeliest) else {
            return false;
        };
        let most = Evidence::most(0.5 * ENERGY * energy / variance.max(f64::MIN_POSITIVE));
        self.candidates.iter().any(|candidate| candidate.rank() >= most)
    }

    /// The best fit of one thing, which takes no more than its share.
    fn try_all(
        &mut self,
        solver: &Solver,
        look: &Look,
        starts: &Starts,
        control: Control,
    ) -> Result<Attempt, CompileFailure> {
        let is_bounded = self.fitted >= allowance::SIGHTS_MIN;
        let left = allowance::of_all(look).saturating_sub(self.work);
        let budget = if is_bounded { left / allowance::SHARE } else { allowance::of_first(solver, look, starts) };
        let budget = look.budget(budget);
        let bounded = look.bounded(&budget);
        let (best, work) = best_of(solver, &bounded, starts, control)?;
        self.fitted += 1;
        self.work += if is_bounded { work } else { 0 };
        self.is_cut |= bounded.unfinished().is_some();
        look.take_from(&bounded);
        Ok(best)
    }
}

/// The believable fit with the smallest χ²/ν, if any is; of poses the likeliest. With the pixels of all passes of all fits.
fn best_of(solver: &Solver, look: &Look, starts: &Starts, control: Control) -> Result<(Attempt, u64), CompileFailure> {
    let margin = Margin::even(MARGIN_SHARE, MARGIN_PX);
    let mut work = 0;
    let mut best: Option<Attempt> = None;
    let mut others = Vec::new();
    // From the wrong one of several listed numbers fits end somewhere, and are good.
    let is_listed = starts.others.len() > 1;
    for (number, start) in starts.starts.iter().chain(&starts.others).enumerate() {
        let is_last_resort = number >= starts.starts.len() && !is_listed;
        if is_last_resort && best.as_ref().is_some_and(Attempt::is_good) {
            break;
        }
        let attempt = solver.attempt(look, start, Begin::Anywhere, control, margin)?;
        let stages = attempt.fit.iter().flat_map(|fit| &fit.stages);
        let pixels = stages.map(|stage| u64::from(stage.passes) * stage.pixels_first).sum::<u64>();
        work += solver.compiled.weight() as u64 * pixels;
        let rank = |attempt: &Attempt| (!attempt.is_good(), attempt.reduced().unwrap_or(f64::INFINITY));
        if best.as_ref().is_none_or(|best| rank(&attempt) < rank(best)) {
            others.extend(best.replace(attempt));
        } else {
            others.push(attempt);
        }
    }
    let best = solver.likeliest_pose(look, best.unwrap_or(Attempt::none(Ending::NoTarget)), others)?;
    Ok((solver.branched_cold(look, best, control)?, work))
}
