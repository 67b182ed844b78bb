//! A fit: all stages of a model on one frame, from given starting values, and what the end point is worth.
//!
//! What comes in: planes, kernels, starting values. What goes out: a [`Fit`]. It never knows whether its result is believed.

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
use crate::solve::follow::{ShortWay, Tether, follow};
use crate::solve::loops::Totals;
use crate::solve::passes::{EndReport, Passes, Summed, Worth};
use crate::solve::sampling::Chosen;
use crate::solve::stage::{self, Arrival, CostFunction, Pass, Rules, StageRun, Stride};
use crate::solve::stage_kernels::{CompileFailure, Control, Free, Job, StageKernels, curvature, method};
use crate::solve::thinned::Thinned;

/// What a fit came to.
#[derive(Clone, Debug)]
pub(crate) struct Fit {
    /// All parameters of the model.
    pub parameters: Vec<f64>,
    pub ending: Ending,
    pub stages: Vec<StageReport>,
    /// Absent when the ending is not that of a fit, nor that of one which the frame's budget has cut short.
    pub worth: Option<Worth>,
    /// What differs from the model, when an alternative was fitted.
    pub choice: Option<Substitute>,
    /// How pixels were sampled, where the model leaves that open.
    pub chosen: Option<Chosen>,
    /// Of a pose: numbers of the spots that were left out.
    pub unused: Vec<usize>,
}

impl Fit {
    /// One that has not begun.
    pub fn at(parameters: Vec<f64>) -> Fit {
        let (ending, stages, unused) = (Ending::SmallStep, Vec::new(), Vec::new());
        Fit { parameters, ending, stages, worth: None, choice: None, chosen: None, unused }
    }

    /// The same, begun where stages with these reports had ended.
    pub fn after(mut self, earlier: &[StageReport]) -> Fit {
        self.stages.iter_mut().zip(earlier).for_each(|(report, earlier)| *report = report.clone().after(earlier));
        self
    }

    /// True when the parameters are the best point that a fit has reached, also when the frame's budget was used up there.
    pub fn is_usable(&self) -> bool {
        self.ending.is_fit() || self.ending == Ending::Budget && self.worth.is_some()
    }
}

/// What is known of a start.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Begin<'a> {
    /// Nothing.
    Anywhere,
    /// It is nearly right: where a target is predicted to be. How pixels were sampled when it was seen last. What has no short way from
    /// there begins anywhere.
    Nearby(Option<&'a Chosen>),
}

/// Fits all stages. A plain fit that turns out to have met saturated pixels is repeated from where it ended without them; one
/// that has met pixels that are no numbers, as files of floating point may hold, from its start without those.
pub(crate) fn fit(
    compiled: &StageKernels,
    view: &View,
    constants: &[f64],
    start: &[f64],
    control: Control,
) -> Result<Fit, CompileFailure> {
    let fit = fit_over(compiled, view, constants, start, control, Way::ThinnedFirst)?;
    if fit.ending == Ending::NonFinite && may_be_nan(&view.planes) && control != Control::Blind {
        return fit_controlled(compiled, view, constants, start, Control::Blind);
    }
    let clipped = fit.worth.as_ref().is_some_and(|worth| worth.saturated > 0.0);
    if control != Control::Plain || !clipped || fit.ending.is_unfinished() {
        return Ok(fit);
    }
    fit_controlled(compiled, view, constants, &fit.parameters, Control::Dropping)
}

/// The fit of what is nearly there already, by the short way; `None` where it is not.
pub(crate) fn fit_nearby(
    compiled: &StageKernels,
    view: &View,
    constants: &[f64],
    start: &[f64],
) -> Result<Option<Fit>, CompileFailure> {
    Ok(followed(compiled, view, constants, start, None, None)?.there())
}

/// How far a fit is from where it began, in standard deviations; `None` without a covariance.
pub(crate) fn way_of(fit: &Fit, start: &[f64], free: &[ParameterId]) -> Option<f64> {
    let covariance = fit.worth.as_ref()?.covariance.as_ref()?;
    let moved = free.iter().map(|parameter| fit.parameters[parameter.index()] - start[parameter.index()]);
    Some(Definite::of(covariance)?.length(&DVector::from_iterator(free.len(), moved)))
}

pub(super) fn fit_controlled(
    compiled: &StageKernels,
    view: &View,
    constants: &[f64],
    start: &[f64],
    control: Control,
) -> Result<Fit, CompileFailure> {
    fit_over(compiled, view, constants, start, control, Way::Whole)
}

/// Which pixels the way to a fit goes over.
#[derive(Clone, Copy)]
enum Way {
    /// All.
    Whole,
    /// Some rows of them first, where they are many.
    ThinnedFirst,
}

fn fit_over(
    compiled: &StageKernels,
    view: &View,
    constants: &[f64],
    start: &[f64],
    control: Control,
    way: Way,
) -> Result<Fit, CompileFailure> {
    let model = compiled.model();
    let parts = parts(model, view, constants, start);
    // Of several targets in one window some may lie between the rows.
    let thinned = match (way, model.roles(), &parts[..]) {
        (Way::ThinnedFirst, [_], [window]) => Thinned::of(*window),
        _ => None,
    };
    let (mut fit, mut last) = (Fit::at(start.to_vec()), None);
    for index in 0..model.stages().len() {
        let problem = |parts| Summed::of(Passes::of(compiled, view, parts, constants), index, control);
        let mut rules = rules(compiled, view, index, control);
        let mut way = None;
        if let Some(thinned) = &thinned {
            let mut at = fit.parameters.clone();
            let mut way_there =
                Beginning { problem: problem(&thinned.rows)?, with: thinned.begins_with(model.entries()) };
            let way_rules = Rules { settles: false, ..rules.clone() };
            let StageRun { report, .. } = stage::run(&mut way_there, &way_rules, &mut at);
            if let Some(steps) = thinned.steps_left(&report, rules.iterations, model.entries()) {
                (rules.iterations, fit.parameters) = (steps, at);
            }
            way = Some(thinned.in_full(report));
        }
        let mut problem = problem(&parts)?;
        let mut run = stage::run(&mut problem, &rules, &mut fit.parameters);
        let report = std::mem::take(&mut run.report);
        (fit.ending, last) = (report.ending, Some(run));
        fit.stages.push(match &way {
            Some(way) => report.after(way),
            None => report,
        });
        if !fit.ending.is_fit() {
            break;
        }
    }
    let is_begun = fit.stages.iter().any(|stage| stage.passes > 0);
    let is_cut = fit.ending == Ending::Budget && view.is_over() && is_begun;
    match fit.ending.is_fit() || is_cut {
        true => weighed(compiled, view, constants, (fit, last), control, &parts),
        false => Ok(fit),
    }
}

/// A function that has no values but where it begins with so many pixels.
struct Beginning<P> {
    problem: P,
    with: RangeInclusive<u64>,
}

impl<P: CostFunction> CostFunction for Beginning<P> {
    fn gradient(&mut self, point: &[f64], entry: &[f64], pass: &mut Pass) -> Result<(), Ending> {
        self.problem.gradient(point, entry, pass)?;
        let is_begun = std::mem::replace(&mut self.with, 0..=u64::MAX).contains(&pass.pixels);
        is_begun.then_some(()).ok_or(Ending::DomainVanished)
    }

    fn allowed(&self, point: &[f64]) -> bool {
        self.problem.allowed(point)
    }

    fn moved(&self, from: &[f64], to: &[f64]) -> Option<Moved> {
        self.problem.moved(from, to)
    }
}

/// A fit with what it is worth. One that the frame's budget has cut short is over it by that.
fn weighed(
    compiled: &StageKernels,
    view: &View,
    constants: &[f64],
    (mut fit, last): (Fit, Option<StageRun>),
    control: Control,
    parts: &[Window],
) -> Result<Fit, CompileFailure> {
    let model = compiled.model();
    let (is_over, is_cut) = (fit.ending == Ending::Budget, fit.ending.is_cut_short());
    let control = if control == Control::Blind { control } else { Control::Dropping };
    let covariance = compiled.loops(Job::Covariance, control, &view.layout)?;
    let report = if model.has_noise() { Some(compiled.loops(Job::Report, control, &view.layout)?) } else { None };
    let mut passes = Passes::of(compiled, view, parts, constants);
    (passes.is_last, passes.is_cut_short) = (is_over, is_cut);
    let (entry, moved) = last.map_or_else(|| (fit.parameters.clone(), None), |run| (run.entry, run.moved));
    match passes.worth(&covariance, report.as_ref(), &fit.parameters, &entry) {
        Ok(mut worth) => {
            if worth.covariance.is_none() && !is_over {
                fit.ending = Ending::Singular;
            }
            let share = if is_cut { 1.0 } else { 0.5 };
            moved.into_iter().for_each(|moved| worth.widen(&(share * moved)));
            fit.worth = Some(worth);
        }
        Err(_) if is_over => {}
        Err(ending) => fit.ending = ending,
    }
    Ok(fit)
}

/// What a short way had come to when the frame's budget was used up.
pub(super) fn cut_short(
    compiled: &StageKernels,
    view: &View,
    constants: &[f64],
    parameters: Vec<f64>,
    report: StageReport,
) -> Result<Fit, CompileFailure> {
    let parts = parts(compiled.model(), view, constants, &parameters);
    let report = StageReport { ending: Ending::Budget, ..report };
    let stages = alone(report, compiled.short_stage());
    let fit = Fit { stages, ending: Ending::Budget, ..Fit::at(parameters) };
    weighed(compiled, view, constants, (fit, None), Control::Dropping, &parts)
}

/// The short way, for models whose last stage fits all that the others do, and whose Hessian is the covariance's: what earlier
/// stages are there for is known nearby. Saturated pixels are left out or censored, as a plain fit would do when it has met them.
/// `before` and `tether` are those of [`follow`].
pub(super) fn followed(
    compiled: &StageKernels,
    view: &View,
    constants: &[f64],
    start: &[f64],
    before: Option<Stride>,
    tether: Option<&Tether>,
) -> Result<Arrival<Fit>, CompileFailure> {
    let Some(last) = compiled.short_stage() else { return Ok(Arrival::Lost) };
    let control = Control::Dropping;
    let parts = parts(compiled.model(), view, constants, start);
    let mut problem = Summed::of(Passes::of(compiled, view, &parts, constants), last, control)?.nearby()?;
    let has_noise = compiled.model().has_noise();
    let report = has_noise.then(|| compiled.loops(Job::Report, control, &view.layout)).transpose()?;
    let mut parameters = start.to_vec();
    let rules = rules(compiled, view, last, control);
    let ShortWay { report: stage, pass, entry, is_told, factors } =
        match follow(&mut problem, &rules, &mut parameters, before, tether) {
            Arrival::There(way) => way,
            Arrival::Far { parameters, stride, report } => return Ok(Arrival::Far { parameters, stride, report }),
            Arrival::Lost => return Ok(Arrival::Lost),
        };
    if stage.ending == Ending::Budget && !view.is_over() {
        return Ok(Arrival::Lost); // a part of the frame's work has ended, and others go on
    }
    problem.passes.is_last = stage.ending == Ending::Budget;
    problem.passes.is_cut_short = problem.passes.is_last;
    let report = match (&report, is_told) {
        (None, _) => EndReport::None,
        (Some(_), true) => EndReport::Told,
        (Some(report), false) => EndReport::Untold(report),
    };
    let worth = problem.passes.worth_of((pass, factors), report, &parameters, &entry);
    let Some(worth) = worth.ok().filter(|worth| worth.covariance.is_some()) else { return Ok(Arrival::Lost) };
    let ending = stage.ending;
    let stages = alone(stage, Some(last));
    let fit = Fit { ending, stages, worth: Some(worth), ..Fit::at(parameters) };
    Ok(Arrival::There(fit))
}

/// The reports of all stages where that one alone was run.
fn alone(report: StageReport, stage: Option<usize>) -> Vec<StageReport> {
    let mut stages = vec![StageReport::default(); stage.unwrap_or(0)];
    stages.push(report);
    stages
}

/// What a stage may do on a view.
fn rules(compiled: &StageKernels, view: &View, index: usize, control: Control) -> Rules {
    let model = compiled.model();
    let (stage, is_last) = (&model.stages()[index], index + 1 == model.stages().len());
    let Free { parameters, bounds, places } = compiled.free(index);
    Rules {
        free: parameters.clone(),
        bounds: bounds.clone(),
        places: places.clone(),
        iterations: stage.iterations,
        tolerance: stage.tolerance * tolerance_share(compiled.precision()),
        noise: model.has_noise(),
        renewal: compiled.renewal(),
        has_domain: compiled.has_domain(),
        settles: is_last || stage.parameters.iter().any(|one| !compiled.last_parameters().contains(one)),
        precision: compiled.precision(),
        rounding: view.rounding,
        rounding_variance: view.rounding_variance(),
        is_traced: view.budget.is_some_and(FrameBudget::is_traced),
        window_pixels: if control == Control::Blind { view.numbers() } else { view.window.pixels() - view.gap_pixels() }
            as u64,
    }
}

/// The windows to look at for a fit that begins at `start`.
fn parts(model: &Model, view: &View, constants: &[f64], start: &[f64]) -> Vec<Window> {
    let windows = |geometry: Geometry| geometry.windows(model, start, constants, view.window);
    Geometry::of(model, constants).map_or_else(|| vec![view.window], windows)
}

/// By how much F (with noise: minus twice the log-likelihood) is larger at `b` than at `a`, the mean over the pixels of
/// either.
pub(crate) fn difference(
    compiled: &StageKernels,
    view: &View,
    constants: &[f64],
    a: &[f64],
    b: &[f64],
) -> Result<Option<f64>, CompileFailure> {
    let model = compiled.model();
    let job = if model.has_noise() { Job::Report } else { Job::Value };
    let value = compiled.loops(job, Control::Dropping, &view.layout)?;
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

/// F, gradient and Hessian of a stage at a point, on that point's pixel set; `None` when no kernel could run.
pub(crate) fn pass_at(
    compiled: &StageKernels,
    view: &View,
    constants: &[f64],
    stage: usize,
    control: Control,
    point: &[f64],
) -> Result<Option<Pass>, CompileFailure> {
    let Stage { parameters, .. } = &compiled.model().stages()[stage];
    let method = method(compiled.model(), stage, &view.layout);
    let gradient = compiled.loops(Job::Stage(stage), control, &view.layout)?;
    let bindings = Bindings { parameters: point, entry: point, constants, saturation: &view.limits, shift: &[] };
    let (mut totals, mut pass) = (Totals::default(), Pass::of(parameters.len()));
    let ran = gradient.sums(&bindings, &view.planes, &[view.window], &view.gaps, &view.row_variances, &mut totals);
    Ok(ran.and_then(|()| pass.read(&totals, curvature(method)).ok()).map(|()| pass))
}

/// In f64 a stage ends at a ten-thousandth of its tolerance: who asks for f64 asks for digits.
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

    /// Fits that go some rows first, and such that do not, of a spot of that size in all of a picture, from a start beside it.
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
        let thinned = fit(&compiled, &view, &constants, &start, Control::Plain).unwrap();
        [thinned, fit_controlled(&compiled, &view, &constants, &start, Control::Plain).unwrap()]
    }

    /// But for what pixels at the rim that come and go with a step make of it.
    #[test]
    fn the_way_over_some_rows_leads_where_that_over_all_pixels_does() {
        let [thinned, whole] = both_ways(60.0);
        assert!(thinned.ending == Ending::SmallStep && whole.ending == Ending::SmallStep, "{thinned:?} {whole:?}");
        let covariance = whole.worth.as_ref().unwrap().covariance.as_ref().unwrap();
        for i in 0..covariance.nrows() {
            let off = (thinned.parameters[i] - whole.parameters[i]) / covariance[(i, i)].sqrt();
            assert!(off.abs() < 0.1, "parameter {i} is {off} standard deviations off");
        }
        assert!(thinned.stages[0].passes < whole.stages[0].passes, "{thinned:?} {whole:?}");
    }

    #[test]
    fn a_target_between_the_rows_is_fitted_as_it_would_be_without_them() {
        let [thinned, whole] = both_ways(7.0);
        assert!(whole.ending == Ending::SmallStep && thinned.parameters == whole.parameters, "{thinned:?} {whole:?}");
    }
}
