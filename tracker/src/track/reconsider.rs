//! A second look at a fit that leaves too much unexplained (glare, an occluder, saturation) or that sampled pixels too
//! coarsely: a robust fit, or one on another background.

use super::candidate::Candidate;
use super::pixel_statistics::PixelStatistics;
use super::robust::FITS;
use super::solver::{Attempt, FrameContext, Solver};
use super::window::Margin;

use crate::estimate::{Ending, Rejection, Substitute};
use crate::sight::elsewhere::{WINDOWS_MAX, elsewhere};
use crate::sight::view::View;
use crate::solve::backgrounds::{self, AllowedResiduals, MISFIT};
use crate::solve::fit::Fit;
use crate::solve::prepare::{MissingKernels, Preparation, Preparing};
use crate::solve::sampling::{FitMethod, Sampling, SamplingChoice};
use crate::solve::stage_kernels::CompileFailure;

/// Largest factor between the areas of a robust fit and of its start.
const SIZES: f64 = 4.0;
/// Budget of such fits: passes over every pixel of the window.
const PASSES: u64 = 64;
/// Their least budget, units. A target that fills 96 × 96 px of glare takes half of that.
const WORK_MIN: u64 = 1 << 26;

/// The origin of a start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum StartOrigin {
    /// A target that was seen before.
    Prediction,
    /// The picture alone.
    Search,
}

/// The residuals that a fit leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ResidualKind {
    Noise,
    /// Residuals that are correlated, or may be, however slightly. `is_sure`: the fit is taken for the target even so.
    Structure {
        is_sure: bool,
    },
}

impl Attempt {
    /// How the fit differs from a fit of the model to all pixels; `None` where it does not.
    pub fn choice(&self) -> Option<Substitute> {
        self.fit.as_ref()?.choice
    }

    /// The attempt with an accepted fit instead of its own.
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
                && attempt
                    .reduced_chi_square()
                    .is_some_and(|reduced| reduced <= MISFIT * usual.unwrap_or(1.0).max(1.0)))
    }

    /// The attempt if it is fine, else a fit with row offsets, a robust fit, or one on another background; also the
    /// attempt while the kernels of these are being prepared. With the reason why not all were tried, if so.
    pub fn reconsidered(
        &self,
        context: &FrameContext,
        (attempt, left): (Attempt, ResidualKind),
        start: &[f64],
        margin: Margin,
        usual: Option<f64>,
        origin: StartOrigin,
    ) -> Result<(Attempt, Option<Ending>), CompileFailure> {
        let is_blank = attempt.rejection == Some(Rejection::Faint)
            && attempt.reduced_chi_square().is_some_and(|reduced| reduced <= MISFIT * usual.unwrap_or(1.0).max(1.0));
        let is_plain = self.is_fine(&attempt, usual) && left == ResidualKind::Noise;
        if is_blank || is_plain || context.unfinished().is_some() {
            return Ok((attempt, None));
        }
        let budget = context.budget((PASSES * context.window.pixels() as u64).max(WORK_MIN));
        let bounded = context.for_part(&budget);
        let mut attempt = self.off_by_rows(&bounded, attempt, start, margin)?;
        if !self.is_fine(&attempt, usual) {
            attempt = self.described(&bounded, attempt, (start, margin), origin);
        }
        if let ResidualKind::Structure { is_sure } = left
            && attempt.is_good()
            && attempt.fit.as_ref().is_some_and(|fit| fit.choice.is_none())
        {
            attempt = self.grounded(&bounded, attempt, margin, is_sure);
        }
        context.take_from(&bounded);
        Ok((attempt, bounded.unfinished()))
    }

    /// A fit that describes all but the outliers of a picture: robust from the prediction, robust from where the plain
    /// fit ended, or on another background; else the attempt.
    fn described(
        &self,
        context: &FrameContext,
        attempt: Attempt,
        (start, margin): (&[f64], Margin),
        origin: StartOrigin,
    ) -> Attempt {
        let plain = attempt.fit.as_ref().filter(|_| attempt.is_good());
        let view = |at: &[f64]| self.view(context, self.window(context, at, margin));
        let here = view(start);
        let is_noise = plain.is_some_and(|plain| self.leaves_noise(&view(&plain.parameters), plain));
        if is_noise || !self.may_be_robust(context, &here) {
            return attempt;
        }
        let admit = |fit: &Fit, view: &View| self.is_admitted(context, view, fit, (start, origin));
        let mut fits = FITS;
        if let Some(robust) = self.robust_fit(context, &here, start, &mut fits).filter(|fit| admit(fit, &here)) {
            return attempt.replaced(robust);
        }
        let Some(plain) = plain else { return attempt };
        let done = view(&plain.parameters);
        let robust = self.robust_fit_from_afar(context, &done, &plain.parameters, &mut fits);
        if let Some(robust) = robust.filter(|fit| admit(fit, &done)) {
            return attempt.replaced(robust);
        }
        let is_described = |fit: &Fit| {
            let reduced = fit.summary.as_ref().and_then(|summary| summary.reduced_chi_square);
            reduced.is_some_and(|reduced| reduced <= MISFIT)
        };
        let bent =
            self.on_background(context, plain, (start, origin), &here, AllowedResiduals::Anything).filter(is_described);
        match bent {
            Some(found) => attempt.replaced(found),
            None => attempt,
        }
    }

    /// True in two dimensions when the kernels of robust fits are ready; requests them otherwise.
    pub(super) fn may_be_robust(&self, context: &FrameContext, view: &View) -> bool {
        if self.model().coordinates().len() != 2 || self.compiled.prepared_backgrounds().has_failed() {
            return false;
        }
        let is_ready = match self.options.preparing {
            Preparing::AtOnce => true,
            Preparing::Beside => context.ready.robust(&self.compiled, &view.layout),
        };
        if !is_ready {
            context.request_kernels(Preparation::new(&self.compiled, view, MissingKernels::Robust));
        }
        is_ready
    }

    /// Whether a fit is of the target it started from. It has more freedom and may settle on anything near: it must
    /// agree with the start in position and size; the target of a search may be smaller than the object that was
    /// detected.
    fn is_admitted(
        &self,
        context: &FrameContext,
        view: &View,
        fit: &Fit,
        (start, origin): (&[f64], StartOrigin),
    ) -> bool {
        let area = |parameters: &[f64]| self.ln_size_and_brightness(parameters).0;
        let grown = area(&fit.parameters).zip(area(start)).map_or(0.0, |(now, before)| now - before);
        self.rejection(fit, view, context.window).is_none()
            && grown <= SIZES.ln()
            && (origin == StartOrigin::Search || -grown <= SIZES.ln())
            && Candidate::of(Attempt::of(fit.clone(), None), PixelStatistics::default(), None).coincides(self, start)
    }

    /// The attempt, or the same target on a background that leaves only uncorrelated residuals; with `is_sure`, on any
    /// that explains decisively more.
    fn grounded(&self, context: &FrameContext, attempt: Attempt, margin: Margin, is_sure: bool) -> Attempt {
        let Some(plain) = attempt.fit.as_ref() else { return attempt };
        let view = self.view(context, self.window(context, &plain.parameters, margin));
        if !self.may_be_robust(context, &view) {
            return attempt;
        }
        let rest = if is_sure { AllowedResiduals::Anything } else { AllowedResiduals::Noise };
        let found = self.on_background(context, plain, (&plain.parameters, StartOrigin::Prediction), &view, rest);
        match found {
            Some(found) => attempt.replaced(found),
            None => attempt,
        }
    }

    /// The fit on the background that explains most; `None` where none explains decisively more.
    fn on_background(
        &self,
        context: &FrameContext,
        plain: &Fit,
        (start, origin): (&[f64], StartOrigin),
        view: &View,
        rest: AllowedResiduals,
    ) -> Option<Fit> {
        let backgrounds = self.compiled.backgrounds(&|| true)?;
        let admit = |fit: &Fit| self.is_admitted(context, view, fit, (start, origin));
        let own = (&self.constants[..], self.compiled.predictions()?);
        // Windows that share at most half of their pixels with the target's.
        let half = [view.window.width, view.window.height].map(|length| 0.5 * length as f64);
        let is_apart = |offset: [f64; 2]| (0..2).any(|axis| offset[axis].abs() >= half[axis]);
        let windows = elsewhere(context.window, view.window, WINDOWS_MAX, is_apart);
        let windows: Vec<View> = windows.into_iter().map(|window| self.view(context, window)).collect();
        let found = backgrounds.best((view, &windows), own, plain, start, rest, &admit);
        // Without a kernel only the model's own fit remains.
        found.inspect_err(|_| self.compiled.prepared_backgrounds().mark_failed()).ok().flatten()
    }

    /// The attempt refitted with chosen sampling, where the model leaves the quadrature open and the attempt is a plain
    /// fit without it.
    pub fn resampled(
        &self,
        context: &FrameContext,
        attempt: &Attempt,
        margin: Margin,
        before: Option<&SamplingChoice>,
    ) -> Option<Attempt> {
        let is_plain = |fit: &&Fit| {
            let is_finer = fit.sampling_choice.is_some() || !Sampling::applies(&self.compiled);
            !is_finer && fit.choice.is_none() && fit.ending.is_fit()
        };
        let plain = attempt.fit.as_ref().filter(is_plain)?;
        let view = self.view(context, self.window(context, &plain.parameters, margin));
        let sampling = self.sampling(context, &view)?;
        let finer = self.sampled_fit(&sampling, &view, &plain.parameters, before, FitMethod::RefineOrFull);
        let mut finer = finer.filter(|fit| self.rejection(fit, &view, context.window).is_none())?;
        finer.stages = backgrounds::reports(&plain.stages, &finer);
        if let Some((last, earlier)) = finer.stages.last_mut().zip(plain.stages.last()) {
            *last = last.clone().after(earlier);
        }
        Some(Attempt { ending: finer.ending, fit: Some(finer), ..attempt.clone() })
    }
}
