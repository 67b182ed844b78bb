//! A search: everything in a frame that may be a target, each verified by a fit, the likeliest first.
//!
//! What comes in: a frame, starting values that are given, and targets that are followed already. What goes out:
//! [`Candidate`]s. It never knows which track will take one.

use super::allowance;
use super::candidate::{Candidate, Sighting, is_about};
use super::ground::Ground;
use super::judged::{THINGS, Things};
use super::reconsider::{Left, StartOrigin};
use super::solver::{Attempt, Look, Solver};
use super::window::Margin;
use crate::estimate::{Ending, Rejection};
use crate::sight::cold::{Cold, Grain, Spotted, Starts};
use crate::sight::mask::Mask;
use crate::solve::fit::Begin;
use crate::solve::stage_kernels::{CompileFailure, Control};

/// A budget: the window around a thing that was seen is larger than the domain by this share …
const MARGIN_SHARE: f64 = 0.5;
/// … and by so many px.
const MARGIN_PX: f64 = 6.0;
/// Pictures of so many pixels are looked at four pixels at a time …
const HALVED_PIXELS: usize = 100_000;
/// … for targets that are not narrower than this from the middle to the rim, px.
const HALVED_PX: f64 = 6.0;

/// True for a fit that leaves more unexplained than noise and the ground do.
fn is_left(solver: &Solver, attempt: &Attempt, ground: Ground) -> bool {
    let own = ground.own.filter(|_| solver.model().has_noise());
    let is_left = !solver.is_fine(attempt, None) || own.is_some_and(|own| own.structure.is_told());
    is_left && !ground.explains(attempt)
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
    /// Things that were fitted, and how many pixels that took in all passes, but for the first ones.
    fitted: usize,
    work: u64,
    /// Things were left because it had used up what it may.
    is_cut: bool,
    things: Things,
    /// Nobody has seen the target: its looks are as stated.
    is_first: bool,
}

/// A fit that leaves too much unexplained.
struct Doubtful {
    attempt: Attempt,
    start: Vec<f64>,
    ground: Ground,
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
    ) -> Result<Search, CompileFailure> {
        let mut search = Search {
            candidates: Vec::new(),
            claimed: Vec::new(),
            is_placed: false,
            failure: Attempt::none(Ending::NoTarget),
            avoided,
            doubtful: None,
            fitted: 0,
            work: 0,
            is_cut: false,
            things: Things::default(),
            is_first: size_px.is_none(),
        };
        search.find(solver, look, given, size_px)?;
        if look.unfinished().is_some() {
            return Ok(search);
        }
        search.reconsider(solver, look)?;
        // Stable: where nothing can be told the most massive stays first.
        search.candidates.sort_by(|a, b| b.odds().total_cmp(&a.odds()));
        search.merge(solver);
        if solver.options.targets == 1 {
            search.weigh_rivals(solver);
        }
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
        if self.is_wanting(solver) && look.unfinished().is_none() {
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
        let finer = solver.resampled(look, &attempt, margin, None);
        let is_resampled = finer.is_some();
        let (attempt, ground) = match finer {
            Some(finer) => {
                let ground = Ground::default().looked_at(solver, look, &finer);
                (finer, ground)
            }
            None => (attempt, ground),
        };
        let candidate = self.judged(solver, look, attempt.clone(), ground);
        let left = Left::Structure { is_sure: candidate.is_sure(solver) };
        if is_resampled {
            self.candidates.push(candidate);
            if !is_left(solver, &attempt, ground) {
                return Ok(());
            }
        }
        let had_rows = look.row_variance().is_some();
        let (attempt, stop) = solver.reconsidered(look, (attempt, left), &start, margin, None, StartOrigin::Search)?;
        self.is_cut |= stop.is_some();
        let has_rows = !had_rows && look.row_variance().is_some();
        if has_rows || attempt.choice().is_some() {
            let ground = ground.looked_at(solver, look, &attempt);
            let candidate = self.judged(solver, look, attempt, ground);
            // A background that bends can make up for much of any profile.
            self.candidates.extend((candidate.is_likely() || !candidate.is_bent()).then_some(candidate));
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
        let sights_max = if solver.reaches() { THINGS } else { 1 };
        let view = solver.view(look, look.window);
        let Some(cold) = Cold::look(solver.model(), &view, &solver.constants, given, sights_max, masks, grain) else {
            return Ok(());
        };
        self.things.add(solver, look, &view, &cold.sights);
        let control = if cold.saturated > 0 { Control::Dropping } else { Control::Plain };
        for starts in &cold.sights {
            if self.is_spent(look) {
                self.is_cut = true;
                break;
            }
            let attempt = self.try_all(solver, look, starts, control)?;
            let (is_good, is_fine) = (attempt.is_good(), solver.is_fine(&attempt, None));
            let ground = Ground::default().looked_at(solver, look, &attempt);
            if is_left(solver, &attempt, ground)
                && self.doubtful.as_ref().is_none_or(|before| before.is_fine && !is_fine)
            {
                let (attempt, start) = (attempt.clone(), starts.starts[0].clone());
                self.doubtful = Some(Doubtful { attempt, start, ground, is_fine });
            }
            if is_good {
                let candidate = self.judged(solver, look, attempt, ground);
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

    fn judged(&self, solver: &Solver, look: &Look, attempt: Attempt, ground: Ground) -> Candidate {
        let others = attempt.fit.as_ref().map_or(0.0, |fit| self.things.beside(solver, &fit.parameters));
        let off = attempt.fit.as_ref().filter(|_| self.is_first).map_or(0.0, |fit| solver.off_stated(&fit.parameters));
        let verdict = solver.verdict(look, &attempt, others).map(|verdict| verdict.off_stated(off));
        Candidate::of(attempt, ground, verdict)
    }

    /// Nothing was found that is likely to be the target, or more than one thing is looked for.
    fn is_wanting(&self, solver: &Solver) -> bool {
        !self.is_placed && (solver.options.targets > 1 || !self.candidates.iter().any(Candidate::is_likely))
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
        self.failure.strongest = spotted.strongest;
        self.things.add(solver, look, &view, &spotted.sights);
        (self.fitted, self.work) = (0, 0);
        let control = if spotted.saturated > 0 { Control::Dropping } else { Control::Plain };
        for (number, starts) in spotted.sights.iter().chain(&spotted.wholes).enumerate() {
            if number >= spotted.sights.len() && !self.is_wanting(solver) {
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
            let candidate = self.spotted(solver, look, attempt, starts);
            if candidate.attempt.is_good() {
                let is_avoided = self.avoided.iter().any(|other| candidate.coincides(solver, other));
                self.candidates.extend((!is_avoided).then_some(candidate));
            } else if self.failure.fit.is_none() {
                self.failure = Attempt { strongest: spotted.strongest, ..candidate.attempt };
            }
        }
        Ok(())
    }

    /// One thing is the target: all others that are as bright speak against each.
    fn weigh_rivals(&mut self, solver: &Solver) {
        let parameters = |candidate: &Candidate| candidate.attempt.fit.as_ref().map(|fit| fit.parameters.clone());
        let found: Vec<Option<Vec<f64>>> = self.candidates.iter().map(parameters).collect();
        let odds: Vec<f64> = self.candidates.iter().map(Candidate::odds).collect();
        for (number, candidate) in self.candidates.iter_mut().enumerate() {
            let is_rival = |other: &usize| {
                let both = found[*other].as_ref().zip(found[number].as_ref());
                *other != number && both.is_some_and(|(rival, own)| self.things.is_rival(solver, rival, own))
            };
            let rivals: Vec<usize> = (0..found.len()).filter(is_rival).collect();
            let all = rivals.iter().map(|other| odds[*other]).sum();
            let likeliest = rivals.into_iter().max_by(|a, b| odds[*a].total_cmp(&odds[*b]));
            let rival = likeliest.and_then(|other| solver.centre(found[other].as_ref()?));
            candidate.verdict = candidate.verdict.map(|verdict| verdict.among(all, rival));
        }
    }

    /// A fit of what the document's image has found. That there is something has been decided: a fit that stays there need not
    /// decide again.
    fn spotted(&self, solver: &Solver, look: &Look, mut attempt: Attempt, starts: &Starts) -> Candidate {
        let stays = Candidate::of(attempt.clone(), Ground::default(), None).stays(solver, &starts.starts[0]);
        if attempt.rejection == Some(Rejection::Faint) && stays {
            attempt.rejection = None;
        }
        let ground = Ground::default().looked_at(solver, look, &attempt);
        let candidate = self.judged(solver, look, attempt, ground);
        let verdict = candidate.verdict.map(|verdict| if stays { verdict.detected() } else { verdict });
        Candidate { verdict, ..candidate }
    }

    /// Of several fits of one thing the likeliest remains, or that without its outliers.
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

    /// The likeliest that nobody has claimed, whether it is taken or not.
    pub fn doubted(&self) -> Option<Candidate> {
        self.best(|candidate| Some(candidate.clone())).map(|pick| pick.candidate)
    }

    /// The likeliest that nobody has claimed, of those that `admit` lets through.
    pub fn best(&self, admit: impl Fn(&Candidate) -> Option<Candidate>) -> Option<Pick> {
        let free = self.candidates.iter().enumerate().filter(|(index, _)| !self.claimed[*index]);
        let admitted = free.filter_map(|(index, candidate)| Some(Pick { index, candidate: admit(candidate)? }));
        // The first of equals.
        admitted.reduce(|best, next| if next.candidate.odds() > best.candidate.odds() { next } else { best })
    }

    /// What there is, for people.
    pub fn sightings(&self) -> Vec<Sighting> {
        let sighting = |candidate: &Candidate| {
            let parameters = candidate.attempt.fit.as_ref()?.parameters.clone();
            Some(Sighting { parameters, confidence: candidate.confidence() })
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
