//! What the ground of a frame leaves in the residuals of a target that stands on it: a model that is right leaves as much.
//!
//! What comes in: a fit, and the frame. What goes out: [`Uneven`]. It never knows a target or a track.
//!
//! The pixels of the target's domain are laid over places of the frame where it is not. What the fit's parameters can take up there
//! is taken away, to first order, and the rest is looked at as if it were the residuals of the target. A place
//! that most of them are below counts, so that a few other things in the frame do not.

use isophote_jit::Window;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::elsewhere;
use super::solver::{Look, Solver};
use super::window::Margin;
use crate::sight::background::{median, quantile};
use crate::sight::grey::Mixture;
use crate::sight::view::View;
use crate::solve::exact;
use crate::solve::fit::Fit;
use crate::solve::residuals::{Over, Residual, Seen};
use crate::solve::structure::Structure;

/// Places along a side of the frame, …
const PLACES: usize = 5;
/// … so many of which are enough where they hold so many pixels together; fewer than the last say nothing.
const PIXELS: usize = 40_000;
const PLACES_MIN: usize = 8;
/// Fewer pixels of a target say nothing.
const PIXELS_MIN: usize = 30;

/// What the ground leaves of a target may be so many times what it leaves at the place that so large a share of all others is
/// below, where there are so many, or else at the middle one, …
const FORGIVEN_STRUCTURE: f64 = 3.0;
const OFTEN: f64 = 0.7;
const PLACES_OFTEN: usize = 20;
/// … and what noise does beyond what a model says, so many times.
const FORGIVEN_NOISE: f64 = 1.3;

/// What is no misfit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Uneven {
    /// Of [`Structure::share`].
    #[serde(with = "exact")]
    pub share: f64,
    /// Of what χ²/ν exceeds 1 by, where a model says what noise is.
    #[serde(with = "exact")]
    pub excess: f64,
}

/// Of one target in two dimensions, of which one value is observed; `None` where there are too few places beside it.
pub(super) fn of(solver: &Solver, look: &Look, fit: &Fit) -> Option<Uneven> {
    if solver.model().coordinates().len() != 2 || solver.model().roles().len() != 1 || solver.fits_pose() {
        return None;
    }
    let own = solver.view(look, solver.window(look, &fit.parameters, Margin::NONE));
    let seen = solver.compiled.predictions()?.residuals(&own, &fit.parameters, &solver.constants, Over::Domain)?;
    let [seen] = &seen[..] else { return None };
    let pixels: Vec<Residual> = seen.residuals.iter().filter(|residual| !residual.saturated).copied().collect();
    let window = bounds(&pixels, own.window).filter(|_| pixels.len() >= PIXELS_MIN)?;
    let mixture = Mixture::linear(solver.model(), &solver.constants)?;
    let places = elsewhere::places(look.window, window, PLACES);
    if places.len() < PLACES_MIN {
        return None;
    }
    let step = places.len() / (PIXELS / pixels.len()).clamp(PLACES_MIN, places.len());
    let view = solver.view(look, look.window);
    let columns = solver.compiled.last_parameters().len();
    view.spend((places.len() / step + columns) * pixels.len()).ok()?;
    let taken = slopes(solver, &own, fit, &pixels)?.qr().q();
    let dark = pixels.iter().map(|residual| residual.deviation).fold(f64::INFINITY, f64::min);
    let freedom = pixels.len().saturating_sub(columns).max(1) as f64;
    let width = own.window.width;
    let found = |[left, top]: [usize; 2]| {
        let value = |residual: &Residual| {
            let (x, y) = (own.window.x + residual.pixel % width, own.window.y + residual.pixel / width);
            let at = [left + x - window.x, top + y - window.y, 0, 0];
            mixture.at(view.planes.iter().map(|plane| plane.pixel_at(at))) / residual.deviation
        };
        let values = DVector::from_iterator(pixels.len(), pixels.iter().map(value));
        let rest = &values - &taken * taken.tr_mul(&values);
        let residual = |(residual, &whitened): (&Residual, &f64)| Residual { whitened, ..*residual };
        let residuals: Vec<Residual> = pixels.iter().zip(rest.iter()).map(residual).collect();
        let squares = residuals.iter().map(|one| one.whitened.powi(2)).sum::<f64>() / freedom;
        let seen = Seen { residuals, limit: f64::INFINITY };
        let structure = Structure::of(&[seen], [width, own.window.height], 2).filter(|_| squares.is_finite())?;
        let noise = squares * structure.independent;
        Some([structure.share(), squares - noise, noise])
    };
    let found: Vec<[f64; 3]> = places.into_iter().step_by(step).filter_map(found).collect();
    if found.len() < PLACES_MIN {
        return None;
    }
    let all = |which: usize| found.iter().map(|found| found[which]).collect::<Vec<_>>();
    // A few large bumps differ more from place to place than many small ones; other things may take up some of few places.
    let often = if found.len() < PLACES_OFTEN { 0.5 } else { OFTEN };
    let [share, hanging] = [0, 1].map(|which| quantile(&all(which), often));
    let noise = median(&all(2));
    // The noise of pixels without light, as the model says it.
    let stated = pixels.iter().map(|one| (dark / one.deviation).powi(2)).sum::<f64>() / pixels.len() as f64;
    let excess = FORGIVEN_STRUCTURE * hanging + FORGIVEN_NOISE * (noise - stated).max(0.0);
    Some(Uneven { share: FORGIVEN_STRUCTURE * share, excess })
}

/// The least window that holds some pixels of another one.
fn bounds(pixels: &[Residual], window: Window) -> Option<Window> {
    let at = |residual: &Residual| [residual.pixel % window.width, residual.pixel / window.width];
    let [left, top] = pixels.iter().map(at).reduce(|[a, b], [x, y]| [a.min(x), b.min(y)])?;
    let [right, bottom] = pixels.iter().map(at).reduce(|[a, b], [x, y]| [a.max(x), b.max(y)])?;
    let (width, height) = (right + 1 - left, bottom + 1 - top);
    Some(Window { x: window.x + left, y: window.y + top, width, height, ..window })
}

/// What the prediction of each pixel changes by, over its noise, with each of the parameters that the fit has freed.
fn slopes(solver: &Solver, view: &View, fit: &Fit, pixels: &[Residual]) -> Option<DMatrix<f64>> {
    let covariance = fit.worth.as_ref()?.covariance.as_ref()?;
    let predictions = solver.compiled.predictions()?;
    let mut slopes = DMatrix::<f64>::zeros(pixels.len(), solver.compiled.last_parameters().len());
    for (column, parameter) in solver.compiled.last_parameters().iter().enumerate() {
        for side in [1.0, -1.0] {
            let mut parameters = fit.parameters.clone();
            parameters[parameter.index()] += side * covariance[(column, column)].sqrt();
            let predicted = predictions.intensity(view, &parameters, &solver.constants, Over::Everything)?;
            for (row, pixel) in pixels.iter().enumerate() {
                slopes[(row, column)] += side * f64::from(predicted[pixel.pixel]) / pixel.deviation;
            }
        }
        let norm: f64 = slopes.column(column).norm();
        slopes.column_mut(column).unscale_mut(norm);
    }
    Some(slopes).filter(|slopes| slopes.iter().all(|slope| slope.is_finite()))
}
