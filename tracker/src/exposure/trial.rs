//! A trial exposure: the Cramér–Rao bound of the goal and the saturated share of the target with `factor` times the light.

use std::f64::consts::PI;

use isophote_jit::Window;
use isophote_symbolic::{Model, ParameterId, Roles};
use nalgebra::DMatrix;

use super::goal::ExposureGoal;
use super::light::{Kernels, PIXELS_MAX, RenderedLight};
use crate::outline::{shape, sizes};
use crate::scaled;
use crate::track::solver::Solver;
use crate::track::window::Margin;

/// A pixel reads as saturated from half a step below the limit.
const HALF_STEP: f64 = 0.5;
/// A target is rendered this far from any edge, px.
const FAR_PX: f64 = 512.0;
/// Largest side of the part of an unbounded domain that is rendered about the target, px.
const SIDE_MAX: usize = 512;
/// A target fainter than this share of the brightest one counts as absent or covered.
const FAINTEST: f64 = 0.05;

/// Result of one trial exposure.
pub(crate) struct Tried {
    /// The bound, a variance.
    pub bound: f64,
    /// The saturated share of the target.
    pub share: f64,
}

/// Where a target is rendered.
pub(crate) struct TrialScene {
    pub window: Window,
    parameters: Vec<f64>,
}

impl TrialScene {
    /// The scene of a target: far from any edge if the model's reach is known, since it may be at the frame's edge,
    /// else where it is.
    pub fn of(solver: &Solver, kernels: &Kernels, parameters: &[f64], frame: Window) -> Option<TrialScene> {
        if solver.reaches() {
            return moved(solver, parameters);
        }
        let domain = kernels.domain(solver, parameters, frame)?;
        let window = if domain.pixels() > SIDE_MAX * SIDE_MAX { cut(solver, parameters, domain) } else { domain };
        Some(TrialScene { window, parameters: parameters.to_vec() })
    }
}

/// Brightness parameters, the brightest target first; faint targets are left out.
pub(crate) fn shining(model: &Model, parameters: &[f64]) -> Vec<ParameterId> {
    let height = |id: &ParameterId| parameters[id.index()].abs();
    let mut all: Vec<ParameterId> = model.roles().iter().filter_map(|roles| roles.brightness).collect();
    all.sort_by(|a, b| height(b).total_cmp(&height(a)));
    all.dedup();
    let least = all.first().map_or(0.0, |first| FAINTEST * height(first));
    all.retain(|id| height(id) >= least);
    all
}

/// Parameters whose variances the goal sums.
pub(crate) fn wanted(model: &Model, goal: ExposureGoal, parameters: &[f64]) -> Vec<ParameterId> {
    match goal {
        ExposureGoal::Centre => {
            let roles = model.roles().iter();
            roles.flat_map(|roles| roles.centre.iter().chain(&roles.position)).copied().collect()
        }
        ExposureGoal::Brightness => shining(model, parameters),
    }
}

/// The bound and the saturated share at `factor` times the light.
pub(crate) fn tried(
    solver: &Solver,
    kernels: &Kernels,
    goal: ExposureGoal,
    scene: &TrialScene,
    factor: f64,
    limit: f64,
) -> Option<Tried> {
    let model = solver.model();
    let parameters = brighter(solver, &scene.parameters, factor);
    let light = RenderedLight::of(solver, kernels, &parameters, scene.window)?;
    let limit = limit - HALF_STEP;
    let (information, sums) = kernels.information(solver, &parameters, &light, limit)?;
    let saturated = light.pixels().filter(|pixel| f64::from(*pixel) >= limit).count() as f64;
    let share = share(solver, &parameters, saturated, (sums.pixels + sums.saturated) as f64);
    // Without `noise` a pixel's variance is assumed proportional to the light, as shot noise.
    let variance = if model.has_noise() { 1.0 } else { factor };
    let bound = bound(solver, goal, &information, &parameters).map_or(f64::INFINITY, |bound| bound * variance);
    Some(Tried { bound, share })
}

/// The saturated share of the area inside the outline; of the domain without an outline.
pub(crate) fn share(solver: &Solver, parameters: &[f64], saturated: f64, domain: f64) -> f64 {
    let model = solver.model();
    let outline = |roles: &Roles| Some(PI / shape(roles, 2, parameters)?.determinant().sqrt());
    let areas: Option<f64> = match (model.coordinates().len(), &sizes(model, parameters)[..]) {
        (1, [width]) => Some(2.0 * width),
        (2, [width, height]) => Some(PI * width * height),
        (2, _) => model.roles().iter().map(outline).sum(),
        _ => None,
    };
    (saturated / areas.unwrap_or(domain).max(1.0)).min(1.0)
}

/// The summed variances of the positions, or of the relative brightnesses; `None` when singular.
fn bound(solver: &Solver, goal: ExposureGoal, information: &DMatrix<f64>, parameters: &[f64]) -> Option<f64> {
    let inverse = scaled::inverse(information)?;
    let order = solver.compiled.last_parameters();
    let variance = |parameter: ParameterId| {
        let i = order.iter().position(|&p| p == parameter)?;
        let unit = if goal == ExposureGoal::Brightness { parameters[parameter.index()] } else { 1.0 };
        Some(inverse[(i, i)] / (unit * unit))
    };
    let wanted = wanted(solver.model(), goal, parameters);
    wanted.into_iter().map(variance).sum::<Option<f64>>().filter(|bound| *bound > 0.0)
}

/// Parameters at `factor` times the light: brightness, and background above black.
fn brighter(solver: &Solver, parameters: &[f64], factor: f64) -> Vec<f64> {
    let mut parameters = parameters.to_vec();
    let black = solver.options.camera.linear_black();
    let mut grounds = Vec::new();
    for roles in solver.model().roles() {
        if let Some(brightness) = roles.brightness {
            parameters[brightness.index()] *= factor;
        }
        grounds.extend(roles.background);
    }
    grounds.sort();
    grounds.dedup(); // targets may share one
    for ground in grounds {
        parameters[ground.index()] = black + factor * (parameters[ground.index()] - black);
    }
    parameters
}

/// Moves the domain's window and the parameters to the corner.
fn moved(solver: &Solver, parameters: &[f64]) -> Option<TrialScene> {
    let far = Window::of_size([1 << 20, 1 << 20, 1 << 10, 1 << 10]);
    let mut parameters = parameters.to_vec();
    for parameter in solver.model().roles().iter().flat_map(|roles| &roles.centre) {
        parameters[parameter.index()] += FAR_PX;
    }
    let window = solver.reach_window(&parameters, Margin::NONE, far)?;
    let first = window.first();
    for roles in solver.model().roles() {
        for (axis, parameter) in roles.centre.iter().enumerate() {
            parameters[parameter.index()] -= first[axis] as f64;
        }
    }
    let n = solver.model().coordinates().len();
    let size: [usize; 4] = std::array::from_fn(|axis| if axis < n { window.size()[axis] } else { 1 });
    let pixels = size.iter().try_fold(1usize, |pixels, side| pixels.checked_mul(*side))?;
    (pixels <= PIXELS_MAX).then(|| TrialScene { window: Window::of_size(size), parameters })
}

/// The part of a window around the first target.
fn cut(solver: &Solver, parameters: &[f64], window: Window) -> Window {
    let centre = solver.model().roles().first().map(|roles| &roles.centre[..]).unwrap_or_default();
    let along = |axis: usize, first: usize, count: usize| {
        let side = count.min(SIDE_MAX);
        let middle = centre.get(axis).map_or((first + count / 2) as f64, |id| parameters[id.index()]);
        let first_edge = (middle - 0.5 * side as f64).max(0.0) as usize;
        (first_edge.clamp(first, first + count - side), side)
    };
    let ((x, width), (y, height)) = (along(0, window.x, window.width), along(1, window.y, window.height));
    Window { x, y, width, height, ..window }
}
