//! Advice: the exposure with the least Cramér–Rao bound of the goal.
//!
//! What comes in: a model, the fitted parameters, the camera's limit. What goes out: the height of the target that would be
//! best, and the share of it that would be saturated. It never looks at a frame: the fitted model is rendered with more or
//! less light, pixels at the limit are dropped, and the model's own covariance kernel sums the Fisher information of what is
//! left. So it holds for any document, whatever its profile.
//!
//! With a known profile the bound of the centre goes on falling long after the target is overexposed, because the slopes get
//! steeper. It does so on the strength of an ever thinner rim, and size and brightness are lost on the way; so for the centre
//! at most a quarter of the target may be saturated.

use std::f64::consts::PI;
use std::sync::Arc;

use isophote_jit::{Kernel, KernelOptions, PixelFormat, PlaneView, Window};
use isophote_symbolic::{Bindings, Precision, Roles};
use nalgebra::DMatrix;

use super::{ExposureAdvice, ExposureGoal};
use crate::compiled::{Control, Job, Layout, lowering};
use crate::estimate::Estimate;
use crate::grey::Mixture;
use crate::track::solver::{Look, Solver};
use crate::track::window::{Margin, shape};

/// The largest share of the target that may be saturated for the sake of the centre.
const CENTRE_SHARE_MAX: f64 = 0.25;
/// Peaks that are tried, in octaves over the camera's limit: from …
const OCTAVES_MIN: f64 = -3.0;
/// … to …
const OCTAVES_MAX: f64 = 4.0;
/// … in steps of
const OCTAVE_STEP: f64 = 0.25;
/// Then the best is refined by so many halvings of the step.
const HALVINGS: usize = 4;
/// Advice is computed anew when size, or brightness over background, changed by so many e-folds.
const CHANGED: f64 = 0.1;
/// Pixels of a window that is rendered, at most.
const PIXELS_MAX: usize = 1 << 20;
/// A pixel reads as saturated from half a step below the limit.
const HALF_STEP: f64 = 0.5;

/// What is best for a target of some looks.
#[derive(Clone, Copy, Debug)]
struct Best {
    /// Of the brightness parameter.
    height: f64,
    share: f64,
    /// ln size and ln (brightness / background) that it is for.
    looks: [f64; 2],
}

/// Advises one session; remembers the advice as long as the target looks the same.
pub(crate) struct Advisor {
    goal: ExposureGoal,
    /// What is fitted is a channel as it is.
    is_plain: bool,
    kernels: Option<Kernels>,
    best: Vec<Option<Best>>,
}

struct Kernels {
    render: Arc<Kernel>,
    information: Arc<Kernel>,
}

/// One exposure.
struct Tried {
    bound: f64,
    share: f64,
}

impl Advisor {
    /// For so many targets.
    pub fn new(goal: ExposureGoal, targets: usize, solver: &Solver) -> Advisor {
        let mixture = Mixture::observed(solver.model(), &solver.constants);
        let is_plain = mixture.weights == [1.0] && mixture.constant == 0.0;
        Advisor { goal, is_plain, kernels: None, best: vec![None; targets] }
    }

    /// The best exposure for a target that was just fitted; `None` where the model has no brightness or mixes channels, or
    /// no limit is known.
    pub fn advise(&mut self, solver: &Solver, look: &Look, number: usize, seen: &Estimate) -> Option<ExposureAdvice> {
        let limit = solver.limit(look).filter(|limit| limit.is_finite() && self.is_plain)?;
        let brightness = solver.model().roles().first()?.brightness?;
        let looks = looks(solver, &seen.parameters)?;
        let known = (*self.best.get(number)?)
            .filter(|best| best.looks.iter().zip(looks).all(|(was, is)| (was - is).abs() < CHANGED));
        let best = match known {
            Some(best) => best,
            None => {
                let best = self.search(solver, &seen.parameters, looks, limit)?;
                self.best[number] = Some(best);
                best
            }
        };
        let factor = best.height / seen.parameters[brightness.index()];
        let met = seen.pixels as f64 / (1.0 - seen.saturated).max(f64::EPSILON);
        let now = share(solver, &seen.parameters, met * seen.saturated, met);
        let (goal, [now, then]) = (self.goal, [now, best.share].map(|share| format!("{:.0} %", 100.0 * share)));
        let why = format!("{now} of the target is saturated, {then} would be best for the {}", goal.name());
        (factor > 0.0 && factor.is_finite()).then_some(ExposureAdvice { factor, goal, why })
    }

    fn search(&mut self, solver: &Solver, parameters: &[f64], looks: [f64; 2], limit: f64) -> Option<Best> {
        if self.kernels.is_none() {
            self.kernels = Kernels::compile(solver);
        }
        let kernels = self.kernels.as_ref()?;
        let roles = solver.model().roles().first()?;
        let value = |index: usize| parameters[index];
        let height = value(roles.brightness?.index());
        let ground = roles.background.map_or(0.0, |background| value(background.index()));
        let black = solver.options.camera.black;
        // With this much light the peak is at the limit.
        let unit = (limit - black) / (ground - black + height.max(0.0)).max(f64::MIN_POSITIVE);
        let try_at = |octaves: f64| {
            let factor = unit * octaves.exp2();
            let tried = tried(solver, kernels, self.goal, parameters, factor, limit)?;
            let allowed = self.goal == ExposureGoal::Brightness || tried.share <= CENTRE_SHARE_MAX;
            (allowed && tried.bound.is_finite()).then_some((tried, factor))
        };
        let steps = ((OCTAVES_MAX - OCTAVES_MIN) / OCTAVE_STEP) as usize;
        let coarse = (0..=steps).map(|step| OCTAVES_MIN + OCTAVE_STEP * step as f64);
        let all = coarse.filter_map(|octaves| Some((octaves, try_at(octaves)?)));
        let (mut at, mut best) = all.min_by(|(_, (a, _)), (_, (b, _))| a.bound.total_cmp(&b.bound))?;
        let mut step = OCTAVE_STEP;
        for _ in 0..HALVINGS {
            step *= 0.5;
            for octaves in [at - step, at + step] {
                if let Some(other) = try_at(octaves).filter(|(other, _)| other.bound < best.0.bound) {
                    (at, best) = (octaves, other);
                    break;
                }
            }
        }
        Some(Best { height: best.1 * height, share: best.0.share, looks })
    }
}

impl Kernels {
    fn compile(solver: &Solver) -> Option<Kernels> {
        let program = solver.model().rendering(lowering(Control::Plain)).ok()?;
        let options = KernelOptions { precision: Precision::F32, formats: vec![PixelFormat::F32; program.channels()], packed: true };
        let render = Arc::new(Kernel::compile(&program, &options).ok()?);
        let pixel = [0u8; 4];
        let plane = PlaneView::new(PixelFormat::F32, &pixel, 1, 1, 4, 4).ok()?;
        let information = solver.compiled.kernel(Job::Covariance, Control::Dropping, &Layout::of(&[plane])).ok()?;
        Some(Kernels { render, information })
    }
}

/// ln of the outline's size, 0 without one, and ln of brightness over background.
fn looks(solver: &Solver, parameters: &[f64]) -> Option<[f64; 2]> {
    let (size, brightness) = solver.looks(parameters);
    let ground = solver.model().roles().first()?.background.map_or(1.0, |background| parameters[background.index()]);
    Some([size.unwrap_or(0.0), brightness? - ground.abs().max(1.0).ln()])
}

/// The bound and the saturated share with so many times as much light.
fn tried(
    solver: &Solver,
    kernels: &Kernels,
    goal: ExposureGoal,
    parameters: &[f64],
    factor: f64,
    limit: f64,
) -> Option<Tried> {
    let model = solver.model();
    let (window, parameters) = moved(solver, &brighter(solver, parameters, factor))?;
    let mut pixels = vec![0f32; window.pixels()];
    let saturation = [f64::INFINITY];
    let bindings = |saturation| Bindings {
        parameters: &parameters,
        entry: &parameters,
        constants: &solver.constants,
        saturation,
        shift: &[0.0, 0.0],
    };
    kernels.render.render(&bindings(&saturation), window, &mut pixels).ok()?;
    let bytes: Vec<u8> = pixels.iter().flat_map(|pixel| pixel.to_ne_bytes()).collect();
    let [width, height, depth, length] = window.size();
    let strides = [4, 4 * width, 4 * width * height, 4 * width * height * depth];
    let plane = PlaneView::stack(PixelFormat::F32, &bytes, [width, height, depth, length], strides).ok()?;
    let limit = [limit - HALF_STEP];
    let bindings = Bindings { shift: &[], ..bindings(&limit) };
    let sums = kernels.information.sums(&bindings, &[plane], window).ok()?;
    let order = solver.compiled.last_parameters();
    let n = order.len();
    let upper = sums.outputs.get(1 + n..).filter(|upper| upper.len() == n * (n + 1) / 2)?;
    let mut information = DMatrix::zeros(n, n);
    let mut entries = upper.iter();
    for (i, j) in (0..n).flat_map(|i| (i..n).map(move |j| (i, j))) {
        let entry = 0.5 * entries.next()?;
        information[(i, j)] = entry;
        information[(j, i)] = entry;
    }
    let saturated = pixels.iter().filter(|pixel| f64::from(**pixel) >= limit[0]).count() as f64;
    let share = share(solver, &parameters, saturated, (sums.pixels + sums.saturated) as f64);
    // Without `noise` a pixel's variance is thought to grow with the light, as that of electrons does.
    let variance = if model.has_noise() { 1.0 } else { factor };
    let bound = bound(solver, goal, &information, &parameters).map_or(f64::INFINITY, |bound| bound * variance);
    Some(Tried { bound, share })
}

/// The saturated share of the area inside the outline; of the domain's where there is no outline.
fn share(solver: &Solver, parameters: &[f64], saturated: f64, domain: f64) -> f64 {
    let outline = |roles: &Roles| Some(PI / shape(roles, 2, parameters)?.determinant().sqrt());
    let is_plane = solver.model().coordinates().len() == 2;
    let areas: Option<Vec<f64>> = solver.model().roles().iter().map(outline).collect();
    let area = areas.filter(|_| is_plane).map_or(domain, |areas| areas.iter().sum());
    (saturated / area.max(1.0)).min(1.0)
}

/// The sum of the centres' variances, or the variance of the brightness relative to it; `None` when singular.
fn bound(solver: &Solver, goal: ExposureGoal, information: &DMatrix<f64>, parameters: &[f64]) -> Option<f64> {
    // Scaled to a unit diagonal: parameters differ by many orders of magnitude.
    let scale = information.diagonal().map(|entry| entry.sqrt());
    if !scale.iter().all(|d| *d > 0.0) {
        return None;
    }
    let n = scale.len();
    let scaled = DMatrix::from_fn(n, n, |i, j| information[(i, j)] / (scale[i] * scale[j]));
    let inverse = scaled.cholesky()?.inverse();
    let order = solver.compiled.last_parameters();
    let variance = |parameter| {
        let i = order.iter().position(|&p| p == parameter)?;
        Some(inverse[(i, i)] / (scale[i] * scale[i]))
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
    let black = solver.options.camera.black;
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

/// px.
const FAR_PX: f64 = 512.0;
