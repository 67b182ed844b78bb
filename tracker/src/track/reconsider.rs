//! A second look at a fit: one that leaves too much unexplained (glare, something in front of the target, blindness), and one whose
//! pixels were sampled too coarsely.
//!
//! What comes in: an [`Attempt`], and where it started. What goes out: the attempt, or that of the alternative model that
//! explains more. It never knows which track it is for.

use std::sync::Arc;

use super::candidate::Candidate;
use super::past::is_doubtful;
use super::solver::{Attempt, Look, Solver};
use super::uncovered::Uncovered;
use super::window::Margin;

use crate::estimate::{Ending, Rejection};
use crate::sight::view::View;
use crate::solve::alternatives::{self, Alternatives, Cover, MISFIT, Rest, StartsFrom};
use crate::solve::fit::Fit;
use crate::solve::prepare::{Lacking, Preparation, Preparing};
use crate::solve::sampling::{Chosen, Sampling, Way};
use crate::solve::stage_kernels::CompileFailure;

/// χ²/ν from which on a cold start is not sure of where the target is, so that others are tried around it.
const ASTRAY: f64 = 4.0;
/// The area of an alternative is at most so many times that of the start, or that part of it; of a start that nobody has
/// confirmed a smaller part.
const SIZES: f64 = 4.0;
/// What hides more than this share of a target may be told in other ways, too.
const HIDDEN_MOST: f64 = 0.5;
/// As long as the target is not where it will be found, it may look like so much.
const HIDDEN_AT_FIRST: f64 = 0.75;
/// Alternatives may use every pixel of the picture so many times each, …
const PASSES: u64 = 64;
/// … and so many units at least. A target that fills 96 × 96 px of glare takes half of that.
const WORK_MIN: u64 = 1 << 26;

/// What a fit leaves unexplained.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Left {
    Noise,
    /// What the ground leaves as well.
    Ground,
    /// Something in it hangs together, or may, however little that is. `is_sure`: the fit is taken for the target even so.
    Structure {
        is_sure: bool,
    },
}

impl Attempt {
    /// A fit that is believed in the place of this one's.
    fn replaced(&self, fit: Fit) -> Attempt {
        let stages = alternatives::reports(self.fit.as_ref().map_or(&[][..], |fit| &fit.stages), &fit);
        Attempt::of(Fit { stages, ..fit }, None)
    }
}

impl Solver {
    /// True when a fit leaves no more unexplained than usual: χ²/ν of 1, or that of the last fit. Poses have rules of their
    /// own: see [`super::branch`].
    pub fn is_fine(&self, attempt: &Attempt, usual: Option<f64>) -> bool {
        !self.model().has_noise()
            || self.fits_pose()
            || (attempt.is_good()
                && attempt.reduced().is_some_and(|reduced| reduced <= MISFIT * usual.unwrap_or(1.0).max(1.0)))
    }

    /// The attempt, when it is fine, else the best of the alternatives that begin at `start` as well. While these are being
    /// prepared beside the fits it is the attempt, too. With why the alternatives were not all tried, where they were not.
    pub fn reconsidered(
        &self,
        look: &Look,
        (attempt, left): (Attempt, Left),
        start: &[f64],
        margin: Margin,
        usual: Option<f64>,
        starts: StartsFrom,
    ) -> Result<(Attempt, Option<Ending>), CompileFailure> {
        // Where ground alone explains what there is, nothing is hidden either.
        let is_blank = attempt.rejection == Some(Rejection::Faint)
            && attempt.reduced().is_some_and(|reduced| reduced <= MISFIT * usual.unwrap_or(1.0).max(1.0));
        let is_plain = self.is_fine(&attempt, usual) && left == Left::Noise;
        if is_blank || is_plain || left == Left::Ground || look.unfinished().is_some() {
            return Ok((attempt, None));
        }
        let budget = look.budget((PASSES * look.window.pixels() as u64).max(WORK_MIN));
        let bounded = look.bounded(&budget);
        let mut attempt = self.off_by_rows(&bounded, attempt, start, margin)?;
        if !self.is_fine(&attempt, usual) {
            attempt = self.best_explained(&bounded, attempt, (start, margin), starts)?;
        }
        if let Left::Structure { is_sure } = left
            && attempt.is_good()
            && attempt.fit.as_ref().is_some_and(|fit| fit.choice.is_none())
        {
            attempt = self.grounded(&bounded, attempt, margin, is_sure)?;
        }
        look.take_from(&bounded);
        Ok((attempt, bounded.unfinished()))
    }

    /// The best of the alternatives, or the attempt where none explains more.
    fn best_explained(
        &self,
        look: &Look,
        attempt: Attempt,
        (start, margin): (&[f64], Margin),
        from: StartsFrom,
    ) -> Result<Attempt, CompileFailure> {
        let view = self.view(look, self.window(look, start, margin));
        let Some(alternatives) = self.alternatives(look, &view) else { return Ok(attempt) };
        let astray = !attempt.is_good() || attempt.reduced().is_none_or(|reduced| reduced > ASTRAY);
        let starts = match from {
            StartsFrom::Scattered if astray => alternatives::scattered(self.model(), start),
            _ => vec![start.to_vec()],
        };
        let plain = attempt.fit.as_ref().filter(|_| attempt.is_good());
        // What stands out of a picture is as large as the glare is.
        let least = if starts.len() > 1 { SIZES.powi(-3) } else { SIZES.recip() };
        let admit = |fit: &Fit| self.is_admitted(look, &view, fit, (start, least));
        // A start that says too little of the brightness explains nothing, where the plain fit has found that.
        let behind = |start: &[f64]| self.behind(look, &alternatives, &view, (start, margin, from), &admit);
        if let Some(fit) = behind(start).or_else(|| behind(&plain?.parameters)) {
            return Ok(attempt.replaced(fit));
        }
        // Where an alternative's kernel cannot be made, the fit of the model itself is what there is.
        let chosen = alternatives.best(&view, &self.constants, &starts, plain, &admit);
        let Some(chosen) = chosen.inspect_err(|_| self.compiled.alternatives_shelf().give_up()).ok().flatten() else {
            return Ok(attempt);
        };
        let covered = chosen.choice.filter(|choice| choice.hidden > 0.0);
        let uncovered = covered.and_then(|choice| {
            let uncovered = self.uncovered(look, &chosen.parameters, margin, &|_| true)?;
            Some(Uncovered { hidden: choice.hidden, ..uncovered }.into_fit()).filter(&admit)
        });
        let chosen = uncovered.unwrap_or(chosen);
        Ok(match self.rejection(&chosen, &view, look.window) {
            None => attempt.replaced(chosen),
            Some(_) => attempt,
        })
    }

    /// The target behind something dark that hides less than half of it, where that alone explains all that there is, as far as noise
    /// allows to tell.
    fn behind(
        &self,
        look: &Look,
        alternatives: &Alternatives,
        view: &View,
        (start, margin, starts): (&[f64], Margin, StartsFrom),
        admit: &dyn Fn(&Fit) -> bool,
    ) -> Option<Fit> {
        let is_wanted = |cover: Cover| cover.is_dark && cover.hidden <= HIDDEN_AT_FIRST;
        let fit = |from: &[f64]| {
            let uncovered = self.uncovered(look, from, margin, &is_wanted)?;
            let is_told = uncovered.hidden <= HIDDEN_MOST && !is_doubtful(&uncovered.fit);
            Some(uncovered).filter(|_| is_told).map(Uncovered::into_fit).filter(admit)
        };
        let followed = (starts == StartsFrom::Followed).then(|| fit(start)).flatten();
        // A fit that hides a part of the target as well explains the rest no worse.
        let hidden = |fit: &Fit| fit.choice.map_or(0.0, |choice| choice.hidden);
        let robust = |start: &[f64]| {
            let found = alternatives.robustly(view, &self.constants, start).filter_map(|from| fit(&from));
            found.min_by(|a, b| hidden(a).total_cmp(&hidden(b)))
        };
        let raised = || robust(&alternatives.raised(view, &self.constants, start)?);
        followed.or_else(|| robust(start)).or_else(raised)
    }

    /// The alternatives, or a word that they are wanted.
    fn alternatives(&self, look: &Look, view: &View) -> Option<Arc<Alternatives>> {
        let alternatives = match self.options.preparing {
            Preparing::AtOnce => self.compiled.alternatives(&|| true),
            Preparing::Beside => look.ready.alternatives(&self.compiled, &view.layout),
        };
        if alternatives.is_none() {
            look.want(Preparation::new(&self.compiled, view, Lacking::Alternatives));
        }
        alternatives
    }

    /// Whether a fit is of the target that one began at. An alternative has more freedom and may settle on anything near: it must be
    /// of about that size, `least` times its area or more, and there.
    fn is_admitted(&self, look: &Look, view: &View, fit: &Fit, (start, least): (&[f64], f64)) -> bool {
        let area = |parameters: &[f64]| self.looks(parameters).0;
        let grown = area(&fit.parameters).zip(area(start)).map_or(0.0, |(now, before)| now - before);
        self.rejection(fit, view, look.window).is_none()
            && (least.ln()..=SIZES.ln()).contains(&grown)
            && Candidate::of(self, Attempt::of(fit.clone(), None), None).coincides(self, start)
    }

    /// The attempt, or the same target on a background that leaves nothing in the residuals that hangs together; or less, where it is
    /// taken for the target in any case.
    fn grounded(
        &self,
        look: &Look,
        attempt: Attempt,
        margin: Margin,
        is_sure: bool,
    ) -> Result<Attempt, CompileFailure> {
        let Some(plain) = attempt.fit.as_ref() else { return Ok(attempt) };
        let view = self.view(look, self.window(look, &plain.parameters, margin));
        let Some(alternatives) = self.alternatives(look, &view) else { return Ok(attempt) };
        let admit = |fit: &Fit| self.is_admitted(look, &view, fit, (&plain.parameters, SIZES.recip()));
        let rest = if is_sure { Rest::Anything } else { Rest::Noise };
        let found = alternatives.grounded(&view, &self.constants, plain, rest, &admit);
        let found = found.inspect_err(|_| self.compiled.alternatives_shelf().give_up()).ok().flatten();
        let Some(found) = found else { return Ok(attempt) };
        Ok(attempt.replaced(found))
    }

    /// A candidate whose fit did not sample as it has to, where the model leaves that open, with one that does.
    pub fn resampled(&self, look: &Look, candidate: Candidate, margin: Margin, before: Option<&Chosen>) -> Candidate {
        let is_plain = |fit: &&Fit| {
            let is_finer = fit.chosen.is_some() || !Sampling::applies(&self.compiled);
            !is_finer && fit.choice.is_none() && fit.ending.is_fit()
        };
        let Some(plain) = candidate.attempt.fit.as_ref().filter(is_plain) else { return candidate };
        let view = self.view(look, self.window(look, &plain.parameters, margin));
        let Some(sampling) = self.sampling(look, &view) else { return candidate };
        let finer = self.sampled_fit(&sampling, &view, &plain.parameters, before, Way::Any);
        let is_good = |fit: &Fit| self.rejection(fit, &view, look.window).is_none();
        let Some(mut finer) = finer.filter(is_good) else { return candidate };
        finer.stages = alternatives::reports(&plain.stages, &finer);
        if let Some((last, earlier)) = finer.stages.last_mut().zip(plain.stages.last()) {
            *last = last.clone().after(earlier);
        }
        let attempt = Attempt { ending: finer.ending, fit: Some(finer), ..candidate.attempt };
        let mut anew = Candidate::of(self, attempt, candidate.ground);
        // What was expected of it is as it was.
        if let Some((now, then)) = anew.evidence.as_mut().zip(candidate.evidence) {
            (now.distance, now.strangeness, now.is_confirmed) = (then.distance, then.strangeness, then.is_confirmed);
        }
        anew
    }
}
