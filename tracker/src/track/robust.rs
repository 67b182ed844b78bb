//! Robust fits: pixels that the model does not describe are left out of a fit, and found anew with its parameters.
//!
//! What comes in: parameters to begin with. What goes out: the fit of the model to the other pixels, with its own domain,
//! background and sampling, and how much of the target it leaves out. It never knows a track.
//!
//! Which pixels are outliers depends on parameters, and parameters on the outliers: expectation–maximisation with masks. Where a
//! start is not nearly right, noise is taken for larger at first (by the root mean square of the residuals) and halved from fit
//! to fit, as in graduated non-convexity.

use isophote_symbolic::ParameterId;

use super::solver::{Look, Solver};
use crate::estimate::{OUTLIERS, Substitute};
use crate::sight::gaps::fill_parts;
use crate::sight::view::View;
use crate::solve::backgrounds::MISFIT;
use crate::solve::covered::Covered;
use crate::solve::fit::{Fit, fit, way_of};
use crate::solve::outliers::{self, LeftOut, background_shifts, outliers, rms};
use crate::solve::painted::dilated;
use crate::solve::residuals::{Over, Seen};
use crate::solve::sampling::Way;
use crate::solve::stage_kernels::Control;
use crate::solve::structure::Structure;

/// A budget: robust fits of a window.
pub(super) const FITS: usize = 20;
/// A budget: a fit has found its outliers when it moves by less than this, in standard deviations.
const SETTLED: f64 = 0.5;
/// Physical: outliers that hide more of a target's light than this leave too little to tell what it is.
pub(super) const HIDDEN_MOST: f64 = 0.6;
/// Physical: a model that leaves out more light of its own sign than it describes has lost its target's core.
const EXCESS_MOST: f64 = 1.0;
/// A budget: rounds of finding outliers, with a fit or without one.
const ROUNDS: usize = 64;
/// A budget: after so many rounds at the noise that the model states, the rest is described or never will be.
const PATIENCE: usize = 4;

impl Solver {
    /// True when a fit leaves nothing but noise, which may be larger than the model states.
    pub(super) fn leaves_noise(&self, view: &View, fit: &Fit) -> bool {
        let seen = self.seen(view, &fit.parameters, Over::Domain);
        let reduced = fit.worth.as_ref().and_then(|worth| worth.reduced);
        seen.zip(reduced)
            .is_some_and(|(seen, reduced)| reduced <= MISFIT * outliers::noise(&seen, view.window.width).powi(2))
    }

    /// The robust fit from a prediction, whose background may be off, in at most `fits`, which are counted down; `None` where it does
    /// not describe the other pixels as well as noise allows, or too little of the target is left.
    pub(super) fn robust_fit(&self, look: &Look, view: &View, start: &[f64], fits: &mut usize) -> Option<Fit> {
        let level = self.model().roles().first().and_then(|roles| roles.background);
        let may_shift = |level: &ParameterId| self.compiled.last_parameters().contains(level);
        let Some(level) = level.filter(|level| self.model().entries() == 1 && may_shift(level)) else {
            return self.robust_from(look, view, start, 1.0, fits);
        };
        let shifts = background_shifts(&self.seen(view, start, Over::Domain)?);
        shifts.into_iter().find_map(|shift| {
            let mut start = start.to_vec();
            start[level.index()] += shift;
            self.robust_from(look, view, &start, 1.0, fits)
        })
    }

    /// The same from a start that is not nearly right.
    pub(super) fn robust_fit_from_afar(
        &self,
        look: &Look,
        view: &View,
        start: &[f64],
        fits: &mut usize,
    ) -> Option<Fit> {
        let scale = 0.5 * rms(&self.seen(view, start, Over::Domain)?);
        self.robust_from(look, view, start, scale, fits)
    }

    fn seen(&self, view: &View, at: &[f64], over: Over) -> Option<Vec<Seen>> {
        self.compiled.predictions()?.residuals(view, at, &self.constants, over)
    }

    /// A fit that leaves out all outliers and describes the rest. Noise is taken for `scale` times the stated one at first.
    fn robust_from(&self, look: &Look, view: &View, start: &[f64], mut scale: f64, fits: &mut usize) -> Option<Fit> {
        if !scale.is_finite() {
            return None;
        }
        let level = self.model().roles().first().and_then(|roles| roles.background);
        let free = self.compiled.last_parameters();
        let (mut at, mut last): (Vec<f64>, Option<(Fit, Covered)>) = (start.to_vec(), None);
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
            let mut way = 0.0;
            if last.as_ref().is_none_or(|(_, covered)| !covered.has(&mask)) {
                *fits = fits.checked_sub(1)?;
                let covered = Covered::of(view, mask);
                let fitted = self.fit_rest(look, &covered.view(view)?, &at, last.as_ref().map(|(fit, _)| fit))?;
                way = way_of(&fitted, &at, free).unwrap_or(f64::INFINITY);
                at.clone_from(&fitted.parameters);
                last = Some((fitted, covered));
            }
            if !is_last {
                continue;
            }
            let (fitted, covered) = last.as_ref()?;
            fits_at_last += 1;
            let mut seen = self.seen(view, &fitted.parameters, Over::Domain)?;
            let left = LeftOut::of(&seen, covered.mask(), level.map(|level| fitted.parameters[level.index()]));
            seen.iter_mut().for_each(|seen| seen.residuals.retain(|residual| !covered.mask()[residual.pixel]));
            noise = outliers::noise(&seen, view.window.width);
            let is_described = fitted.worth.as_ref()?.reduced? <= MISFIT * noise * noise;
            if fits_at_last >= PATIENCE && (!is_described || left.hidden > HIDDEN_MOST) {
                return None;
            }
            // Without the pixels of a ring a fit moves by their noise: a χ² of as many degrees of freedom as parameters.
            let most = if ring > 0 { (free.len() as f64).sqrt() } else { SETTLED };
            let structure = Structure::of(&seen, [view.window.width, view.window.height], 2);
            if way < most && is_described && !structure.is_some_and(|structure| structure.is_told()) {
                // Outliers that hide light which is there as predicted are none: the model is wrong there.
                let is_target = left.hidden <= HIDDEN_MOST && left.excess <= EXCESS_MOST && left.wasted <= OUTLIERS;
                let choice = Some(Substitute { degree: 0, robust: true, hidden: left.hidden });
                return last.filter(|_| is_target).map(|(fit, _)| Fit { choice, ..fit });
            }
            // Where something hangs together in the rest outliers have soft edges.
            if way < most || ring > 0 {
                ring += 1;
            }
        }
        None
    }

    /// The fit of what is not covered; pixels are sampled as finely as they have to be where the model itself is fitted.
    fn fit_rest(&self, look: &Look, rest: &View, start: &[f64], before: Option<&Fit>) -> Option<Fit> {
        let is_fit = |fit: &Fit| fit.is_usable() && fit.worth.is_some();
        let sampled = self.sampling(look, rest).and_then(|sampling| {
            let before = before.and_then(|fit| fit.chosen.as_ref());
            self.sampled_fit(&sampling, rest, start, before, Way::Any).filter(is_fit)
        });
        let plain = || {
            fit(&self.compiled, rest, &self.constants, start, Control::Dropping)
                .inspect_err(|_| self.compiled.backgrounds_shelf().give_up())
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
        let covered = Covered::of(&view, mask);
        assert_eq!(covered.view(&view).unwrap().gap_pixels(), 17 + 4 * 5);
    }
}
