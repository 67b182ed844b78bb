//! A fit: all stages of a model on one frame, from given starting values, and what the end point is worth.
//!
//! What comes in: planes, kernels, starting values. What goes out: a [`Fit`]. It never knows whether its result is believed.

use isophote_jit::{PixelFormat, PlaneView, Window};
use isophote_symbolic::{Bindings, Model, ParameterId, Precision, Stage, ValueKind};
use nalgebra::{DMatrix, DVector};

use crate::estimate::{Ending, StageReport};
use crate::pose::Geometry;
use crate::sight::clipping::clipping;
use crate::sight::grey::{Grey, Mixture, may_be_nan};
use crate::solve::alternatives::Substitute;
use crate::solve::compiled::{CompileFailure, Compiled, Control, Job, Layout, curvature, value_kind};
use crate::solve::loops::{Loops, Totals};
use crate::solve::stage::{self, Pass, Problem, Rules};
use crate::solve::trust::{Curvature, Quadratic, Spectrum};

/// The largest pixel value of a format: the camera's limit where nothing else is known.
pub(crate) fn largest_value(format: PixelFormat) -> f64 {
    match format {
        PixelFormat::U8 => f64::from(u8::MAX),
        PixelFormat::U16 => f64::from(u16::MAX),
        PixelFormat::F32 | PixelFormat::F64 => f64::INFINITY,
    }
}

/// What a fit looks at.
pub(crate) struct View<'a> {
    pub planes: Vec<PlaneView<'a>>,
    pub window: Window,
    /// One limit a plane.
    pub saturation: Vec<f64>,
    /// The same for kernels: whole pixel values stand for all that is rounded to them, so light is at the limit from half
    /// a step below it on.
    limits: Vec<f64>,
    pub layout: Layout,
    /// What the lane's rounding does to a residual, in pixel values.
    pub rounding: f64,
}

impl<'a> View<'a> {
    /// Planes of one size; the window lies inside. `saturation`: one limit a plane.
    pub fn new(planes: Vec<PlaneView<'a>>, window: Window, saturation: Vec<f64>, precision: Precision) -> View<'a> {
        let largest =
            planes.iter().zip(&saturation).map(|(plane, limit)| largest(plane, window, *limit)).fold(0.0, f64::max);
        let lane = match precision {
            Precision::F32 => f64::from(f32::EPSILON),
            Precision::F64 => f64::EPSILON,
        };
        let layout = Layout::of(&planes);
        let step = |plane: &PlaneView| if is_whole(plane) { 0.5 } else { 0.0 };
        let limits = planes.iter().zip(&saturation).map(|(plane, limit)| limit - step(plane)).collect();
        View { planes, window, saturation, limits, layout, rounding: lane * largest }
    }
}

impl View<'_> {
    /// The same part of a copy of the picture in fractions, with the limits that pixels were rounded to.
    pub fn with_planes<'b>(&self, planes: Vec<PlaneView<'b>>, precision: Precision) -> View<'b> {
        let mut view = View::new(planes, self.window, vec![f64::INFINITY; self.saturation.len()], precision);
        view.saturation.clone_from(&self.limits);
        view.limits.clone_from(&self.limits);
        view.rounding = self.rounding;
        view
    }

    /// Pixels are integers.
    pub fn holds_whole_values(&self) -> bool {
        self.planes.iter().all(is_whole)
    }
}

/// The limit of one plane of a camera of which nothing is known: where the pixels show that they are clipped, else the
/// largest value of the format.
pub(crate) fn limit(plane: &PlaneView, window: Window) -> f64 {
    clipping(plane, window).unwrap_or(largest_value(plane.format()))
}

fn is_whole(plane: &PlaneView) -> bool {
    matches!(plane.format(), PixelFormat::U8 | PixelFormat::U16)
}

/// A magnitude that pixel values do not exceed; floats without a limit are looked at.
fn largest(plane: &PlaneView, window: Window, limit: f64) -> f64 {
    if limit.is_finite() {
        return limit.abs();
    }
    Grey::read(&[*plane], window, &[f64::INFINITY], &Mixture::mean(1))
        .values
        .into_iter()
        .map(f64::abs)
        .filter(|value| value.is_finite())
        .fold(0.0, f64::max)
}

/// What a fit came to.
#[derive(Clone, Debug)]
pub(crate) struct Fit {
    /// All parameters of the model.
    pub parameters: Vec<f64>,
    pub ending: Ending,
    pub stages: Vec<StageReport>,
    /// Absent when the ending is not that of a fit.
    pub worth: Option<Worth>,
    /// What differs from the model, when an alternative was fitted.
    pub choice: Option<Substitute>,
}

/// What the end point is worth, by a last pass that leaves saturated pixels out.
#[derive(Clone, Debug)]
pub(crate) struct Worth {
    /// F; with noise that is χ² + Σ ln σ².
    pub objective: f64,
    /// χ²/ν; absent when there are no more pixels than parameters.
    pub reduced: Option<f64>,
    pub pixels: u64,
    /// Share of the domain's pixels.
    pub saturated: f64,
    /// Of the last stage's parameters; absent when singular.
    pub covariance: Option<DMatrix<f64>>,
    /// Variances that they would have if all others were known: a lower bound, and never absent.
    pub variance_alone: DVector<f64>,
}

/// Fits all stages. A plain fit that turns out to have met saturated pixels is repeated from where it ended without them; one
/// that has met pixels that are no numbers, as files of floating point may hold, from its start without those.
pub(crate) fn fit(
    compiled: &Compiled,
    view: &View,
    constants: &[f64],
    start: &[f64],
    control: Control,
) -> Result<Fit, CompileFailure> {
    let fit = fit_controlled(compiled, view, constants, start, control)?;
    if fit.ending == Ending::NonFinite && may_be_nan(&view.planes) && control != Control::Blind {
        return fit_controlled(compiled, view, constants, start, Control::Blind);
    }
    let clipped = fit.worth.as_ref().is_some_and(|worth| worth.saturated > 0.0);
    if control != Control::Plain || !clipped {
        return Ok(fit);
    }
    fit_controlled(compiled, view, constants, &fit.parameters, Control::Dropping)
}

fn fit_controlled(
    compiled: &Compiled,
    view: &View,
    constants: &[f64],
    start: &[f64],
    control: Control,
) -> Result<Fit, CompileFailure> {
    let model = compiled.model();
    let parts = parts(model, view, constants, start);
    let mut fit =
        Fit { parameters: start.to_vec(), ending: Ending::SmallStep, stages: Vec::new(), worth: None, choice: None };
    for (index, stage) in model.stages().iter().enumerate() {
        let gradient = compiled.loops(Job::Stage(index), control, &view.layout)?;
        let value = match value_kind(model, stage.method) {
            ValueKind::Full => Job::Report,
            ValueKind::Entry => Job::Value,
        };
        let value = compiled.loops(value, control, &view.layout)?;
        let free = indices(&stage.parameters);
        let count = free.len();
        let mut problem = Kernels {
            compiled,
            view,
            parts: &parts,
            constants,
            gradient,
            value,
            count,
            curvature: curvature(stage.method),
        };
        let rules = Rules {
            free,
            iterations: stage.iterations,
            tolerance: stage.tolerance * tolerance_share(compiled.precision()),
            noise: model.has_noise(),
            precision: compiled.precision(),
            rounding: view.rounding,
            window_pixels: view.window.pixels() as u64,
        };
        let report = stage::run(&mut problem, &rules, &mut fit.parameters);
        fit.ending = report.ending;
        fit.stages.push(report);
        if !fit.ending.is_fit() {
            return Ok(fit);
        }
    }
    let control = if control == Control::Blind { control } else { Control::Dropping };
    let gradient = compiled.loops(Job::Covariance, control, &view.layout)?;
    let value = compiled.loops(Job::Value, control, &view.layout)?;
    let count = compiled.last_parameters().len();
    let mut problem =
        Kernels { compiled, view, parts: &parts, constants, gradient, value, count, curvature: Curvature::GaussNewton };
    match problem.worth(&fit.parameters, control)? {
        Some(worth) => {
            if worth.covariance.is_none() {
                fit.ending = Ending::Singular;
            }
            fit.worth = Some(worth);
        }
        None => fit.ending = Ending::NonFinite,
    }
    Ok(fit)
}

/// The windows to look at for a fit that begins at `start`.
fn parts(model: &Model, view: &View, constants: &[f64], start: &[f64]) -> Vec<Window> {
    let windows = |geometry: Geometry| geometry.windows(model, start, constants, view.window);
    Geometry::of(model, constants).map_or_else(|| vec![view.window], windows)
}

/// By how much F (with noise: minus twice the log-likelihood) is larger at `b` than at `a`, the mean over the pixels of
/// either.
pub(crate) fn difference(
    compiled: &Compiled,
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
        let gradient = value.clone(); // not run
        let curvature = Curvature::GaussNewton;
        let kernels =
            Kernels { compiled, view, parts: &parts, constants, gradient, value: value.clone(), count: 0, curvature };
        let at = |point: &[f64]| kernels.run(&value, point, entry)?.outputs.first().copied();
        let (Some(at_a), Some(at_b)) = (at(a), at(b)) else { return Ok(None) };
        sum += at_b - at_a;
    }
    Ok(Some(0.5 * sum))
}

/// F, gradient and Hessian of a stage at a point, on that point's pixel set; `None` when no kernel could run.
pub(crate) fn quadratic_at(
    compiled: &Compiled,
    view: &View,
    constants: &[f64],
    stage: usize,
    control: Control,
    point: &[f64],
) -> Result<Option<Quadratic>, CompileFailure> {
    let Stage { parameters, method, .. } = &compiled.model().stages()[stage];
    let gradient = compiled.loops(Job::Stage(stage), control, &view.layout)?;
    let bindings = Bindings { parameters: point, entry: point, constants, saturation: &view.limits, shift: &[] };
    let sums = gradient.sums(&bindings, &view.planes, view.window);
    Ok(sums.and_then(|sums| quadratic(&sums.outputs, parameters.len(), curvature(*method))))
}

/// In f64 a stage ends at a ten-thousandth of its tolerance: who asks for f64 asks for digits.
fn tolerance_share(precision: Precision) -> f64 {
    match precision {
        Precision::F32 => 1.0,
        Precision::F64 => 1e-4,
    }
}

fn indices(parameters: &[ParameterId]) -> Vec<usize> {
    parameters.iter().map(|parameter| parameter.index()).collect()
}

/// Kernels over a view, as something to minimise.
struct Kernels<'a> {
    compiled: &'a Compiled,
    view: &'a View<'a>,
    /// Windows without a common pixel: the view's, or what of it the target can be in.
    parts: &'a [Window],
    constants: &'a [f64],
    gradient: Loops,
    value: Loops,
    /// Free parameters of the gradient kernel.
    count: usize,
    curvature: Curvature,
}

impl Kernels<'_> {
    fn run(&self, loops: &Loops, parameters: &[f64], entry: &[f64]) -> Option<Totals> {
        let bindings =
            Bindings { parameters, entry, constants: self.constants, saturation: &self.view.limits, shift: &[] };
        let (first, others) = self.parts.split_first()?;
        let mut totals = loops.sums(&bindings, &self.view.planes, *first)?;
        for part in others {
            totals.add(loops.sums(&bindings, &self.view.planes, *part)?);
        }
        Some(totals)
    }

    /// The pass that nothing follows.
    fn worth(&mut self, end: &[f64], control: Control) -> Result<Option<Worth>, CompileFailure> {
        let Some(sums) = self.run(&self.gradient, end, end) else { return Ok(None) };
        let Some(quadratic) = quadratic(&sums.outputs, self.count, self.curvature) else { return Ok(None) };
        let (mut objective, mut chi_square) = (quadratic.objective, sums.seen[0]);
        let noise = self.compiled.model().has_noise();
        if noise {
            let report = self.compiled.loops(Job::Report, control, &self.view.layout)?;
            match self.run(&report, end, end).as_ref().map(|sums| (sums.outputs.as_slice(), sums.seen.as_slice())) {
                Some((&[full, _], &[_, chi])) => (objective, chi_square) = (full, chi),
                _ => return Ok(None),
            }
        }
        if !quadratic.is_finite() || !objective.is_finite() {
            return Ok(None);
        }
        let reduced = sums.pixels.checked_sub(self.count as u64).filter(|&n| n > 0).map(|n| chi_square / n as f64);
        let variance = if noise { Some(1.0) } else { reduced };
        let covariance =
            variance.and_then(|variance| Some(inverse_fisher(&quadratic, self.compiled.precision())? * variance));
        let variance_alone = quadratic.hessian.diagonal().map(|entry| variance.unwrap_or(0.0) * 2.0 / entry);
        let met = sums.pixels + sums.saturated;
        let saturated = if met > 0 { sums.saturated as f64 / met as f64 } else { 0.0 };
        Ok(Some(Worth { objective, reduced, pixels: sums.pixels, saturated, covariance, variance_alone }))
    }
}

/// The inverse Fisher information at unit variance, `2 H⁻¹` with H = 2 JᵀWJ: F has no factor ½. `None` when singular.
fn inverse_fisher(quadratic: &Quadratic, precision: Precision) -> Option<DMatrix<f64>> {
    let scale = quadratic.hessian.diagonal().map(|entry| entry.sqrt());
    if !scale.iter().all(|&d| d > 0.0) {
        return None;
    }
    Some(Spectrum::new(quadratic, &scale, stage::eigen_resolution(precision))?.inverse()? * 2.0)
}

/// From a kernel's outputs: F, the gradient, the upper triangle of H by rows.
fn quadratic(outputs: &[f64], n: usize, curvature: Curvature) -> Option<Quadratic> {
    let (&objective, rest) = outputs.split_first()?;
    if rest.len() != n + n * (n + 1) / 2 {
        return None;
    }
    let (gradient, upper) = rest.split_at(n);
    let mut hessian = DMatrix::zeros(n, n);
    let mut entries = upper.iter();
    for i in 0..n {
        for (j, &entry) in (i..n).zip(&mut entries) {
            hessian[(i, j)] = entry;
            hessian[(j, i)] = entry;
        }
    }
    Some(Quadratic { objective, gradient: DVector::from_row_slice(gradient), hessian, curvature })
}

impl Problem for Kernels<'_> {
    fn gradient(&mut self, point: &[f64], entry: &[f64]) -> Option<Pass> {
        let sums = self.run(&self.gradient, point, entry)?;
        Some(Pass { quadratic: quadratic(&sums.outputs, self.count, self.curvature)?, pixels: sums.pixels })
    }

    fn value(&mut self, point: &[f64], entry: &[f64]) -> Option<f64> {
        self.run(&self.value, point, entry)?.outputs.first().copied()
    }

    fn allowed(&self, point: &[f64]) -> bool {
        point.iter().all(|value| value.is_finite()) && self.compiled.model().constraints_hold(point, self.constants)
    }
}
