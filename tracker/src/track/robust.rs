//! Robust fits: pixels that the model does not describe are left out of a fit, and found anew with its parameters. The
//! result has its own domain, background and sampling, and says how much of the target it leaves out.
//!
//! Outliers depend on the parameters, and these on the outliers: expectation–maximisation with masks. From a poor
//! start, noise is taken for larger at first (by the root mean square of the residuals) and halved from fit to fit, as
//! in graduated non-convexity.

use isophote_symbolic::ParameterId;

use super::solver::{FrameContext, Solver};
use crate::estimate::{OUTLIERS, Substitute};
use crate::sight::gaps::fill_parts;
use crate::sight::view::View;
use crate::solve::backgrounds::MISFIT;
use crate::solve::fit::{Fit, distance_from_start, fit};
use crate::solve::inpainted::Inpainted;
use crate::solve::nan_masked::dilated;
use crate::solve::outliers::{self, MaskedLight, background_shifts, outliers, rms};
use crate::solve::residuals::{ObservedResiduals, Over};
use crate::solve::sampling::FitMethod;
use crate::solve::stage_kernels::PixelHandling;
use crate::solve::structure::Structure;

/// A budget: robust fits per window.
pub(super) const FITS: usize = 20;
/// A budget: a fit has found its outliers when it moves by less than this, in standard deviations.
const CONVERGED_MOVE: f64 = 0.5;
/// Physical: outliers that hide more of a target's light than this leave too little to identify it.
pub(super) const HIDDEN_MOST: f64 = 0.6;
/// Physical: a model that leaves out more light of its own sign than it describes has lost its target's core.
const EXCESS_MOST: f64 = 1.0;
/// A budget: rounds of finding outliers, with a fit or without one.
const ROUNDS: usize = 64;
/// A budget: rounds at the noise level after which a fit that does not describe the rest is given up.
const PATIENCE: usize = 4;

impl Solver {
    /// True when a fit leaves nothing but noise, which may be larger than the model states.
    pub(super) fn leaves_noise(&self, view: &View, fit: &Fit) -> bool {
        let seen = self.seen(view, &fit.parameters, Over::Domain);
        let reduced = fit.summary.as_ref().and_then(|summary| summary.reduced_chi_square);
        seen.zip(reduced)
            .is_some_and(|(seen, reduced)| reduced <= MISFIT * outliers::noise(&seen, view.window.width).powi(2))
    }

    /// The robust fit from a prediction whose background may be off; counts `fits` down. `None` where it does not
    /// describe the other pixels as well as noise allows, or too little of the target is left.
    pub(super) fn robust_fit(
        &self,
        context: &FrameContext,
        view: &View,
        start: &[f64],
        fits: &mut usize,
    ) -> Option<Fit> {
        let level = self.model().roles().first().and_then(|roles| roles.background);
        let may_shift = |level: &ParameterId| self.compiled.last_parameters().contains(level);
        let Some(level) = level.filter(|level| self.model().entries() == 1 && may_shift(level)) else {
            return self.robust_from(context, view, start, 1.0, fits);
        };
        let shifts = background_shifts(&self.seen(view, start, Over::Domain)?);
        shifts.into_iter().find_map(|shift| {
            let mut start = start.to_vec();
            start[level.index()] += shift;
            self.robust_from(context, view, &start, 1.0, fits)
        })
    }

    /// The same from a poor start.
    pub(super) fn robust_fit_from_afar(
        &self,
        context: &FrameContext,
        view: &View,
        start: &[f64],
        fits: &mut usize,
    ) -> Option<Fit> {
        let scale = 0.5 * rms(&self.seen(view, start, Over::Domain)?);
        self.robust_from(context, view, start, scale, fits)
    }

    fn seen(&self, view: &View, at: &[f64], over: Over) -> Option<Vec<ObservedResiduals>> {
        self.compiled.predictions()?.residuals(view, at, &self.constants, over)
    }

    /// A fit that leaves out all outliers and describes the rest. Noise starts at `scale` times the stated one.
    fn robust_from(
        &self,
        context: &FrameContext,
        view: &View,
        start: &[f64],
        mut scale: f64,
        fits: &mut usize,
    ) -> Option<Fit> {
        if !scale.is_finite() {
            return None;
        }
        let level = self.model().roles().first().and_then(|roles| roles.background);
        let free = self.compiled.last_parameters();
        let (mut at, mut last): (Vec<f64>, Option<(Fit, Inpainted)>) = (start.to_vec(), None);
        let (mut noise, mut ring, mut fits_at_last) = (1.0, 0, 0);
        for _ in 0..ROUNDS {
            let is_last = scale <= noise;
            // The domain of a fit may grow and move: outliers are looked for beyond it.
            view.spend(outliers::WORK * view.window.pixels()).ok()?;
            let mask = outliers(&self.seen(view, &at, Over::Everything)?, view.window, scale.max(noise));
            scale *= 0.5;
            if !mask.contains(&true) && last.is_none() {
                if is_last {
                    return None;
                }
                continue;
            }
            let mut mask = dilated(&mask, view.window.width, view.window.height, ring);
            fill_parts(&mut mask, view.window, &view.gaps, false);
            let mut moved = 0.0;
            if last.as_ref().is_none_or(|(_, inpainted)| !inpainted.has(&mask)) {
                *fits = fits.checked_sub(1)?;
                let inpainted = Inpainted::of(view, mask);
                let fitted = self.fit_rest(context, &inpainted.view(view)?, &at, last.as_ref().map(|(fit, _)| fit))?;
                moved = distance_from_start(&fitted, &at, free).unwrap_or(f64::INFINITY);
                at.clone_from(&fitted.parameters);
                last = Some((fitted, inpainted));
            }
            if !is_last {
                continue;
            }
            let (fitted, inpainted) = last.as_ref()?;
            fits_at_last += 1;
            let mut seen = self.seen(view, &fitted.parameters, Over::Domain)?;
            let masked_light =
                MaskedLight::of(&seen, inpainted.mask(), level.map(|level| fitted.parameters[level.index()]));
            seen.iter_mut().for_each(|seen| seen.residuals.retain(|residual| !inpainted.mask()[residual.pixel]));
            noise = outliers::noise(&seen, view.window.width);
            let is_described = fitted.summary.as_ref()?.reduced_chi_square? <= MISFIT * noise * noise;
            if fits_at_last >= PATIENCE && (!is_described || masked_light.hidden > HIDDEN_MOST) {
                return None;
            }
            // Without the pixels of a ring a fit moves by their noise: a χ² of as many degrees of freedom as parameters.
            let most = if ring > 0 { (free.len() as f64).sqrt() } else { CONVERGED_MOVE };
            let structure = Structure::of(&seen, [view.window.width, view.window.height], 2);
            if moved < most && is_described && !structure.is_some_and(|structure| structure.is_significant()) {
                // Masked pixels that show the light as predicted are no outliers: the model is wrong there.
                let is_target = masked_light.hidden <= HIDDEN_MOST
                    && masked_light.excess <= EXCESS_MOST
                    && masked_light.wasted <= OUTLIERS;
                let choice = Some(Substitute { degree: 0, robust: true, hidden: masked_light.hidden });
                return last.filter(|_| is_target).map(|(fit, _)| Fit { choice, ..fit });
            }
            // Correlated residuals in the rest: the outliers have soft edges.
            if moved < most || ring > 0 {
                ring += 1;
            }
        }
        None
    }

    /// Fits the uncovered pixels, with chosen sampling where that is available.
    fn fit_rest(&self, context: &FrameContext, rest: &View, start: &[f64], before: Option<&Fit>) -> Option<Fit> {
        let is_fit = |fit: &Fit| fit.is_usable() && fit.summary.is_some();
        let sampled = self.sampling(context, rest).and_then(|sampling| {
            let before = before.and_then(|fit| fit.sampling_choice.as_ref());
            self.sampled_fit(&sampling, rest, start, before, FitMethod::RefineOrFull).filter(is_fit)
        });
        let plain = || {
            fit(&self.compiled, rest, &self.constants, start, PixelHandling::SkipSaturated)
                .inspect_err(|_| self.compiled.prepared_backgrounds().mark_failed())
                .ok()
                .filter(is_fit)
        };
        sampled.or_else(plain)
    }
}

#[cfg(test)]
mod tests {
    use isophote_jit::{PixelFormat, PlaneView, Window};
    use isophote_symbolic::Precision;
    use smallvec::smallvec;

    use super::*;

    #[test]
    fn a_ring_does_not_reach_into_gaps() {
        let bytes = [0; 400];
        let plane = PlaneView::new(PixelFormat::U8, &bytes, 20, 20, 20, 1).unwrap();
        let window = Window { x: 2, y: 3, width: 18, height: 17, ..Window::whole(20, 20) };
        let mut view = View::new(vec![plane], window, smallvec![255.0], Precision::F32);
        view.gaps = vec![Window { x: 10, y: 0, width: 1, height: 20, ..window }];
        let outlier: Vec<bool> = (0..18 * 17).map(|pixel| pixel == 5 * 18 + 7).collect();
        let mut mask = dilated(&outlier, 18, 17, 2);
        fill_parts(&mut mask, window, &view.narrowed(window).gaps, false);
        // Five columns but the gap's, which is the one beside the outlier.
        assert_eq!(mask.iter().filter(|masked| **masked).count(), 4 * 5);
        assert!((0..17).all(|row| !mask[row * 18 + 8]));
        let inpainted = Inpainted::of(&view, mask);
        assert_eq!(inpainted.view(&view).unwrap().gap_pixels(), 17 + 4 * 5);
    }
}
