//! How much a fit stands out among what else there is in the frame: a bump of a texture is told from a target that way.
//!
//! What comes in: a fit, and the frame. What goes out: its prominence, and the log odds that it takes away. It never knows a
//! target or a track.
//!
//! *Prominence* is the target's height over the scatter of the heights that its own prediction, as a filter, finds everywhere
//! else in the frame. Where a texture is full of such things, one of them is no target. The scatter is found robustly, so that a
//! few bright things beside the target do not count. What pixels' noise alone makes of it is taken off: how far a target has to
//! exceed noise is decided elsewhere.

use isophote_jit::Window;

use super::elsewhere;
use super::solver::{Look, Solver};
use super::window::Margin;
use crate::sight::background::spread;
use crate::sight::grey::Mixture;
use crate::solve::fit::Fit;
use crate::solve::residuals::{Over, Residual};

/// Places along a side of the frame, …
const PLACES: usize = 12;
/// … so many at least where the target is not.
const PLACES_MIN: usize = 24;
/// Structure is not normal, and a fit chooses place, size and direction in it: its scatter counts by this factor.
const STRUCTURE: f64 = 1.55;
/// So few places may scatter by so many times the variance that noise alone has.
const UNEVEN: f64 = 1.3;
/// Of so many pixels of a filter one is asked for the noise.
const ASKED: usize = 8;
/// A filter has about so many pixels, where nothing depends on its noise.
const PIXELS: usize = 256;
/// From this prominence on nothing does.
const CLEAR: f64 = 20.0;
/// Of a frame without any noise.
const PROMINENCE_MAX: f64 = 1e6;

/// A target of this prominence and more stands out; …
const PROMINENT: f64 = 6.0;
/// … what an e-fold less takes of the log odds, …
const WEIGHT: f64 = 2.5;
/// … and after how many e-folds nothing more is said.
const EFOLDS_MAX: f64 = 2.0;

/// The log odds that a prominence takes away.
pub(super) fn against(prominence: f64) -> f64 {
    WEIGHT * (PROMINENT / prominence).ln().clamp(0.0, EFOLDS_MAX)
}

/// The prominence of a fit, in standard deviations; `None` where there are too few places beside it, or no prediction.
pub(super) fn of(solver: &Solver, look: &Look, fit: &Fit) -> Option<f64> {
    if solver.model().coordinates().len() != 2 || solver.fits_pose() {
        return None;
    }
    let view = solver.view(look, solver.window(look, &fit.parameters, Margin::NONE));
    let predictions = solver.compiled.predictions()?;
    let seen = predictions.residuals(&view, &fit.parameters, &solver.constants, Over::Domain)?;
    let [inside] = &seen[..] else { return None };
    Filter::of(&inside.residuals, view.window)?.prominence(solver, look, view.window)
}

/// A prediction less its mean.
struct Filter {
    /// Place in the window, and weight.
    weights: Vec<([usize; 2], f64)>,
    /// The sum of products where the target is.
    own: f64,
}

impl Filter {
    fn of(residuals: &[Residual], window: Window) -> Option<Filter> {
        let mean = residuals.iter().map(|residual| residual.predicted).sum::<f64>() / residuals.len().max(1) as f64;
        let weight = |one: &Residual| ([one.pixel % window.width, one.pixel / window.width], one.predicted - mean);
        let weights: Vec<_> = residuals.iter().map(weight).collect();
        let own = weights.iter().map(|(_, weight)| weight * weight).sum();
        (own > 0.0).then_some(Filter { weights, own })
    }

    /// Every so many pixels of it.
    fn thinned(&self, pixels: usize) -> Filter {
        let weights: Vec<_> = self.weights.iter().copied().step_by(self.weights.len().div_ceil(pixels)).collect();
        let mean = weights.iter().map(|(_, weight)| weight).sum::<f64>() / weights.len() as f64;
        let weights: Vec<_> = weights.into_iter().map(|(place, weight)| (place, weight - mean)).collect();
        Filter { own: weights.iter().map(|(_, weight)| weight * weight).sum(), weights }
    }

    /// `window`: where the target is.
    fn prominence(&self, solver: &Solver, look: &Look, window: Window) -> Option<f64> {
        let rough = self.thinned(PIXELS).over(solver, look, window)?;
        let is_rough = self.weights.len() > PIXELS && rough < CLEAR;
        if is_rough { self.over(solver, look, window) } else { Some(rough) }
    }

    /// Over the scatter of what it finds elsewhere.
    fn over(&self, solver: &Solver, look: &Look, window: Window) -> Option<f64> {
        let view = solver.view(look, look.window);
        let mixture = Mixture::observed(solver.model(), &solver.constants);
        let value = |[x, y]: [usize; 2]| mixture.at(view.planes.iter().map(|plane| plane.pixel_at([x, y, 0, 0])));
        let found = |place: &[usize; 2]| {
            let at = |[x, y]: [usize; 2]| value([place[0] + x, place[1] + y]);
            self.weights.iter().map(|(pixel, weight)| weight * at(*pixel)).sum::<f64>() / self.own
        };
        let first = look.window.first()[0];
        let last = first + look.window.size()[0] - 1;
        let curvature = |[x, y]: [usize; 2]| match x > first && x < last {
            true => value([x - 1, y]) - 2.0 * value([x, y]) + value([x + 1, y]),
            false => f64::NAN,
        };
        let places = elsewhere::places(look.window, window, PLACES);
        view.spend(places.len() * self.weights.len()).ok()?;
        let found: Vec<f64> = places.iter().map(found).filter(|found| found.is_finite()).collect();
        if found.len() < PLACES_MIN {
            return None;
        }
        let asked = |place: &[usize; 2]| {
            let [left, top] = *place;
            let some = self.weights.iter().step_by(ASKED);
            some.map(move |([x, y], _)| [left + x, top + y]).collect::<Vec<_>>()
        };
        let curvatures = places.iter().flat_map(asked).map(curvature).filter(|value| !value.is_nan());
        let curvatures: Vec<f64> = curvatures.collect();
        // Of the sum of products, as that of the pixels alone makes it.
        let scatter = spread(&found);
        let noise = if curvatures.is_empty() { scatter } else { spread(&curvatures) / (6.0 * self.own).sqrt() };
        let structure = STRUCTURE.powi(2) * (scatter * scatter - UNEVEN * noise * noise).max(0.0);
        Some(structure.sqrt().recip().min(PROMINENCE_MAX))
    }
}
