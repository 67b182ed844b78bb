//! A trial: what a target would tell with more or less light.
//!
//! What comes in: fitted parameters and a factor. What goes out: the Cramér–Rao bound of the goal, and the share of the target
//! that would be saturated.

use std::f64::consts::PI;
use std::sync::Arc;

use isophote_jit::{Kernel, KernelOptions, PixelFormat, PlaneView, VectorWidth, Window};
use isophote_symbolic::{Bindings, Precision, Prediction, Roles};
use nalgebra::DMatrix;

use super::goal::ExposureGoal;
use crate::scaled;
use crate::sight::view::PlaneLayout;
use crate::solve::loops::{Loops, Totals};
use crate::solve::stage_kernels::{Control, Job, lowering};
use crate::track::solver::Solver;
use crate::track::window::{Margin, shape};

/// Pixels of a window that is rendered, at most.
const PIXELS_MAX: usize = 1 << 20;
/// A pixel reads as saturated from half a step below the limit.
const HALF_STEP: f64 = 0.5;
/// A target is rendered this far from any edge, px.
const FAR_PX: f64 = 512.0;

/// What renders the model, and what sums its information.
pub(crate) struct Kernels {
    render: Arc<Kernel>,
    information: Loops,
}

/// One exposure.
pub(crate) struct Tried {
    /// A variance.
    pub bound: f64,
    /// Of the target.
    pub share: f64,
}

/// A rendered picture: all that lies before the window as well.
pub(crate) struct RenderedLight {
    pixels: Vec<f32>,
    bytes: Vec<u8>,
    sides: [usize; 4],
    window: Window,
}

impl RenderedLight {
    /// The model's picture, up to where the window ends. `None` for one that is too large, or that only a frame could tell.
    pub fn of(solver: &Solver, kernels: &Kernels, parameters: &[f64], window: Window) -> Option<RenderedLight> {
        let sides: [usize; 4] = std::array::from_fn(|axis| window.first()[axis] + window.size()[axis]);
        let count = sides.iter().try_fold(1usize, |count, side| count.checked_mul(*side))?;
        if count > PIXELS_MAX {
            return None;
        }
        let mut pixels = vec![0f32; count];
        let bindings = bindings(solver, parameters, &[f64::INFINITY], &[0.0; 4]);
        kernels.render.render(&bindings, Window::of_size(sides), &mut pixels).ok()?;
        let bytes = pixels.iter().flat_map(|pixel| if pixel.is_nan() { [0; 4] } else { pixel.to_ne_bytes() }).collect();
        Some(RenderedLight { pixels, bytes, sides, window })
    }

    /// Pixel values, row by row; NaN outside of the domain.
    pub fn pixels(&self) -> &[f32] {
        &self.pixels
    }

    fn plane(&self) -> Option<PlaneView<'_>> {
        let [width, height, depth, _] = self.sides;
        let strides = [4, 4 * width, 4 * width * height, 4 * width * height * depth];
        PlaneView::stack(PixelFormat::F32, &self.bytes, self.sides, strides).ok()
    }
}

fn bindings<'a>(solver: &'a Solver, parameters: &'a [f64], saturation: &'a [f64], shift: &'a [f64]) -> Bindings<'a> {
    Bindings { parameters, entry: parameters, constants: &solver.constants, saturation, shift }
}

impl Kernels {
    /// Sums in the given arithmetic. `None` where a kernel cannot be made, or the prediction reads a frame.
    pub fn compile(solver: &Solver, precision: Precision) -> Option<Kernels> {
        if solver.model().needs_a_frame() {
            return None;
        }
        let program = solver.model().prediction(Prediction::Intensity, lowering(Control::Plain))?.ok()?;
        let options = KernelOptions {
            width: VectorWidth::Bits128,
            precision: Precision::F32,
            formats: vec![PixelFormat::F32; program.channels()],
            packed: true,
        };
        let render = Arc::new(Kernel::compile(&program, &options).ok()?);
        let pixel = [0u8; 4];
        let plane = PlaneView::new(PixelFormat::F32, &pixel, 1, 1, 4, 4).ok()?;
        let layout = PlaneLayout::of(&vec![plane; solver.model().channels().len()]);
        let information = solver.compiled.loops_in(precision, Job::Covariance, Control::Dropping, &layout).ok()?;
        Some(Kernels { render, information })
    }

    /// The Fisher information about the parameters of the last stage with pixels at the limit left out or censored, as the
    /// model says, and what was summed. Every channel sees the same picture.
    pub fn information(
        &self,
        solver: &Solver,
        parameters: &[f64],
        light: &RenderedLight,
        limit: f64,
    ) -> Option<(DMatrix<f64>, Totals)> {
        let channels = solver.model().channels().len();
        let limits = vec![limit; channels];
        let bindings = bindings(solver, parameters, &limits, &[]);
        let mut sums = Totals::default();
        self.information.sums(&bindings, &vec![light.plane()?; channels], &[light.window], &[], &[], &mut sums)?;
        let n = solver.compiled.last_parameters().len();
        let upper = sums.outputs.get(1 + n..).filter(|upper| upper.len() == n * (n + 1) / 2)?;
        let mut information = DMatrix::zeros(n, n);
        let mut entries = upper.iter();
        for (i, j) in (0..n).flat_map(|i| (i..n).map(move |j| (i, j))) {
            let entry = 0.5 * entries.next()?;
            information[(i, j)] = entry;
            information[(j, i)] = entry;
        }
        Some((information, sums))
    }
}

/// The bound and the saturated share with so many times as much light.
pub(crate) fn tried(
    solver: &Solver,
    kernels: &Kernels,
    goal: ExposureGoal,
    parameters: &[f64],
    factor: f64,
    limit: f64,
) -> Option<Tried> {
    let model = solver.model();
    let (window, parameters) = moved(solver, &brighter(solver, parameters, factor))?;
    let light = RenderedLight::of(solver, kernels, &parameters, window)?;
    let limit = limit - HALF_STEP;
    let (information, sums) = kernels.information(solver, &parameters, &light, limit)?;
    let saturated = light.pixels().iter().filter(|pixel| f64::from(**pixel) >= limit).count() as f64;
    let share = share(solver, &parameters, saturated, (sums.pixels + sums.saturated) as f64);
    // Without `noise` a pixel's variance is thought to grow with the light, as that of electrons does.
    let variance = if model.has_noise() { 1.0 } else { factor };
    let bound = bound(solver, goal, &information, &parameters).map_or(f64::INFINITY, |bound| bound * variance);
    Some(Tried { bound, share })
}

/// The saturated share of the area inside the outline; of the domain's where there is no outline.
pub(crate) fn share(solver: &Solver, parameters: &[f64], saturated: f64, domain: f64) -> f64 {
    let outline = |roles: &Roles| Some(PI / shape(roles, 2, parameters)?.determinant().sqrt());
    let is_plane = solver.model().coordinates().len() == 2;
    let areas: Option<Vec<f64>> = solver.model().roles().iter().map(outline).collect();
    let area = areas.filter(|_| is_plane).map_or(domain, |areas| areas.iter().sum());
    (saturated / area.max(1.0)).min(1.0)
}

/// The sum of the centres' variances, or the variance of the brightness relative to it; `None` when singular.
fn bound(solver: &Solver, goal: ExposureGoal, information: &DMatrix<f64>, parameters: &[f64]) -> Option<f64> {
    let inverse = scaled::inverse(information)?;
    let order = solver.compiled.last_parameters();
    let variance = |parameter| {
        let i = order.iter().position(|&p| p == parameter)?;
        Some(inverse[(i, i)])
    };
    let roles = solver.model().roles();
    match goal {
        ExposureGoal::Centre => {
            let centres: Option<Vec<f64>> = roles.iter().flat_map(|r| &r.centre).map(|p| variance(*p)).collect();
            centres.filter(|centres| !centres.is_empty()).map(|centres| centres.iter().sum())
        }
        ExposureGoal::Brightness => {
            let parameter = roles.first()?.brightness?;
            Some(variance(parameter)? / parameters[parameter.index()].powi(2))
        }
    }
}

/// The parameters with more light: brightness and what the background is above black.
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

/// The window of the domain, moved to the corner, and the parameters with it.
fn moved(solver: &Solver, parameters: &[f64]) -> Option<(Window, Vec<f64>)> {
    let far = Window::of_size([1 << 20, 1 << 20, 1 << 10, 1 << 10]);
    let mut parameters = parameters.to_vec();
    // The target may stand at the frame's edge: it is rendered in the middle of nowhere.
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
    (solver.reaches() && pixels <= PIXELS_MAX).then(|| (Window::of_size(size), parameters))
}
