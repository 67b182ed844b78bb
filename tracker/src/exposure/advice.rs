//! Advice: the exposure with the least Cramér–Rao bound of the goal.
//!
//! No frame is read: the fitted model is rendered with more or less light, pixels at the limit are dropped, and the
//! model's own covariance kernel sums the Fisher information of the rest. So it holds for any document and profile.
//!
//! With a known profile the bound of the centre keeps falling long after the target is overexposed, because the slopes
//! get steeper. But then it relies on an ever thinner rim, and size and brightness are lost; so for the centre at most
//! a quarter of the target may be saturated.

use isophote_jit::Window;
use serde::{Deserialize, Serialize};

use super::goal::{ExposureAdvice, ExposureGoal};
use super::light::{Kernels, channels_as_they_are};
use super::trial::{TrialScene, share, shining, tried, wanted};
use crate::estimate::{Estimate, TrackState};
use crate::outline::{half_widths, sizes};
use crate::sight::grey::{Grey, Mixture};
use crate::solve::exact;
use crate::track::solver::{FrameContext, Solver};
use crate::track::window::Margin;

/// The largest share of the target that may be saturated for the sake of the centre.
const CENTRE_SHARE_MAX: f64 = 0.25;
/// Lowest trial peak, in octaves over the camera's limit.
const OCTAVES_MIN: f64 = -3.0;
/// Highest trial peak, in octaves over the camera's limit.
const OCTAVES_MAX: f64 = 4.0;
/// Step of the trial peaks, octaves.
const OCTAVE_STEP: f64 = 0.25;
/// Step before any target was fitted, octaves: an upload is to be answered soon.
const OUTLOOK_STEP: f64 = 0.5;
/// Larger trials, in pixels, use [`OUTLOOK_STEP`] too: the last percent does not matter.
const PIXELS_MANY: usize = 1 << 16;
/// Halvings of the step that refine the best trial.
const HALVINGS: usize = 4;
/// A missed target counts as dazzled when this share of it is saturated.
const DAZZLED: f64 = 0.5;
/// Factor of light to try next for a dazzled target.
const LESS: f64 = 0.25;
/// Advice is recomputed when size, or brightness over background, changed by this many e-folds.
const CHANGED: f64 = 0.1;

/// The best exposure for a target of a given appearance.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Best {
    /// The best value of the largest brightness.
    #[serde(with = "exact")]
    height: f64,
    #[serde(with = "exact")]
    share: f64,
    /// The appearance: ln size and ln (brightness / background) of each target, ln distance of a pose.
    #[serde(rename = "looks", with = "exact")]
    appearance: Vec<f64>,
}

/// Advises one session; caches the advice while the target looks the same.
pub(crate) struct Advisor {
    goal: ExposureGoal,
    /// Whether the model and the goal admit advice.
    is_advisable: bool,
    kernels: Option<Kernels>,
    best: Vec<Option<Best>>,
}

impl Advisor {
    /// An advisor for this number of targets.
    pub fn new(goal: ExposureGoal, targets: usize, solver: &Solver) -> Advisor {
        Advisor { goal, is_advisable: is_advisable(solver, goal), kernels: None, best: vec![None; targets] }
    }

    /// The cached advice.
    pub fn known(&self) -> Vec<Option<Best>> {
        self.best.clone()
    }

    /// Restores cached advice of the same number of targets.
    pub fn know(&mut self, best: Vec<Option<Best>>) {
        if best.len() == self.best.len() {
            self.best = best;
        }
    }

    /// The best exposure for a target that was just fitted; `None` when the model admits no advice, or no limit is known.
    pub fn advise(
        &mut self,
        solver: &Solver,
        context: &FrameContext,
        number: usize,
        seen: &Estimate,
    ) -> Option<ExposureAdvice> {
        let parameters = &seen.parameters;
        let limit = solver.limit(context, parameters).filter(|limit| limit.is_finite() && self.is_advisable)?;
        let height = height(solver, parameters)?;
        let appearance = appearance(solver, parameters)?;
        let is_alike = |best: &Best| {
            let mut both = best.appearance.iter().zip(&appearance);
            best.appearance.len() == appearance.len() && both.all(|(was, is)| (was - is).abs() < CHANGED)
        };
        let known = self.best.get(number)?.clone().filter(is_alike);
        let best = match known {
            Some(best) => best,
            None => {
                if self.kernels.is_none() {
                    self.kernels = Kernels::compile(solver, solver.compiled.precision());
                }
                let kernels = self.kernels.as_ref()?;
                let scene = TrialScene::of(solver, kernels, parameters, context.window)?;
                let is_large = scene.window.pixels() > PIXELS_MANY;
                let step = if is_large { OUTLOOK_STEP } else { OCTAVE_STEP };
                let (factor, share) = best(solver, kernels, self.goal, (parameters, &scene), (limit, step))?;
                let best = Best { height: factor * height, share, appearance };
                self.best[number] = Some(best.clone());
                best
            }
        };
        let met = seen.pixels as f64 / (1.0 - seen.saturated).max(f64::EPSILON);
        let now = share(solver, parameters, met * seen.saturated, met);
        advice(self.goal, best.height / height, now, best.share)
    }
}

impl Advisor {
    /// Advises less light when the target is missed and its predicted outline is mostly saturated; without a
    /// prediction, when the whole region of interest is.
    pub fn dazzled(&self, solver: &Solver, context: &FrameContext, missed: &Estimate) -> Option<ExposureAdvice> {
        if !self.is_advisable {
            return None;
        }
        let is_placed = missed.state == TrackState::Coasting;
        let window = if is_placed { solver.window(context, &missed.parameters, Margin::NONE) } else { context.window };
        let view = solver.view(context, window);
        let mixture = Mixture::observed(solver.model(), &solver.constants);
        let saturated = Grey::read_with_nan(&view.planes, window, &view.saturation, &mixture).saturated() as f64;
        let pixels = window.pixels() as f64;
        let share = if is_placed { share(solver, &missed.parameters, saturated, pixels) } else { saturated / pixels };
        let why = || format!("no target is seen, and {:.0} % of its place is saturated", 100.0 * share);
        (share >= DAZZLED).then(|| ExposureAdvice { factor: LESS, goal: self.goal, why: why() })
    }
}

/// True when the model has a brightness and what the goal requires, and its observed values are plain channels.
pub(crate) fn is_advisable(solver: &Solver, goal: ExposureGoal) -> bool {
    let (model, order) = (solver.model(), solver.compiled.last_parameters());
    let none = vec![0.0; model.parameters().len()];
    let wanted = wanted(model, goal, &none);
    !shining(model, &none).is_empty()
        && !wanted.is_empty()
        && wanted.iter().all(|parameter| order.contains(parameter))
        && channels_as_they_are(model, &solver.constants).is_some()
        && !model.needs_a_frame()
}

/// Advice before any fit, for a bright unsaturated target at a synthetic point; `None` as for [`Advisor::advise`].
pub(crate) fn outlook(
    solver: &Solver,
    kernels: &Kernels,
    goal: ExposureGoal,
    (parameters, window): (&[f64], Window),
    limit: f64,
) -> Option<ExposureAdvice> {
    if !is_advisable(solver, goal) || height(solver, parameters)? <= 0.0 {
        return None;
    }
    let scene = TrialScene::of(solver, kernels, parameters, window)?;
    let (factor, share) = best(solver, kernels, goal, (parameters, &scene), (limit, OUTLOOK_STEP))?;
    advice(goal, factor, 0.0, share)
}

fn advice(goal: ExposureGoal, factor: f64, now: f64, then: f64) -> Option<ExposureAdvice> {
    let [now, then] = [now, then].map(|share| format!("{:.0} %", 100.0 * share));
    let why = format!("{now} of the target is saturated, {then} would be best for the {}", goal.name());
    (factor > 0.0 && factor.is_finite()).then_some(ExposureAdvice { factor, goal, why })
}

/// The best factor of light, and the share of the target that it saturates.
fn best(
    solver: &Solver,
    kernels: &Kernels,
    goal: ExposureGoal,
    (parameters, scene): (&[f64], &TrialScene),
    (limit, octave_step): (f64, f64),
) -> Option<(f64, f64)> {
    let height = height(solver, parameters)?;
    let backgrounds = solver.model().roles().iter().filter_map(|roles| roles.background);
    let background = backgrounds.map(|background| parameters[background.index()]).fold(0.0, f64::max);
    let black = solver.options.camera.linear_black();
    // The factor that puts the peak at the limit.
    let unit = (limit - black) / (background - black + height.max(0.0)).max(f64::MIN_POSITIVE);
    let try_at = |octaves: f64| {
        let factor = unit * octaves.exp2();
        let tried = tried(solver, kernels, goal, scene, factor, limit)?;
        let allowed = goal == ExposureGoal::Brightness || tried.share <= CENTRE_SHARE_MAX;
        (allowed && tried.bound.is_finite()).then_some((tried, factor))
    };
    let steps = ((OCTAVES_MAX - OCTAVES_MIN) / octave_step) as usize;
    let coarse = (0..=steps).map(|step| OCTAVES_MIN + octave_step * step as f64);
    let all = coarse.filter_map(|octaves| Some((octaves, try_at(octaves)?)));
    let (mut at, mut best) = all.min_by(|(_, (a, _)), (_, (b, _))| a.bound.total_cmp(&b.bound))?;
    let mut step = octave_step;
    for _ in 0..HALVINGS {
        step *= 0.5;
        for octaves in [at - step, at + step] {
            if let Some(other) = try_at(octaves).filter(|(other, _)| other.bound < best.0.bound) {
                (at, best) = (octaves, other);
                break;
            }
        }
    }
    Some((best.1, best.0.share))
}

/// The largest brightness.
fn height(solver: &Solver, parameters: &[f64]) -> Option<f64> {
    shining(solver.model(), parameters).first().map(|parameter| parameters[parameter.index()])
}

/// The appearance of the targets: ln of each outline's size, of each brightness over its background, and of a pose's
/// distance; `None` when no target is bright.
fn appearance(solver: &Solver, parameters: &[f64]) -> Option<Vec<f64>> {
    let (model, shining) = (solver.model(), shining(solver.model(), parameters));
    let mut appearance = Vec::new();
    for roles in model.roles() {
        let widths = half_widths(roles, model.coordinates().len(), parameters).filter(|_| !roles.shape.is_empty());
        let size = widths.map(|widths| widths.product::<f64>());
        appearance.push(size.unwrap_or_else(|| sizes(model, parameters).into_iter().product()).ln());
        let background = roles.background.map_or(1.0, |background| parameters[background.index()]).abs().max(1.0);
        let brightness = roles.brightness.filter(|brightness| shining.contains(brightness));
        appearance.extend(brightness.map(|brightness| (parameters[brightness.index()].abs() / background).ln()));
        let squares = roles.position.iter().map(|place| parameters[place.index()].powi(2));
        appearance.extend((!roles.position.is_empty()).then(|| 0.5 * squares.sum::<f64>().ln()));
    }
    appearance.iter().all(|value| value.is_finite()).then_some(appearance)
}
