//! A second look at a fit: one that leaves too much unexplained (glare, something in front of the target, blindness), and one whose
//! pixels were sampled too coarsely.
//!
//! What comes in: an [`Attempt`], and where it started. What goes out: the attempt, a robust fit, or one on another background. It
//! never knows which track it is for.

use super::candidate::Candidate;
use super::ground::Ground;
use super::robust::FITS;
use super::solver::{Attempt, Look, Solver};
use super::window::Margin;

use crate::estimate::{Ending, Rejection, Substitute};
use crate::sight::view::View;
use crate::solve::backgrounds::{self, MISFIT, Rest};
use crate::solve::fit::Fit;
use crate::solve::prepare::{Lacking, Preparation, Preparing};
use crate::solve::sampling::{Chosen, Sampling, Way};
use crate::solve::stage_kernels::CompileFailure;

/// The area of a robust fit is at most so many times that of the start, or that part of it.
const SIZES: f64 = 4.0;
/// Such fits may use every pixel of the picture so many times each, …
const PASSES: u64 = 64;
/// … and so many units at least. A target that fills 96 × 96 px of glare takes half of that.
const WORK_MIN: u64 = 1 << 26;

/// Where a start comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum StartOrigin {
    /// A target that was seen before.
    Prediction,
    /// The picture alone.
    Search,
}

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
    /// How the fit differs from that of the model to all pixels; absent where it does not.
    pub fn choice(&self) -> Option<Substitute> {
        self.fit.as_ref()?.choice
    }

    /// A fit that is believed in the place of this one's.
    fn replaced(&self, fit: Fit) -> Attempt {
        let stages = backgrounds::reports(self.fit.as_ref().map_or(&[][..], |fit| &fit.stages), &fit);
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

    /// The attempt, when it is fine, else a robust fit, or one on another background. While the kernels of these are being
    /// prepared beside the fits it is the attempt, too. With why not all were tried, where they were not.
    pub fn reconsidered(
        &self,
        look: &Look,
        (attempt, left): (Attempt, Left),
        start: &[f64],
        margin: Margin,
        usual: Option<f64>,
        origin: StartOrigin,
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
            attempt = self.described(&bounded, attempt, (start, margin), origin);
        }
        if let Left::Structure { is_sure } = left
            && attempt.is_good()
            && attempt.fit.as_ref().is_some_and(|fit| fit.choice.is_none())
        {
            attempt = self.grounded(&bounded, attempt, margin, is_sure);
        }
        look.take_from(&bounded);
        Ok((attempt, bounded.unfinished()))
    }

    /// A fit that describes all but the outliers of a picture: from the prediction, from where the plain fit ended, or on another
    /// background. The attempt where none does.
    fn described(
        &self,
        look: &Look,
        attempt: Attempt,
        (start, margin): (&[f64], Margin),
        origin: StartOrigin,
    ) -> Attempt {
        let plain = attempt.fit.as_ref().filter(|_| attempt.is_good());
        let view = |at: &[f64]| self.view(look, self.window(look, at, margin));
        let here = view(start);
        let is_noise = plain.is_some_and(|plain| self.leaves_noise(&view(&plain.parameters), plain));
        if is_noise || !self.may_be_robust(look, &here) {
            return attempt;
        }
        let admit = |fit: &Fit, view: &View| self.is_admitted(look, view, fit, (start, origin));
        let mut fits = FITS;
        if let Some(robust) = self.robust_fit(look, &here, start, &mut fits).filter(|fit| admit(fit, &here)) {
            return attempt.replaced(robust);
        }
        let Some(plain) = plain else { return attempt };
        let there = view(&plain.parameters);
        let robust = self.robust_fit_from_afar(look, &there, &plain.parameters, &mut fits);
        if let Some(robust) = robust.filter(|fit| admit(fit, &there)) {
            return attempt.replaced(robust);
        }
        let is_described = |fit: &Fit| {
            let reduced = fit.worth.as_ref().and_then(|worth| worth.reduced);
            reduced.is_some_and(|reduced| reduced <= MISFIT)
        };
        let bent = self.on_background(look, plain, (start, origin), &here, Rest::Anything).filter(is_described);
        match bent {
            Some(found) => attempt.replaced(found),
            None => attempt,
        }
    }

    /// True for a picture when the kernels of robust fits are ready; asks for them otherwise.
    pub(super) fn may_be_robust(&self, look: &Look, view: &View) -> bool {
        if self.model().coordinates().len() != 2 || self.compiled.backgrounds_shelf().is_given_up() {
            return false;
        }
        let is_ready = match self.options.preparing {
            Preparing::AtOnce => true,
            Preparing::Beside => look.ready.robust(&self.compiled, &view.layout),
        };
        if !is_ready {
            look.want(Preparation::new(&self.compiled, view, Lacking::Robust));
        }
        is_ready
    }

    /// Whether a fit is of the target that one began at. It has more freedom and may settle on anything near: it must be there, and
    /// of about that size; a target that nobody has seen yet may be smaller than what stands out of the picture.
    fn is_admitted(&self, look: &Look, view: &View, fit: &Fit, (start, origin): (&[f64], StartOrigin)) -> bool {
        let area = |parameters: &[f64]| self.looks(parameters).0;
        let grown = area(&fit.parameters).zip(area(start)).map_or(0.0, |(now, before)| now - before);
        self.rejection(fit, view, look.window).is_none()
            && grown <= SIZES.ln()
            && (origin == StartOrigin::Search || -grown <= SIZES.ln())
            && Candidate::of(Attempt::of(fit.clone(), None), Ground::default(), None).coincides(self, start)
    }

    /// The attempt, or the same target on a background that leaves nothing in the residuals that hangs together; or less, where it is
    /// taken for the target in any case.
    fn grounded(&self, look: &Look, attempt: Attempt, margin: Margin, is_sure: bool) -> Attempt {
        let Some(plain) = attempt.fit.as_ref() else { return attempt };
        let view = self.view(look, self.window(look, &plain.parameters, margin));
        if !self.may_be_robust(look, &view) {
            return attempt;
        }
        let rest = if is_sure { Rest::Anything } else { Rest::Noise };
        let found = self.on_background(look, plain, (&plain.parameters, StartOrigin::Prediction), &view, rest);
        match found {
            Some(found) => attempt.replaced(found),
            None => attempt,
        }
    }

    /// The fit on the background that explains most; `None` where none explains decisively more.
    fn on_background(
        &self,
        look: &Look,
        plain: &Fit,
        (start, origin): (&[f64], StartOrigin),
        view: &View,
        rest: Rest,
    ) -> Option<Fit> {
        let backgrounds = self.compiled.backgrounds(&|| true)?;
        let admit = |fit: &Fit| self.is_admitted(look, view, fit, (start, origin));
        let own = (&self.constants[..], self.compiled.predictions()?);
        let found = backgrounds.best(view, own, plain, start, rest, &admit);
        // Where a kernel cannot be made, the fit of the model itself is all there is.
        found.inspect_err(|_| self.compiled.backgrounds_shelf().give_up()).ok().flatten()
    }

    /// An attempt that samples as it has to, where the model leaves that open and this one does not.
    pub fn resampled(
        &self,
        look: &Look,
        attempt: &Attempt,
        margin: Margin,
        before: Option<&Chosen>,
    ) -> Option<Attempt> {
        let is_plain = |fit: &&Fit| {
            let is_finer = fit.chosen.is_some() || !Sampling::applies(&self.compiled);
            !is_finer && fit.choice.is_none() && fit.ending.is_fit()
        };
        let plain = attempt.fit.as_ref().filter(is_plain)?;
        let view = self.view(look, self.window(look, &plain.parameters, margin));
        let sampling = self.sampling(look, &view)?;
        let finer = self.sampled_fit(&sampling, &view, &plain.parameters, before, Way::Any);
        let mut finer = finer.filter(|fit| self.rejection(fit, &view, look.window).is_none())?;
        finer.stages = backgrounds::reports(&plain.stages, &finer);
        if let Some((last, earlier)) = finer.stages.last_mut().zip(plain.stages.last()) {
            *last = last.clone().after(earlier);
        }
        Some(Attempt { ending: finer.ending, fit: Some(finer), ..attempt.clone() })
    }
}
