//! Backgrounds beside that of a document: a polynomial of degree 1 to 3 is added, for light that is not the target's.
//!
//! What comes in: a picture on which a fit left something unexplained. What goes out: the fit on the background that explains most,
//! its coefficients paid for by the Bayesian information criterion. It never knows earlier frames.
//!
//! Only models that state their noise have them: without it nothing says how much is too much.

use std::sync::Arc;

use crate::estimate::{StageReport, Substitute};
use crate::sight::view::View;
use crate::solve::fit::{Fit, fit};
use crate::solve::passes::SQUARE_MAX;
use crate::solve::residuals::{Over, Predictions, Seen};
use crate::solve::stage_kernels::{Begins, CompileFailure, Control, StageKernels};
use crate::solve::structure::Structure;
use crate::solve::workers::InTurn;

/// A budget: χ²/ν from which on a fit is worth another one.
pub(crate) const MISFIT: f64 = 1.35;
/// Derived: a background has to lower χ² by so much more than its coefficients cost; noise does that once in e¹⁰ = 22,000 times.
const DECISIVE: f64 = 20.0;
/// A budget: pixels farther from a target than so many outlines say little about it, and a polynomial fits them ever worse.
const REACH: f64 = 1.5;
/// A budget: degrees of the polynomial.
const DEGREES: [u32; 3] = [1, 2, 3];

/// A model on another background, compiled.
pub(crate) struct PolynomialBackground {
    degree: u32,
    pub compiled: Arc<StageKernels>,
    predictions: Predictions,
    /// Parameters of the model itself, and those of them that are free.
    own: [usize; 2],
}

/// All backgrounds of a model.
#[derive(Default)]
pub(crate) struct Backgrounds(Vec<PolynomialBackground>);

/// How much a background may leave unexplained.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Rest {
    /// Nothing that hangs together.
    Noise,
    /// Less than there was.
    Anything,
}

impl Backgrounds {
    /// Derives them; kernels follow when they are needed. Empty for a model without noise, not of two coordinates, or of a pose; one
    /// that cannot be made, which may be more than a model may have, is one fewer. `None` when `keeps_going`, asked before each
    /// of them, says no.
    pub fn new(compiled: &StageKernels, keeps_going: &dyn Fn() -> bool) -> Option<Backgrounds> {
        let (model, precision, cache) = (compiled.model(), compiled.precision(), compiled.cache());
        let own = [model.parameters().len(), compiled.last_parameters().len()];
        let is_pose = model.roles().iter().any(|roles| !roles.position.is_empty());
        let mut backgrounds = Vec::new();
        for degree in DEGREES.into_iter().filter(|_| model.has_noise() && model.coordinates().len() == 2 && !is_pose) {
            if !keeps_going() {
                return None;
            }
            let model = Arc::new(model.with_background(degree, REACH));
            let compiled = StageKernels::new(model, precision, cache.clone(), &InTurn, Begins::Anywhere);
            let Ok(compiled) = compiled.map(Arc::new) else { continue };
            let predictions = Predictions::new(compiled.model(), precision, cache).ok().flatten();
            backgrounds.extend(predictions.map(|predictions| PolynomialBackground {
                degree,
                compiled,
                predictions,
                own,
            }));
        }
        Some(Backgrounds(backgrounds))
    }

    pub fn iter(&self) -> impl Iterator<Item = &PolynomialBackground> {
        self.0.iter()
    }

    /// The fit from `start` on the background with which most is explained; `None` where none explains decisively more than `plain`
    /// does, or each leaves something that hangs together, unless `rest` may be that. Nothing is left out: this is for light that
    /// raises no single pixel above its noise.
    pub fn best(
        &self,
        view: &View,
        (constants, predictions): (&[f64], &Predictions),
        plain: &Fit,
        start: &[f64],
        rest: Rest,
        admit: &dyn Fn(&Fit) -> bool,
    ) -> Result<Option<Fit>, CompileFailure> {
        // All are compared over the same pixels.
        let Some(region) = predictions.residuals(view, &plain.parameters, constants, Over::Domain) else {
            return Ok(None);
        };
        let mut is_inside = vec![false; view.window.pixels()];
        region.iter().flat_map(|seen| &seen.residuals).for_each(|residual| is_inside[residual.pixel] = true);
        let free = plain.worth.as_ref().map_or(0, |worth| worth.variance_alone.len());
        let pixels: usize = region.iter().map(|seen| seen.residuals.len()).sum();
        if pixels == 0 {
            return Ok(None);
        }
        let mut limit = cost(&region, &is_inside, free) - DECISIVE / pixels as f64;
        let mut best = None;
        for background in self.iter() {
            let constants = background.constants(constants, view);
            let start = background.start(start);
            let fitted = fit(&background.compiled, view, &constants, &start, Control::Dropping)?;
            if !fitted.is_usable() || fitted.worth.as_ref().is_none_or(|worth| worth.covariance.is_none()) {
                continue;
            }
            let seen = |over| background.predictions.residuals(view, &fitted.parameters, &constants, over);
            let (Some(all), Some(own)) = (seen(Over::Everything), seen(Over::Domain)) else { continue };
            let cost = cost(&all, &is_inside, background.compiled.last_parameters().len());
            let size = [view.window.width, view.window.height];
            let hangs = || Structure::of(&own, size, 2).is_none_or(|structure| structure.is_told());
            if cost >= limit || (rest == Rest::Noise && hangs()) {
                continue;
            }
            let choice = Some(Substitute { degree: background.degree, robust: false, hidden: 0.0 });
            let fitted = Fit { choice, ..background.shortened(fitted) };
            if admit(&fitted) {
                (limit, best) = (cost, Some(fitted));
            }
        }
        Ok(best)
    }
}

/// The cost of a pixel of a region, and of the parameters: `mean min(z², 16) + k ln n / n`.
fn cost(seen: &[Seen], is_inside: &[bool], parameters: usize) -> f64 {
    let residuals = seen.iter().flat_map(|seen| &seen.residuals).filter(|residual| is_inside[residual.pixel]);
    let costs = residuals.map(|residual| residual.whitened.powi(2).min(SQUARE_MAX));
    let (sum, n) = costs.fold((0.0, 0.0), |(sum, n), cost| (sum + cost, n + 1.0));
    (sum + parameters as f64 * f64::ln(n)) / n
}

impl PolynomialBackground {
    /// The model's constants and those of the polynomial, which is about the window's middle, in units of half its size.
    fn constants(&self, constants: &[f64], view: &View) -> Vec<f64> {
        let (first, size) = (view.window.first(), view.window.size());
        let middle = (0..2).map(|axis| first[axis] as f64 + 0.5 * (size[axis] as f64 - 1.0));
        let length = 0.5 * size[0].max(size[1]) as f64;
        constants.iter().copied().chain(middle).chain([length]).collect()
    }

    /// Parameters of the model itself, and coefficients of 0.
    fn start(&self, parameters: &[f64]) -> Vec<f64> {
        let mut start = parameters.to_vec();
        start.resize(self.compiled.model().parameters().len(), 0.0);
        start
    }

    /// A fit without the coefficients.
    fn shortened(&self, mut fit: Fit) -> Fit {
        let [parameters, free] = self.own;
        fit.parameters.truncate(parameters);
        if let Some(worth) = &mut fit.worth {
            worth.covariance = worth.covariance.take().map(|matrix| matrix.view((0, 0), (free, free)).into_owned());
            worth.variance_alone = worth.variance_alone.rows(0, free).into_owned();
        }
        fit
    }
}

/// Reports of the stages that a document has, the last one's that of the fit that takes its place.
pub(crate) fn reports(stages: &[StageReport], alternative: &Fit) -> Vec<StageReport> {
    let mut reports = stages.to_vec();
    if let (Some(last), Some(report)) = (reports.last_mut(), alternative.stages.last()) {
        last.clone_from(report);
    }
    reports
}
