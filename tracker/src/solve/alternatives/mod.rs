//! Alternatives: what is tried when a model does not describe a picture: what is blind or hidden left out, a slope or a
//! curve in the background, outliers that do not count.
//!
//! What comes in: a picture on which the plain fit left too much unexplained, and starting values. What goes out: the
//! fit that explains most of the target's domain, each pixel that it does not explain counting a fixed cost (a robust
//! information criterion). It never knows earlier frames.
//!
//! Only models that say how noisy a pixel is (`noise`) have alternatives: without it nothing says what is too much.

mod blind;
mod covered;
mod raised;
#[cfg(test)]
mod tests;
mod veil;

use std::sync::Arc;

use isophote_jit::KernelCache;
use isophote_symbolic::{Loss, Model, Saturated, Variant};

use self::blind::{BlindMask, Known, Painted};
pub(crate) use self::covered::{Cover, Covered};
pub(crate) use self::veil::{SpotNames, Veil};
use crate::estimate::{StageReport, Substitute};
use crate::sight::view::View;
use crate::solve::fit::{Fit, fit};
use crate::solve::passes::Worth;
use crate::solve::residuals::{Over, Predictions};
use crate::solve::stage_kernels::{Begins, CompileFailure, Control, StageKernels};
use crate::solve::structure::Structure;
use crate::solve::workers::InTurn;

/// χ²/ν beyond which a plain fit is not taken as it is.
pub(crate) const MISFIT: f64 = 1.35;
/// What a pixel that is not explained costs at most; an explained one costs its squared residual.
const COST: f64 = 16.0;
/// Outliers are farther away than this many standard deviations.
pub(crate) const OUTLIER: f64 = 5.0;
/// Rounds of finding what is hidden and fitting the rest.
const ROUNDS: usize = 2;
/// What nothing but a sum over many pixels shows must explain so much more than the model does, in units of χ².
const DECISIVE: f64 = 20.0;
/// What leaves outliers out must cost so much less.
const ROBUST: f64 = 1.03;
/// Fewer pixels than this are no target.
const PIXELS_MIN: usize = 40;
/// So many of several starts are followed up.
const STARTS: usize = 2;
/// Nothing farther from a target than this many outlines is looked at.
const REACH: f64 = 1.5;
/// How many times their deviation residuals are taken to have, round by round, when outliers are looked for: as it is, and
/// more at first, for starts that are some way off.
const SCALES: [&[f64]; 2] = [&[1.0], &[3.0, 1.0]];
/// Degrees of the polynomial that is added to the background.
const DEGREES: [u32; 3] = [1, 2, 3];

/// A model and its predictions, compiled.
struct Variation {
    compiled: Arc<StageKernels>,
    predictions: Predictions,
}

/// A background, with which residuals count by their squares, or not at all when they are outliers.
struct Ground {
    degree: u32,
    plain: Variation,
    robust: Variation,
}

/// All alternatives of a model.
#[derive(Default)]
pub(crate) struct Alternatives {
    /// The model itself; absent when it has no alternatives.
    own: Option<Variation>,
    grounds: Vec<Ground>,
}

/// What a fit does with outliers that hang together: something in front of the target.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Outliers {
    /// Nothing but light is in the way: they are kept, and a background that is tied to the document's own formula will do.
    Absent,
    /// They are looked at as everything else.
    Kept,
    /// They are left out from the first round on.
    LeftOut,
}

/// What a background may leave unexplained.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Rest {
    /// Nothing that hangs together.
    Noise,
    /// Less than there was.
    Anything,
}

/// A fit, and what it left out.
struct Explained {
    fit: Fit,
    choice: Substitute,
}

impl Alternatives {
    /// Derives them; kernels follow when they are needed. Empty for a model without noise or not of two coordinates; one that
    /// cannot be made, which may be more than a model may have, is one fewer. `None` when `keeps_going`, asked before each of
    /// them, says no.
    pub fn new(
        compiled: &StageKernels,
        cache: &Arc<KernelCache>,
        keeps_going: &dyn Fn() -> bool,
    ) -> Option<Alternatives> {
        let model = compiled.model();
        let mut alternatives = Alternatives { own: None, grounds: Vec::new() };
        if !model.has_noise() || model.coordinates().len() != 2 {
            return Some(alternatives);
        }
        let precision = compiled.precision();
        let variant = |variant| -> Option<Variation> {
            let model = Arc::new(model.variant(variant));
            let compiled =
                Arc::new(StageKernels::new(model, precision, cache.clone(), &InTurn, Begins::Anywhere).ok()?);
            let predictions = Predictions::new(compiled.model(), precision, cache).ok()??;
            Some(Variation { compiled, predictions })
        };
        let plain = Variant { degree: 0, loss: Loss::Squares, saturated: Saturated::Censored, reach: REACH };
        let robust = Variant { loss: Loss::Tukey(OUTLIER), saturated: Saturated::Dropped, ..plain };
        if !keeps_going() {
            return None;
        }
        // A pose is fitted by the model itself, to what is not hidden.
        if model.roles().iter().any(|roles| !roles.position.is_empty()) {
            let predictions = Predictions::new(model, precision, cache).ok().flatten();
            let compiled = Arc::new(compiled.share());
            alternatives.own = predictions.map(|predictions| Variation { compiled, predictions });
            return Some(alternatives);
        }
        alternatives.own = variant(plain);
        for degree in DEGREES {
            if !keeps_going() {
                return None;
            }
            let (plain, robust) = (variant(Variant { degree, ..plain }), variant(Variant { degree, ..robust }));
            alternatives.grounds.extend(plain.zip(robust).map(|(plain, robust)| Ground { degree, plain, robust }));
        }
        Some(alternatives)
    }

    /// The kernels of each.
    pub fn compiled(&self) -> impl Iterator<Item = &StageKernels> {
        let grounds = self.grounds.iter().flat_map(|ground| [&ground.plain, &ground.robust]);
        self.own.iter().chain(grounds).map(|variation| &*variation.compiled)
    }

    /// The best of all alternatives from all starts that `admit` lets through; `None` when the `plain` fit is as good.
    pub fn best(
        &self,
        view: &View,
        constants: &[f64],
        starts: &[Vec<f64>],
        plain: Option<&Fit>,
        admit: &dyn Fn(&Fit) -> bool,
    ) -> Result<Option<Fit>, CompileFailure> {
        let Some(own) = &self.own else { return Ok(None) };
        let Some(first) = self.grounds.first() else { return Ok(None) };
        let mut starts = starts.to_vec();
        // All are compared over the same pixels, where it is known which these are: no background is to be praised for what
        // it makes of glare.
        let region = if let [start] = &starts[..] { own.sighted(view, constants, start) } else { None };
        let cost = |fitted: &Variation, fit: &Fit| fitted.cost(view, constants, &fit.parameters, region.as_deref());
        let mut limit = f64::INFINITY;
        if let Some(plain) = plain.filter(|fit| fit.worth.is_some()) {
            limit = cost(own, plain).unwrap_or(limit);
            let all = constants_for(own.compiled.model(), constants, view, 1.0);
            let seen = own.predictions.residuals(view, &plain.parameters, &all, Over::Domain);
            if seen.is_some_and(|seen| BlindMask::of(view, &seen, Known::Well, Some(OUTLIER)).is_none()) {
                return Ok(None); // nothing but a target that is a little blurred or moved
            }
        }
        let mut found: Vec<(f64, Explained)> = Vec::new();
        let is_fine = |candidate: &Explained| {
            let reduced = candidate.fit.worth.as_ref().and_then(|worth| worth.reduced);
            reduced.is_some_and(|reduced| reduced <= MISFIT)
        };
        let add = |found: &mut Vec<(f64, Explained)>, fitted: &Variation, candidate: Option<Explained>| {
            let admitted = candidate.filter(|candidate| admit(&candidate.fit));
            found.extend(admitted.and_then(|candidate| Some((cost(fitted, &candidate.fit)?, candidate))));
        };
        let choice = Substitute { degree: 0, robust: false, hidden: 0.0 };
        let on_grounds = |found: &mut Vec<(f64, Explained)>, start: &[f64]| -> Result<(), CompileFailure> {
            add(found, own, own.run(view, constants, start, choice, &[1.0], Outliers::Kept)?);
            for ground in &self.grounds {
                let choice = Substitute { degree: ground.degree, ..choice };
                let fitted = ground.plain.run(view, constants, start, choice, &[1.0], Outliers::Kept)?;
                add(found, &ground.plain, fitted);
            }
            Ok(())
        };
        on_grounds(&mut found, &starts[0])?;
        // Of what is blind in part the rest does not say where the target is.
        if starts.len() > 1 && own.blind(view, constants, &starts[0]).is_some() {
            starts = first.robust.likely(view, constants, starts)?;
            starts[1..].iter().try_for_each(|start| on_grounds(&mut found, start))?;
        } else {
            starts.truncate(1);
        }
        // Something stands in front of the target: the simplest background with which all that is seen is explained. Beside
        // glare the simplest is tried even so: what is left of it is an outlier.
        let is_blinded = found.iter().any(|(_, candidate)| candidate.choice.hidden > 0.0);
        for (number, ground) in self.grounds.iter().enumerate() {
            if found.iter().any(|(_, candidate)| is_fine(candidate)) && (number > 0 || !is_blinded) {
                break;
            }
            let choice = Substitute { degree: ground.degree, robust: true, ..choice };
            for (start, scales) in starts.iter().flat_map(|start| SCALES.map(|scales| (start, scales))) {
                let robust = ground.robust.run(view, constants, start, choice, scales, Outliers::Kept)?;
                let Some(robust) = robust else { continue };
                // What is hidden is known now, and the rest counts in full.
                let parameters = &robust.fit.parameters;
                let refined = ground.plain.run(view, constants, parameters, choice, &[1.0], Outliers::LeftOut)?;
                add(&mut found, &ground.plain, refined);
                add(&mut found, &ground.robust, Some(robust));
            }
        }
        // Of those that explain all that they look at, else of all, the one that explains most.
        let best = found.into_iter().filter(|(cost, _)| *cost < limit);
        let counted =
            |(cost, candidate): &(f64, Explained)| if candidate.choice.robust { ROBUST * cost } else { *cost };
        let rank = |a: &(f64, Explained), b: &(f64, Explained)| {
            (!is_fine(&a.1)).cmp(&!is_fine(&b.1)).then(counted(a).total_cmp(&counted(b)))
        };
        let best = best.min_by(rank);
        Ok(best.map(|(_, explained)| own.substituted(explained)))
    }
}

impl Alternatives {
    /// Parameters of fits with the simplest background in which outliers do not count: from a start as it is, and from one that
    /// may be some way off.
    pub fn robustly(&self, view: &View, constants: &[f64], start: &[f64]) -> impl Iterator<Item = Vec<f64>> {
        let (ground, count) = (self.grounds.first(), start.len());
        let choice = Substitute { degree: 0, robust: true, hidden: 0.0 };
        SCALES.into_iter().filter_map(move |scales| {
            let found = ground?.robust.run(view, constants, start, choice, scales, Outliers::Kept).ok()??;
            let mut parameters = found.fit.parameters;
            parameters.truncate(count);
            Some(parameters)
        })
    }

    /// The background besides the model's own with which most is explained, its own parameters paid for; `None` where none explains
    /// more than a fit does, or each leaves something that hangs together, unless `rest` may be that. Nothing is left out: this is
    /// for light that rises above no noise pixel by pixel.
    pub fn grounded(
        &self,
        view: &View,
        constants: &[f64],
        plain: &Fit,
        rest: Rest,
        admit: &dyn Fn(&Fit) -> bool,
    ) -> Result<Option<Fit>, CompileFailure> {
        let Some(own) = &self.own else { return Ok(None) };
        let region = own.region(view, constants, &plain.parameters);
        let cost = |fitted: &Variation, fit: &Fit| fitted.cost(view, constants, &fit.parameters, region.as_deref());
        let pixels = region.iter().flatten().filter(|inside| **inside).count().max(1) as f64;
        let Some(limit) = cost(own, plain).map(|cost| cost - DECISIVE / pixels) else { return Ok(None) };
        let mut found: Vec<(f64, Explained)> = Vec::new();
        for Ground { degree, plain: fitted, .. } in &self.grounds {
            let choice = Substitute { degree: *degree, robust: false, hidden: 0.0 };
            let explained = fitted.run(view, constants, &plain.parameters, choice, &[1.0], Outliers::Absent)?;
            let Some(explained) = explained.filter(|explained| admit(&explained.fit)) else { continue };
            let Some(cost) = cost(fitted, &explained.fit).filter(|cost| *cost < limit) else { continue };
            if rest == Rest::Anything || !fitted.is_told(view, constants, &explained.fit.parameters) {
                found.push((cost, explained));
            }
        }
        let best = found.into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
        Ok(best.map(|(_, explained)| own.substituted(explained)))
    }
}

impl Variation {
    /// True where something hangs together in its residuals.
    fn is_told(&self, view: &View, constants: &[f64], parameters: &[f64]) -> bool {
        let constants = constants_for(self.compiled.model(), constants, view, 1.0);
        let seen = self.predictions.residuals(view, parameters, &constants, Over::Domain);
        let size = [view.window.width, view.window.height];
        let structure = seen.and_then(|seen| Structure::of(&seen, size, self.compiled.model().coordinates().len()));
        structure.is_none_or(|structure| structure.is_told())
    }

    /// An alternative's fit as one of this model, whose parameters are the first of those that it has.
    fn substituted(&self, Explained { fit, choice }: Explained) -> Fit {
        let fit = fit.shortened(self.compiled.model().parameters().len(), self.free());
        Fit { choice: Some(choice), ..fit }
    }

    /// How many parameters are free.
    fn free(&self) -> usize {
        self.compiled.last_parameters().len()
    }

    /// Fits from a start, which may lack the parameters of the background; `None` when that is no fit. `scales` are those of
    /// the rounds, the last one of all that follow.
    fn run(
        &self,
        view: &View,
        constants: &[f64],
        start: &[f64],
        choice: Substitute,
        scales: &[f64],
        outliers: Outliers,
    ) -> Result<Option<Explained>, CompileFailure> {
        let limit = (outliers == Outliers::LeftOut).then_some(OUTLIER);
        let mut parameters = start.to_vec();
        parameters.resize(self.compiled.model().parameters().len(), 0.0);
        let mut last: Option<Fit> = None;
        let mut mask = None;
        for round in 0..ROUNDS.max(scales.len()) {
            let as_it_is = constants_for(self.compiled.model(), constants, view, 1.0);
            let seen = self.predictions.residuals(view, &parameters, &as_it_is, Over::Domain);
            let Some(seen) = seen else { return Ok(None) };
            let known = if round == 0 && limit.is_none() { Known::Roughly } else { Known::Well };
            let found = BlindMask::of(view, &seen, known, limit);
            // Without anything hidden a second round would be the first one over again.
            if round >= scales.len() && found.is_none() && mask.is_none() {
                break;
            }
            let precision = self.compiled.precision();
            let painted = found.as_ref().map(|mask| Painted::new(view, mask));
            let blinded = painted.as_ref().and_then(|painted| painted.view(view, precision));
            let (view, control) = match &blinded {
                Some(blinded) => (blinded, Control::Blind),
                None => (view, Control::Dropping),
            };
            let scale = scales[round.min(scales.len() - 1)];
            let constants = constants_for(self.compiled.model(), constants, view, scale);
            let fitted = fit(&self.compiled, view, &constants, &parameters, control)?;
            let is_known =
                |worth: &&Worth| worth.covariance.is_some() && (!worth.is_tied || outliers == Outliers::Absent);
            if fitted.worth.as_ref().filter(is_known).is_none_or(|worth| worth.pixels < PIXELS_MIN as u64) {
                return Ok(None);
            }
            parameters.clone_from(&fitted.parameters);
            last = Some(fitted);
            mask = found;
        }
        let Some(fit) = last else { return Ok(None) };
        let region = self.region(view, constants, &fit.parameters);
        let share = |mask: &BlindMask| {
            let region = region.as_ref()?;
            let inside = mask.pixels.iter().zip(region).filter(|(_, inside)| **inside);
            let blind = inside.clone().filter(|(blind, _)| **blind).count();
            Some(blind as f64 / inside.count().max(1) as f64)
        };
        let hidden = mask.as_ref().and_then(share).unwrap_or(0.0);
        Ok(Some(Explained { fit, choice: Substitute { hidden, ..choice } }))
    }

    /// The first of some starts, and those of the others that lead to the least cost, each over its own domain.
    fn likely(&self, view: &View, constants: &[f64], starts: Vec<Vec<f64>>) -> Result<Vec<Vec<f64>>, CompileFailure> {
        let choice = Substitute { degree: 0, robust: true, hidden: 0.0 };
        let mut tried = Vec::new();
        for start in &starts {
            let candidate = self.run(view, constants, start, choice, SCALES[0], Outliers::Kept)?;
            let Some(candidate) = candidate else { continue };
            let cost = self.cost(view, constants, &candidate.fit.parameters, None);
            tried.extend(cost.map(|cost| (cost, candidate.fit.parameters)));
        }
        tried.sort_by(|a, b| a.0.total_cmp(&b.0));
        let count = starts[0].len();
        let best = tried.into_iter().take(STARTS).map(|(_, mut parameters)| {
            parameters.truncate(count);
            parameters
        });
        Ok(starts.into_iter().take(1).chain(best).collect())
    }

    /// Which pixels of the window belong to the domain.
    fn region(&self, view: &View, constants: &[f64], parameters: &[f64]) -> Option<Vec<bool>> {
        let constants = constants_for(self.compiled.model(), constants, view, 1.0);
        let seen = self.predictions.residuals(view, parameters, &constants, Over::Domain)?;
        let mut region = vec![false; view.window.pixels()];
        seen.iter().flat_map(|seen| &seen.residuals).for_each(|residual| region[residual.pixel] = true);
        Some(region)
    }

    /// What saturated pixels hide that the target does not explain from there.
    fn blind(&self, view: &View, constants: &[f64], parameters: &[f64]) -> Option<BlindMask> {
        let constants = constants_for(self.compiled.model(), constants, view, 1.0);
        let seen = self.predictions.residuals(view, parameters, &constants, Over::Domain)?;
        BlindMask::of(view, &seen, Known::Roughly, None)
    }

    /// The same without pixels that are blind from there.
    fn sighted(&self, view: &View, constants: &[f64], parameters: &[f64]) -> Option<Vec<bool>> {
        let mut region = self.region(view, constants, parameters)?;
        if let Some(mask) = self.blind(view, constants, parameters) {
            region.iter_mut().zip(mask.pixels).for_each(|(inside, blind)| *inside &= !blind);
        }
        Some(region)
    }

    /// The cost of a pixel of the region (without one, of the domain), and of the parameters: `mean min(z², 16) + k ln n / n`.
    /// `None` when there is hardly a pixel.
    fn cost(&self, view: &View, constants: &[f64], parameters: &[f64], region: Option<&[bool]>) -> Option<f64> {
        let constants = constants_for(self.compiled.model(), constants, view, 1.0);
        let over = if region.is_some() { Over::Everything } else { Over::Domain };
        let seen = self.predictions.residuals(view, parameters, &constants, over)?;
        let (mut sum, mut count) = (0.0, 0_usize);
        let residuals = seen.iter().flat_map(|seen| &seen.residuals);
        for residual in residuals.filter(|residual| region.is_none_or(|region| region[residual.pixel])) {
            sum += (residual.whitened * residual.whitened).min(COST);
            count += 1;
        }
        let n = count as f64;
        (count >= PIXELS_MIN).then(|| (sum + self.free() as f64 * n.ln()) / n)
    }
}

/// The model's constants and those of the background: the polynomial is about the window's middle, in units of half its
/// size. `scale`: how many times their deviation residuals are taken to have.
fn constants_for(model: &Model, constants: &[f64], view: &View, scale: f64) -> Vec<f64> {
    let mut all = constants.to_vec();
    if model.constants().len() > constants.len() {
        let (first, size) = (view.window.first(), view.window.size());
        all.extend((0..2).map(|axis| first[axis] as f64 + 0.5 * (size[axis] as f64 - 1.0)));
        all.extend([0.5 * size[0].max(size[1]) as f64, scale]);
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

/// Where alternatives begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum StartsFrom {
    /// Where the plain fit did.
    Given,
    /// There as well, where an alternative was right in the frame before.
    Followed,
    /// Around that as well, when the plain fit is far off.
    Scattered,
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
