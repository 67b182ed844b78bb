//! Alternatives: what is tried when a model does not describe a picture: blind pixels left out, a slope or a curve in the
//! background, outliers that do not count.
//!
//! What comes in: a picture on which the plain fit left too much unexplained, and starting values. What goes out: the
//! fit that explains most of the target's domain, each pixel that it does not explain counting a fixed cost (a robust
//! information criterion). It never knows earlier frames.
//!
//! Only models that say how noisy a pixel is (`noise`) have alternatives: without it nothing says what is too much.

mod blind;
mod residuals;

use std::sync::Arc;

use isophote_jit::KernelCache;
use isophote_symbolic::{Loss, Model, Saturated, Variant};

use self::blind::{Mask, Painted};
use self::residuals::{Predictions, Seen};
use crate::compiled::{CompileFailure, Compiled, Control};
use crate::estimate::StageReport;
use crate::fit::{Fit, View, fit};
use crate::workers::InTurn;

/// χ²/ν beyond which a plain fit is not taken as it is.
pub(crate) const MISFIT: f64 = 1.35;
/// What a pixel that is not explained, or not looked at, costs; an explained one costs its squared residual.
const COST: f64 = 16.0;
/// Outliers are farther away than this many standard deviations.
const OUTLIER: f64 = 5.0;
/// Rounds of finding what is blind and fitting the rest.
const ROUNDS: usize = 2;
/// Fewer pixels than this are no target.
const PIXELS_MIN: usize = 40;

/// What differs from the model, for people: the polynomial's degree and how residuals count.
const VARIANTS: [(&str, Option<Variant>); 4] = {
    const TUKEY: Loss = Loss::Tukey(OUTLIER);
    const DROPPED: Saturated = Saturated::Dropped;
    [
        ("blind", None),
        ("plane, robust", Some(Variant { degree: 1, loss: TUKEY, saturated: DROPPED })),
        ("quadratic, robust", Some(Variant { degree: 2, loss: TUKEY, saturated: DROPPED })),
        ("quadratic", Some(Variant { degree: 2, loss: Loss::Squares, saturated: Saturated::Censored })),
    ]
};

/// One alternative.
struct Alternative {
    name: &'static str,
    compiled: Arc<Compiled>,
    predictions: Predictions,
}

/// All alternatives of a model.
pub(crate) struct Alternatives {
    list: Vec<Alternative>,
}

/// A fit that was chosen over the plain one.
#[derive(Clone, Debug)]
pub(crate) struct Chosen {
    pub fit: Fit,
    pub name: &'static str,
    /// Share of the domain that was left out as blind.
    pub blind: f64,
}

/// A fit and what it costs.
struct Candidate {
    number: usize,
    fit: Fit,
    cost: f64,
    blind: f64,
}

impl Alternatives {
    /// Derives them; kernels follow when they are needed. None for a model without noise or of more than two coordinates.
    pub fn new(compiled: &Compiled, cache: &Arc<KernelCache>) -> Result<Alternatives, CompileFailure> {
        let model = compiled.model();
        let mut list = Vec::new();
        if !model.has_noise() || model.coordinates().len() != 2 {
            return Ok(Alternatives { list });
        }
        let precision = compiled.precision();
        for (name, variant) in VARIANTS {
            let compiled = match variant {
                None => Arc::new(compiled.share()),
                Some(variant) => {
                    let model = Arc::new(model.variant(variant));
                    Arc::new(Compiled::with_cache(model, precision, cache.clone(), &InTurn)?)
                }
            };
            if let Some(predictions) = Predictions::new(compiled.model(), precision, cache)? {
                list.push(Alternative { name, compiled, predictions });
            }
        }
        Ok(Alternatives { list })
    }

    /// The best of all alternatives from all starts and of the `plain` fit; `None` when that is the plain one.
    pub fn best(
        &self,
        view: &View,
        constants: &[f64],
        starts: &[Vec<f64>],
        plain: Option<&Fit>,
    ) -> Result<Option<Chosen>, CompileFailure> {
        let Some(base) = self.list.first() else { return Ok(None) };
        let count = base.compiled.model().parameters().len();
        let mut limit = f64::INFINITY;
        if let Some(plain) = plain.filter(|fit| fit.worth.is_some()) {
            let seen = base.predictions.residuals(view, &plain.parameters, constants);
            limit = seen.and_then(|seen| cost(&seen, None, base.free())).map_or(limit, |(cost, _)| cost);
        }
        let mut best: Option<Candidate> = None;
        for start in starts {
            for number in 0..self.list.len() {
                let Some(candidate) = self.list[number].run(number, view, constants, start)? else { continue };
                if candidate.cost < best.as_ref().map_or(limit, |best| best.cost) {
                    best = Some(candidate);
                }
            }
        }
        Ok(best.map(|Candidate { number, fit, blind, .. }| {
            let name = self.list[number].name;
            Chosen { fit: fit.shortened(count, base.compiled.last_parameters().len()), name, blind }
        }))
    }
}

impl Alternative {
    /// How many parameters are free.
    fn free(&self) -> usize {
        self.compiled.last_parameters().len()
    }

    /// Fits from a start of the model's own parameters; `None` when that is no fit.
    fn run(
        &self,
        number: usize,
        view: &View,
        constants: &[f64],
        start: &[f64],
    ) -> Result<Option<Candidate>, CompileFailure> {
        let constants = constants_for(self.compiled.model(), constants, view);
        let mut parameters = start.to_vec();
        parameters.resize(self.compiled.model().parameters().len(), 0.0);
        let mut last: Option<Fit> = None;
        let mut mask = None;
        for round in 0..ROUNDS {
            let Some(seen) = self.predictions.residuals(view, &parameters, &constants) else { return Ok(None) };
            let found = Mask::of(view, &seen, round == 0);
            // Without anything blind a second round would be the first one over again, and the model itself was fitted.
            if found.is_none() && mask.is_none() && (round > 0 || number == 0) {
                break;
            }
            let precision = self.compiled.precision();
            let painted = found.as_ref().map(|mask| Painted::new(view, mask));
            let blinded = painted.as_ref().and_then(|painted| painted.view(view, precision));
            let (view, control) = match &blinded {
                Some(blinded) => (blinded, Control::Blind),
                None => (view, Control::Dropping),
            };
            let fitted = fit(&self.compiled, view, &constants, &parameters, control)?;
            if fitted.worth.as_ref().is_none_or(|worth| worth.covariance.is_none() || worth.pixels < PIXELS_MIN as u64) {
                return Ok(None);
            }
            parameters.clone_from(&fitted.parameters);
            last = Some(fitted);
            mask = found;
        }
        let Some(fit) = last else { return Ok(None) };
        let Some(seen) = self.predictions.residuals(view, &fit.parameters, &constants) else { return Ok(None) };
        let Some((cost, blind)) = cost(&seen, mask.as_ref(), self.free()) else { return Ok(None) };
        Ok(Some(Candidate { number, fit, cost, blind }))
    }
}

/// The cost of a pixel of the domain, and of the parameters: `mean min(z², 16) + k ln n / n`, blind pixels counting 16; and
/// the share of the domain that is blind. `None` when the domain has hardly a pixel.
fn cost(seen: &[Seen], mask: Option<&Mask>, free: usize) -> Option<(f64, f64)> {
    let (mut sum, mut count, mut blind) = (0.0, 0_usize, 0_usize);
    for residual in seen.iter().flat_map(|seen| &seen.residuals) {
        let masked = mask.is_some_and(|mask| mask.blind[residual.pixel]);
        blind += usize::from(masked);
        sum += if masked { COST } else { (residual.whitened * residual.whitened).min(COST) };
        count += 1;
    }
    let n = count as f64;
    (count >= PIXELS_MIN).then(|| ((sum + free as f64 * n.ln()) / n, blind as f64 / n))
}

/// The model's constants and those of the background: the polynomial is about the window's middle, in units of half its
/// size.
fn constants_for(model: &Model, constants: &[f64], view: &View) -> Vec<f64> {
    let mut all = constants.to_vec();
    if model.constants().len() > constants.len() {
        let (first, size) = (view.window.first(), view.window.size());
        all.extend((0..2).map(|axis| first[axis] as f64 + 0.5 * (size[axis] as f64 - 1.0)));
        all.push(0.5 * size[0].max(size[1]) as f64);
    }
    all
}

impl Fit {
    /// Without the parameters that an alternative has beside the model's own.
    fn shortened(mut self, parameters: usize, free: usize) -> Fit {
        self.parameters.truncate(parameters);
        if let Some(worth) = &mut self.worth {
            worth.covariance = worth.covariance.take().map(|matrix| matrix.view((0, 0), (free, free)).into_owned());
            worth.variance_alone = worth.variance_alone.rows(0, free).into_owned();
        }
        self
    }
}

/// Starts beside one that is not sure of where the target is: shifted by shares of the target's half widths and rounder.
/// Only for targets whose centre and outline are parameters.
pub(crate) fn scattered(model: &Model, start: &[f64]) -> Vec<Vec<f64>> {
    const SHIFTS: [[f64; 2]; 8] =
        [[0.3, 0.0], [-0.3, 0.0], [0.0, 0.3], [0.0, -0.3], [0.25, 0.25], [-0.25, 0.25], [0.25, -0.25], [-0.25, -0.25]];
    let mut starts = vec![start.to_vec()];
    let [roles] = model.roles() else { return starts };
    let (&[x, y], &[a1, a2, a3]) = (roles.centre.as_slice(), roles.shape.as_slice()) else { return starts };
    let at = |parameter: isophote_symbolic::ParameterId| start[parameter.index()];
    let half = [at(a1), at(a3)].map(|a| 1.0 / a.sqrt());
    for [dx, dy] in SHIFTS {
        let round = 0.5 * (at(a1) + at(a3)) * 0.7;
        for shape in [[0.8 * at(a1), 0.8 * at(a2), 0.8 * at(a3)], [round, 0.0, round]] {
            let mut moved = start.to_vec();
            moved[x.index()] += dx * half[0];
            moved[y.index()] += dy * half[1];
            for (parameter, value) in [a1, a2, a3].into_iter().zip(shape) {
                moved[parameter.index()] = value;
            }
            starts.push(moved);
        }
    }
    starts
}

/// Reports of the stages that a document has, the last one's that of the alternative.
pub(crate) fn reports(stages: &[StageReport], alternative: &Fit) -> Vec<StageReport> {
    let mut reports = stages.to_vec();
    if let (Some(last), Some(report)) = (reports.last_mut(), alternative.stages.last()) {
        last.clone_from(report);
    }
    reports
}
