//! Fits all stages of a model to one frame from given starting values, and evaluates covariance and χ² at the end point.
//! Callers decide whether to accept the [`Fit`].

use std::ops::RangeInclusive;

use isophote_jit::Window;
use isophote_symbolic::{Bindings, Model, ParameterId, Precision, Stage};
use nalgebra::DVector;

use crate::budget::FrameBudget;
use crate::estimate::{Ending, StageReport, Substitute};
use crate::outline::Moved;
use crate::pose::Geometry;
use crate::scaled::Definite;
use crate::sight::grey::may_be_nan;
use crate::sight::view::View;
use crate::solve::loops::Totals;
use crate::solve::passes::{EndReport, FitSummary, Passes, Summed};
use crate::solve::prior::Prior;
use crate::solve::refine::{DistanceLimit, Refinement, refine};
use crate::solve::sampling::SamplingChoice;
use crate::solve::stage::{self, CostFunction, Pass, PreviousStep, RefineOutcome, Rules, StageRun};
use crate::solve::stage_kernels::{
    CompileFailure, FreeParameters, Job, PixelHandling, StageKernels, curvature, method,
};
use crate::solve::subsampled::Subsampled;

/// The result of a fit.
#[derive(Clone, Debug)]
pub(crate) struct Fit {
    /// All parameters of the model.
    pub parameters: Vec<f64>,
    pub ending: Ending,
    pub stages: Vec<StageReport>,
    /// Absent unless the ending is that of a fit, or the frame's budget has cut the fit short.
    pub summary: Option<FitSummary>,
    /// How an alternative fit differs from the model.
    pub choice: Option<Substitute>,
    /// The sampling of pixels, where the model leaves that open.
    pub sampling_choice: Option<SamplingChoice>,
    /// Of a pose: indices of the spots left out.
    pub unused: Vec<usize>,
}

impl Fit {
    /// A fit before its first pass.
    pub fn at(parameters: Vec<f64>) -> Fit {
        let (ending, stages, unused) = (Ending::SmallStep, Vec::new(), Vec::new());
        Fit { parameters, ending, stages, summary: None, choice: None, sampling_choice: None, unused }
    }

    /// Prepends the reports of earlier stages that this fit continued from.
    pub fn after(mut self, earlier: &[StageReport]) -> Fit {
        self.stages.iter_mut().zip(earlier).for_each(|(report, earlier)| *report = report.clone().after(earlier));
        self
    }

    /// True when the parameters are a fit's best point, also when the frame's budget ended it there.
    pub fn is_usable(&self) -> bool {
        self.ending.is_fit() || self.ending == Ending::Budget && self.summary.is_some()
    }
}

/// Prior knowledge about a start.
#[derive(Clone, Copy, Debug)]
pub(crate) enum StartKind<'a> {
    /// Nothing.
    Anywhere,
    /// A target's predicted position, nearly right, with the sampling of the last fit. Where a refinement fails, the
    /// fit runs as from anywhere.
    Nearby(Option<&'a SamplingChoice>),
}

/// Fits all stages. A plain fit that met saturated pixels continues from its end without them; one that met NaN, as in
/// floating-point files, restarts without those.
pub(crate) fn fit(
    compiled: &StageKernels,
    view: &View,
    constants: &[f64],
    start: &[f64],
    handling: PixelHandling,
) -> Result<Fit, CompileFailure> {
    let fit = fit_over(compiled, view, constants, start, handling, PixelSchedule::SubsampledFirst, None)?;
    if fit.ending == Ending::NonFinite && may_be_nan(&view.planes) && handling != PixelHandling::SkipInvalid {
        return fit_controlled(compiled, view, constants, start, PixelHandling::SkipInvalid);
    }
    let clipped = fit.summary.as_ref().is_some_and(|summary| summary.saturated > 0.0);
    if handling != PixelHandling::All || !clipped || fit.ending.is_unfinished() {
        return Ok(fit);
    }
    fit_controlled(compiled, view, constants, &fit.parameters, PixelHandling::SkipSaturated)
}

/// Fits a nearly right start by a refinement; `None` where it is not nearly right.
pub(crate) fn fit_nearby(
    compiled: &StageKernels,
    view: &View,
    constants: &[f64],
    start: &[f64],
) -> Result<Option<Fit>, CompileFailure> {
    Ok(refined(compiled, view, constants, start, None, None)?.done())
}

/// Distance of a fit from its start in standard deviations; `None` without a covariance.
pub(crate) fn distance_from_start(fit: &Fit, start: &[f64], free: &[ParameterId]) -> Option<f64> {
    let covariance = fit.summary.as_ref()?.covariance.as_ref()?;
    let moved = free.iter().map(|parameter| fit.parameters[parameter.index()] - start[parameter.index()]);
    Some(Definite::of(covariance)?.length(&DVector::from_iterator(free.len(), moved)))
}

pub(super) fn fit_controlled(
    compiled: &StageKernels,
    view: &View,
    constants: &[f64],
    start: &[f64],
    handling: PixelHandling,
) -> Result<Fit, CompileFailure> {
    fit_over(compiled, view, constants, start, handling, PixelSchedule::All, None)
}

/// Fits all stages without saturated pixels, with a prior of the last parameters.
pub(super) fn fit_with_prior(
    compiled: &StageKernels,
    view: &View,
    constants: &[f64],
    start: &[f64],
    prior: &Prior,
) -> Result<Fit, CompileFailure> {
    fit_over(
        compiled,
        view,
        constants,
        start,
        PixelHandling::SkipSaturated,
        PixelSchedule::SubsampledFirst,
        Some(prior),
    )
}

/// The pixels used on the way to a fit.
#[derive(Clone, Copy)]
enum PixelSchedule {
    /// All.
    All,
    /// A subset of rows first, where there are many pixels.
    SubsampledFirst,
}

fn fit_over(
    compiled: &StageKernels,
    view: &View,
    constants: &[f64],
    start: &[f64],
    handling: PixelHandling,
    schedule: PixelSchedule,
    prior: Option<&Prior>,
) -> Result<Fit, CompileFailure> {
    let model = compiled.model();
    let parts = parts(model, view, constants, start);
    // With several targets in one window some may lie between the rows.
    let subsampled = match (schedule, model.roles(), &parts[..]) {
        (PixelSchedule::SubsampledFirst, [_], [window]) => Subsampled::of(*window),
        _ => None,
    };
    let (mut fit, mut last) = (Fit::at(start.to_vec()), None);
    for index in 0..model.stages().len() {
        let problem = |parts| {
            let mut passes = Passes::of(compiled, view, parts, constants);
            passes.prior = prior;
            Summed::of(passes, index, handling)
        };
        let mut rules = rules(compiled, view, index, handling);
        let mut first_run = None;
        if let Some(subsampled) = &subsampled {
            let mut at = fit.parameters.clone();
            let mut first_problem =
                FirstPassCheck { problem: problem(&subsampled.rows)?, pixels: subsampled.begins_with(model.entries()) };
            let first_rules = Rules { converges_fully: false, ..rules.clone() };
            let StageRun { report, .. } = stage::run(&mut first_problem, &first_rules, &mut at);
            if let Some(steps) = subsampled.steps_left(&report, rules.iterations, model.entries()) {
                (rules.iterations, fit.parameters) = (steps, at);
            }
            first_run = Some(subsampled.in_full(report));
        }
        let mut problem = problem(&parts)?;
        let mut run = stage::run(&mut problem, &rules, &mut fit.parameters);
        let report = std::mem::take(&mut run.report);
        (fit.ending, last) = (report.ending, Some(run));
        fit.stages.push(match &first_run {
            Some(first_run) => report.after(first_run),
            None => report,
        });
        if !fit.ending.is_fit() {
            break;
        }
    }
    let has_started = fit.stages.iter().any(|stage| stage.passes > 0);
    let is_cut = fit.ending == Ending::Budget && view.is_over() && has_started;
    match fit.ending.is_fit() || is_cut {
        true => with_summary(compiled, view, constants, (fit, last), handling, &parts, prior),
        false => Ok(fit),
    }
}

/// A cost function that fails unless its first pass has this many pixels.
struct FirstPassCheck<P> {
    problem: P,
    pixels: RangeInclusive<u64>,
}

impl<P: CostFunction> CostFunction for FirstPassCheck<P> {
    fn gradient(&mut self, point: &[f64], entry: &[f64], pass: &mut Pass) -> Result<(), Ending> {
        self.problem.gradient(point, entry, pass)?;
        let has_started = std::mem::replace(&mut self.pixels, 0..=u64::MAX).contains(&pass.pixels);
        has_started.then_some(()).ok_or(Ending::DomainVanished)
    }

    fn allowed(&self, point: &[f64]) -> bool {
        self.problem.allowed(point)
    }

    fn moved(&self, from: &[f64], to: &[f64]) -> Option<Moved> {
        self.problem.moved(from, to)
    }
}

/// Adds [`FitSummary`] to a fit; one that the frame's budget has cut short may exceed the budget for that.
fn with_summary(
    compiled: &StageKernels,
    view: &View,
    constants: &[f64],
    (mut fit, last): (Fit, Option<StageRun>),
    handling: PixelHandling,
    parts: &[Window],
    prior: Option<&Prior>,
) -> Result<Fit, CompileFailure> {
    let model = compiled.model();
    let (is_over, is_cut) = (fit.ending == Ending::Budget, fit.ending.is_cut_short());
    let handling = if handling == PixelHandling::SkipInvalid { handling } else { PixelHandling::SkipSaturated };
    let covariance = compiled.loops(Job::Covariance, handling, &view.layout)?;
    let report = if model.has_noise() { Some(compiled.loops(Job::Report, handling, &view.layout)?) } else { None };
    let mut passes = Passes::of(compiled, view, parts, constants);
    (passes.is_last, passes.is_cut_short, passes.prior) = (is_over, is_cut, prior);
    let (entry, moved) = last.map_or_else(|| (fit.parameters.clone(), None), |run| (run.entry, run.moved));
    match passes.summary(&covariance, report.as_ref(), &fit.parameters, &entry) {
        Ok(mut summary) => {
            if summary.covariance.is_none() && fit.ending.is_converged() {
                fit.ending = Ending::Singular;
            }
            let share = if is_cut { 1.0 } else { 0.5 };
            moved.into_iter().for_each(|moved| summary.widen(&(share * moved)));
            fit.summary = Some(summary);
        }
        Err(_) if is_over => {}
        Err(ending) => fit.ending = ending,
    }
    Ok(fit)
}

/// Builds a fit from the point that a refinement had reached when the frame's budget was used up.
pub(super) fn cut_short(
    compiled: &StageKernels,
    view: &View,
    constants: &[f64],
    parameters: Vec<f64>,
    report: StageReport,
) -> Result<Fit, CompileFailure> {
    let parts = parts(compiled.model(), view, constants, &parameters);
    let report = StageReport { ending: Ending::Budget, ..report };
    let stages = single_stage(report, compiled.refine_stage());
    let fit = Fit { stages, ending: Ending::Budget, ..Fit::at(parameters) };
    with_summary(compiled, view, constants, (fit, None), PixelHandling::SkipSaturated, &parts, None)
}

/// A refinement, for models whose last stage frees all parameters of the others, with the covariance's Hessian: earlier
/// stages only find what is known nearby. Saturated pixels are dropped or censored, as in a plain fit that has met them.
/// For `before` and `distance_limit` see [`refine`].
pub(super) fn refined(
    compiled: &StageKernels,
    view: &View,
    constants: &[f64],
    start: &[f64],
    before: Option<PreviousStep>,
    distance_limit: Option<&DistanceLimit>,
) -> Result<RefineOutcome<Fit>, CompileFailure> {
    let Some(last) = compiled.refine_stage() else { return Ok(RefineOutcome::Failed) };
    let handling = PixelHandling::SkipSaturated;
    let parts = parts(compiled.model(), view, constants, start);
    let mut problem = Summed::of(Passes::of(compiled, view, &parts, constants), last, handling)?.nearby()?;
    let has_noise = compiled.model().has_noise();
    let report = has_noise.then(|| compiled.loops(Job::Report, handling, &view.layout)).transpose()?;
    let mut parameters = start.to_vec();
    let rules = rules(compiled, view, last, handling);
    let Refinement { report: stage, pass, entry, has_end_report, factors } =
        match refine(&mut problem, &rules, &mut parameters, before, distance_limit) {
            RefineOutcome::Done(refinement) => refinement,
            RefineOutcome::BeyondLimit { parameters, previous_step, report } => {
                return Ok(RefineOutcome::BeyondLimit { parameters, previous_step, report });
            }
            RefineOutcome::Failed => return Ok(RefineOutcome::Failed),
        };
    if stage.ending == Ending::Budget && !view.is_over() {
        return Ok(RefineOutcome::Failed); // only a share of the frame's budget is used up, and other fits go on
    }
    problem.passes.is_last = stage.ending == Ending::Budget;
    problem.passes.is_cut_short = problem.passes.is_last;
    let report = match (&report, has_end_report) {
        (None, _) => EndReport::None,
        (Some(_), true) => EndReport::LastPass,
        (Some(report), false) => EndReport::Separate(report),
    };
    let summary = problem.passes.summary_of((pass, factors), report, &parameters, &entry);
    let Some(summary) = summary.ok().filter(|summary| summary.covariance.is_some()) else {
        return Ok(RefineOutcome::Failed);
    };
    let ending = stage.ending;
    let stages = single_stage(stage, Some(last));
    let fit = Fit { ending, stages, summary: Some(summary), ..Fit::at(parameters) };
    Ok(RefineOutcome::Done(fit))
}

/// Stage reports where only this one ran.
fn single_stage(report: StageReport, stage: Option<usize>) -> Vec<StageReport> {
    let mut stages = vec![StageReport::default(); stage.unwrap_or(0)];
    stages.push(report);
    stages
}

/// The rules of a stage on a view.
fn rules(compiled: &StageKernels, view: &View, index: usize, handling: PixelHandling) -> Rules {
    let model = compiled.model();
    let (stage, is_last) = (&model.stages()[index], index + 1 == model.stages().len());
    let FreeParameters { parameters, bounds, position_rows } = compiled.free(index);
    Rules {
        free: parameters.clone(),
        bounds: bounds.clone(),
        position_rows: position_rows.clone(),
        iterations: stage.iterations,
        tolerance: stage.tolerance * tolerance_share(compiled.precision()),
        noise: model.has_noise(),
        renewal: compiled.renewal(),
        has_domain: compiled.has_domain(),
        converges_fully: is_last || stage.parameters.iter().any(|one| !compiled.last_parameters().contains(one)),
        precision: compiled.precision(),
        rounding: view.rounding,
        rounding_variance: view.rounding_variance(),
        is_traced: view.budget.is_some_and(FrameBudget::is_traced),
        window_pixels: if handling == PixelHandling::SkipInvalid {
            view.numbers()
        } else {
            view.window.pixels() - view.gap_pixels()
        } as u64,
    }
}

/// The windows to sum over for a fit that begins at `start`.
fn parts(model: &Model, view: &View, constants: &[f64], start: &[f64]) -> Vec<Window> {
    let windows = |geometry: Geometry| geometry.windows(model, start, constants, view.window);
    Geometry::of(model, constants).map_or_else(|| vec![view.window], windows)
}

/// Difference in F (with noise: minus twice the log-likelihood) of `b` over `a`, averaged over the pixel sets of both.
pub(crate) fn difference(
    compiled: &StageKernels,
    view: &View,
    constants: &[f64],
    a: &[f64],
    b: &[f64],
) -> Result<Option<f64>, CompileFailure> {
    let model = compiled.model();
    let job = if model.has_noise() { Job::Report } else { Job::Value };
    let value = compiled.loops(job, PixelHandling::SkipSaturated, &view.layout)?;
    let mut sum = 0.0;
    for entry in [a, b] {
        let parts = parts(model, view, constants, entry);
        let mut passes = Passes::of(compiled, view, &parts, constants);
        let mut at = |point: &[f64]| passes.run(&value, point, entry).ok()?.outputs.first().copied();
        let (Some(at_a), Some(at_b)) = (at(a), at(b)) else { return Ok(None) };
        sum += at_b - at_a;
    }
    Ok(Some(0.5 * sum))
}

/// F, gradient and Hessian of a stage at a point, on that point's pixel set; `None` when a kernel fails.
pub(crate) fn pass_at(
    compiled: &StageKernels,
    view: &View,
    constants: &[f64],
    stage: usize,
    handling: PixelHandling,
    point: &[f64],
) -> Result<Option<Pass>, CompileFailure> {
    let Stage { parameters, .. } = &compiled.model().stages()[stage];
    let method = method(compiled.model(), stage, &view.layout);
    let gradient = compiled.loops(Job::Stage(stage), handling, &view.layout)?;
    let bindings = Bindings { parameters: point, entry: point, constants, saturation: &view.limits, shift: &[] };
    let (mut totals, mut pass) = (Totals::default(), Pass::of(parameters.len()));
    let ran = gradient.sums(&bindings, &view.planes, &[view.window], &view.gaps, &view.row_variances, &mut totals);
    Ok(ran.and_then(|()| pass.read(&totals, curvature(method)).ok()).map(|()| pass))
}

/// In f64 a stage converges to a ten-thousandth of its tolerance: users of f64 want digits.
fn tolerance_share(precision: Precision) -> f64 {
    match precision {
        Precision::F32 => 1.0,
        Precision::F64 => 1e-4,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::sync::Arc;

    use smallvec::smallvec;

    use super::*;
    use crate::picture::{Falloff, Spot, TestPicture};
    use crate::solve::compiled::Compiled;

    /// The fits with and without row subsampling, of a spot of this size that fills most of a picture, from a start beside
    /// it.
    fn both_ways(half: f64) -> [Fit; 2] {
        let text = include_str!("../../../tests/documents/plain-spot.toml");
        let compiled = Compiled::new(Arc::new(Model::from_toml(text).unwrap()), Precision::F32).unwrap();
        let spot = Spot { profile: Falloff::Cubic(-0.5, -0.3), ..Spot::at(161.3, 118.6, half, 140.0) };
        let frame = TestPicture { noise: 1.5, ..TestPicture::new(320, 240, vec![spot]) }.frame();
        let view = View::new(vec![frame.plane_view(0)], Window::whole(320, 240), smallvec![255.0], Precision::F32);
        let model = compiled.model();
        let of = |name: &str| match name {
            "bx" => 161.3 + 0.6 * half,
            "by" => 118.6,
            "a1" | "a3" => 2.0 / (half * half),
            "v0" => 20.0,
            "v1" => 120.0,
            "k1" => -0.5,
            "k2" => -0.3,
            _ => 0.0,
        };
        let start: Vec<f64> = model.parameters().iter().map(|parameter| of(&parameter.name)).collect();
        let constants: Vec<f64> = model.constants().iter().map(|constant| constant.value).collect();
        let subsampled = fit(&compiled, &view, &constants, &start, PixelHandling::All).unwrap();
        [subsampled, fit_controlled(&compiled, &view, &constants, &start, PixelHandling::All).unwrap()]
    }

    /// Up to the effect of rim pixels that enter or leave with a step.
    #[test]
    fn thinned_fits_end_at_the_minimum_over_all_pixels() {
        let [subsampled, whole] = both_ways(60.0);
        assert!(
            subsampled.ending == Ending::SmallStep && whole.ending == Ending::SmallStep,
            "{subsampled:?} {whole:?}"
        );
        let covariance = whole.summary.as_ref().unwrap().covariance.as_ref().unwrap();
        for i in 0..covariance.nrows() {
            let off = (subsampled.parameters[i] - whole.parameters[i]) / covariance[(i, i)].sqrt();
            assert!(off.abs() < 0.1, "parameter {i} is {off} standard deviations off");
        }
        assert!(subsampled.stages[0].passes < whole.stages[0].passes, "{subsampled:?} {whole:?}");
    }

    #[test]
    fn a_target_between_the_rows_is_fitted_without_thinning() {
        let [subsampled, whole] = both_ways(7.0);
        assert!(
            whole.ending == Ending::SmallStep && subsampled.parameters == whole.parameters,
            "{subsampled:?} {whole:?}"
        );
    }
}
