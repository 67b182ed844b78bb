//! Alternative backgrounds: adds a polynomial of degree 1 to 3 to a model, for stray light, with a [`Prior`] from the rest
//! of the frame, and selects the best by its evidence.
//!
//! Only models that state their noise have them: without it no misfit is significant.

use std::sync::Arc;

use isophote_jit::Window;
use nalgebra::DMatrix;

use crate::estimate::{StageReport, Substitute};
use crate::sight::elsewhere::SAMPLES_MIN;
use crate::sight::view::View;
use crate::solve::fit::{Fit, fit_with_prior};
use crate::solve::outliers::range;
use crate::solve::passes::SQUARE_MAX;
use crate::solve::prior::Prior;
use crate::solve::residuals::{ObservedResiduals, Over, Predictions};
use crate::solve::stage_kernels::{CompileFailure, FitStarts, StageKernels};
use crate::solve::structure::Structure;
use crate::solve::workers::InTurn;

/// A budget: above this χ²/ν alternative fits are tried.
pub(crate) const MISFIT: f64 = 1.35;
/// A budget: radius of the fitted pixels in target outlines; farther pixels say little about the target, and a polynomial
/// fits them ever worse.
const REACH: f64 = 1.5;
/// A budget: degrees of the polynomial.
const DEGREES: [u32; 3] = [1, 2, 3];

/// A model with an added polynomial background, compiled.
pub(crate) struct PolynomialBackground {
    degree: u32,
    pub compiled: Arc<StageKernels>,
    predictions: Predictions,
    /// Powers of the polynomial's terms.
    terms: Vec<[u32; 2]>,
    /// Number of parameters of the original model, and how many of them are free.
    own: [usize; 2],
}

/// All alternative backgrounds of a model.
#[derive(Default)]
pub(crate) struct Backgrounds(Vec<PolynomialBackground>);

/// Which residuals a background may leave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum AllowedResiduals {
    /// Uncorrelated residuals only.
    Noise,
    /// Any, as long as the cost falls.
    Anything,
}

impl Backgrounds {
    /// Derives the backgrounds; kernels are compiled on demand. Empty for a model without noise, not of two
    /// coordinates, or of a pose; skips a degree that fails to derive, as when it exceeds the limits of a model. `None`
    /// when `should_continue`, asked before each degree, returns false.
    pub fn new(compiled: &StageKernels, should_continue: &dyn Fn() -> bool) -> Option<Backgrounds> {
        let (model, precision, cache) = (compiled.model(), compiled.precision(), compiled.cache());
        let own = [model.parameters().len(), compiled.last_parameters().len()];
        let is_pose = model.roles().iter().any(|roles| !roles.position.is_empty());
        let mut backgrounds = Vec::new();
        for degree in DEGREES.into_iter().filter(|_| model.has_noise() && model.coordinates().len() == 2 && !is_pose) {
            if !should_continue() {
                return None;
            }
            let (model, terms) = model.with_background(degree, REACH);
            let compiled = StageKernels::new(Arc::new(model), precision, cache.clone(), &InTurn, FitStarts::Anywhere);
            let Ok(compiled) = compiled.map(Arc::new) else { continue };
            let predictions = Predictions::new(compiled.model(), precision, cache).ok().flatten();
            backgrounds.extend(predictions.map(|predictions| PolynomialBackground {
                degree,
                compiled,
                predictions,
                terms,
                own,
            }));
        }
        Some(Backgrounds(backgrounds))
    }

    pub fn iter(&self) -> impl Iterator<Item = &PolynomialBackground> {
        self.0.iter()
    }

    /// The fit from `start` with the background of most evidence; `None` where none has more than `plain`, or where each
    /// leaves correlated residuals and `rest` forbids them. Masks no outliers: this is for light that raises no single pixel
    /// above its noise. `elsewhere`: places of the frame, of the size of the view's window.
    pub fn best(
        &self,
        (view, elsewhere): (&View, &[View]),
        (constants, predictions): (&[f64], &Predictions),
        plain: &Fit,
        start: &[f64],
        rest: AllowedResiduals,
        admit: &dyn Fn(&Fit) -> bool,
    ) -> Result<Option<Fit>, CompileFailure> {
        // All are compared over the same pixels.
        let Some(region) = predictions.residuals(view, &plain.parameters, constants, Over::Domain) else {
            return Ok(None);
        };
        let mut is_inside = vec![false; view.window.pixels()];
        region.iter().flat_map(|seen| &seen.residuals).for_each(|residual| is_inside[residual.pixel] = true);
        let samples: Option<Vec<_>> = elsewhere.iter().map(|window| predictions.observed(window, constants)).collect();
        let Some(samples) = samples else { return Ok(None) };
        let mut limit = cost(&region, &is_inside);
        let mut best = None;
        for background in self.iter() {
            let constants = background.constants(constants, view);
            let start = background.start(start);
            let Some(prior) = background.prior(view, &region, &samples) else { continue };
            let fitted = fit_with_prior(&background.compiled, view, &constants, &start, &prior)?;
            let covariance =
                fitted.summary.as_ref().filter(|_| fitted.is_usable()).and_then(|it| it.covariance.as_ref());
            let penalty = covariance.and_then(|covariance| prior.penalty(&fitted.parameters, covariance));
            let Some(penalty) = penalty else { continue };
            let seen = |over| background.predictions.residuals(view, &fitted.parameters, &constants, over);
            let (Some(all), Some(own)) = (seen(Over::Everything), seen(Over::Domain)) else { continue };
            let cost = cost(&all, &is_inside) + penalty;
            let size = [view.window.width, view.window.height];
            let is_correlated = || Structure::of(&own, size, 2).is_none_or(|structure| structure.is_significant());
            if cost >= limit || (rest == AllowedResiduals::Noise && is_correlated()) {
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

/// Origin and unit length of the polynomial: the window's centre and half its larger side, px.
fn unit(view: &View) -> [f64; 3] {
    let Window { x, y, width, height, .. } = view.window;
    let middle = |first: usize, count: usize| first as f64 + 0.5 * (count as f64 - 1.0);
    [middle(x, width), middle(y, height), 0.5 * width.max(height) as f64]
}

/// −2 ln of the likelihood of the pixels of a region, each deviation at most four standard deviations.
fn cost(seen: &[ObservedResiduals], is_inside: &[bool]) -> f64 {
    let residuals = seen.iter().flat_map(|seen| &seen.residuals).filter(|residual| is_inside[residual.pixel]);
    residuals.map(|residual| residual.whitened.powi(2).min(SQUARE_MAX)).sum()
}

impl PolynomialBackground {
    /// The prior of the coefficients over the pixels of `region`, from `samples` of the pixel values elsewhere in the
    /// frame, by observed value. In a frame with too few of these each mode may be as large as pixel values allow.
    fn prior(&self, view: &View, region: &[ObservedResiduals], samples: &[Vec<Vec<f64>>]) -> Option<Prior> {
        let given = self.powers().filter(|powers| !self.terms.contains(powers)).collect();
        let powers: Vec<[u32; 2]> = [given, self.terms.clone()].concat();
        let given = powers.len() - self.terms.len();
        let (width, [left, top, length]) = (view.window.width, unit(view));
        let entry = |(number, seen): (usize, &ObservedResiduals)| {
            let pixels: Vec<usize> = seen.residuals.iter().map(|residual| residual.pixel).collect();
            let terms = DMatrix::from_fn(pixels.len(), powers.len(), |row, term| {
                let at = [view.window.x + pixels[row] % width, view.window.y + pixels[row] / width];
                let [x, y] = [(at[0] as f64 - left) / length, (at[1] as f64 - top) / length];
                x.powi(powers[term][0] as i32) * y.powi(powers[term][1] as i32)
            });
            let noise = seen.residuals.iter().map(|residual| residual.deviation.powi(2)).sum::<f64>();
            let noise = noise / pixels.len() as f64;
            if samples.len() < SAMPLES_MIN {
                let largest = range(seen).powi(2) * pixels.len() as f64;
                return Prior::new(&terms, given, &DMatrix::zeros(pixels.len(), 1), largest);
            }
            let mut elsewhere = DMatrix::from_fn(pixels.len(), samples.len(), |row, sample| {
                let value = samples[sample][number][pixels[row]];
                if value > seen.limit { seen.limit } else { value } // NaN stays
            });
            for mut sample in elsewhere.column_iter_mut() {
                let known = || sample.iter().filter(|value| value.is_finite());
                let mean = known().sum::<f64>() / known().count().max(1) as f64;
                sample.iter_mut().filter(|value| !value.is_finite()).for_each(|value| *value = mean);
            }
            Prior::new(&terms, given, &elsewhere, noise)
        };
        Some(Prior::joined(&region.iter().enumerate().map(entry).collect::<Option<Vec<Prior>>>()?))
    }

    /// Those of all terms up to the degree.
    fn powers(&self) -> impl Iterator<Item = [u32; 2]> {
        (0..=self.degree).flat_map(|total| (0..=total).map(move |y| [total - y, y]))
    }

    /// The model's constants, then the polynomial's.
    fn constants(&self, constants: &[f64], view: &View) -> Vec<f64> {
        constants.iter().copied().chain(unit(view)).collect()
    }

    /// The model's parameters, then zero coefficients.
    fn start(&self, parameters: &[f64]) -> Vec<f64> {
        let mut start = parameters.to_vec();
        start.resize(self.compiled.model().parameters().len(), 0.0);
        start
    }

    /// Drops the coefficients from a fit.
    fn shortened(&self, mut fit: Fit) -> Fit {
        let [parameters, free] = self.own;
        fit.parameters.truncate(parameters);
        if let Some(summary) = &mut fit.summary {
            summary.covariance = summary.covariance.take().map(|matrix| matrix.view((0, 0), (free, free)).into_owned());
            summary.variance_alone = summary.variance_alone.rows(0, free).into_owned();
        }
        fit
    }
}

/// The document's stage reports, with the last replaced by that of the alternative fit.
pub(crate) fn reports(stages: &[StageReport], alternative: &Fit) -> Vec<StageReport> {
    let mut reports = stages.to_vec();
    if let (Some(last), Some(report)) = (reports.last_mut(), alternative.stages.last()) {
        last.clone_from(report);
    }
    reports
}
