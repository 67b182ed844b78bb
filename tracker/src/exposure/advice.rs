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

use isophote_jit::Window;
use serde::{Deserialize, Serialize};

use super::goal::{ExposureAdvice, ExposureGoal};
use super::light::{Kernels, channels_as_they_are};
use super::trial::{TrialScene, share, shining, tried, wanted};
use crate::estimate::{Estimate, TrackState};
use crate::outline::{half_widths, sizes};
use crate::sight::grey::{Grey, Mixture};
use crate::solve::exact;
use crate::track::solver::{Look, Solver};
use crate::track::window::Margin;

/// The largest share of the target that may be saturated for the sake of the centre.
const CENTRE_SHARE_MAX: f64 = 0.25;
/// Peaks that are tried, in octaves over the camera's limit: from …
const OCTAVES_MIN: f64 = -3.0;
/// … to …
const OCTAVES_MAX: f64 = 4.0;
/// … in steps of
const OCTAVE_STEP: f64 = 0.25;
/// The same before any target was fitted: an upload is to be answered soon.
const OUTLOOK_STEP: f64 = 0.5;
/// … and where a trial takes more pixels than this: nobody waits for the last percent.
const PIXELS_MANY: usize = 1 << 16;
/// Then the best is refined by so many halvings of the step.
const HALVINGS: usize = 4;
/// Light that saturates such a share of where a target should be hides it, …
const DAZZLED: f64 = 0.5;
/// … and so much of it is tried next.
const LESS: f64 = 0.25;
/// Advice is computed anew when size, or brightness over background, changed by so many e-folds.
const CHANGED: f64 = 0.1;

/// What is best for a target of some looks.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Best {
    /// Of the largest brightness.
    #[serde(with = "exact")]
    height: f64,
    #[serde(with = "exact")]
    share: f64,
    /// ln size, ln (brightness / background) of each target that it is for, ln distance of a pose.
    #[serde(with = "exact")]
    looks: Vec<f64>,
}

/// Advises one session; remembers the advice as long as the target looks the same.
pub(crate) struct Advisor {
    goal: ExposureGoal,
    /// Advice can be given at all.
    is_advisable: bool,
    kernels: Option<Kernels>,
    best: Vec<Option<Best>>,
}

impl Advisor {
    /// For so many targets.
    pub fn new(goal: ExposureGoal, targets: usize, solver: &Solver) -> Advisor {
        Advisor { goal, is_advisable: is_advisable(solver, goal), kernels: None, best: vec![None; targets] }
    }

    /// What it remembers.
    pub fn known(&self) -> Vec<Option<Best>> {
        self.best.clone()
    }

    /// Remembers that, where it is of as many targets.
    pub fn know(&mut self, best: Vec<Option<Best>>) {
        if best.len() == self.best.len() {
            self.best = best;
        }
    }

    /// The best exposure for a target that was just fitted; `None` where the model cannot be advised, or no limit is known.
    pub fn advise(&mut self, solver: &Solver, look: &Look, number: usize, seen: &Estimate) -> Option<ExposureAdvice> {
        let parameters = &seen.parameters;
        let limit = solver.limit(look, parameters).filter(|limit| limit.is_finite() && self.is_advisable)?;
        let height = height(solver, parameters)?;
        let looks = looks(solver, parameters)?;
        let is_alike = |best: &Best| {
            let mut both = best.looks.iter().zip(&looks);
            best.looks.len() == looks.len() && both.all(|(was, is)| (was - is).abs() < CHANGED)
        };
        let known = self.best.get(number)?.clone().filter(is_alike);
        let best = match known {
            Some(best) => best,
            None => {
                if self.kernels.is_none() {
                    self.kernels = Kernels::compile(solver, solver.compiled.precision());
                }
                let kernels = self.kernels.as_ref()?;
                let scene = TrialScene::of(solver, kernels, parameters, look.window)?;
                let is_large = scene.window.pixels() > PIXELS_MANY;
                let step = if is_large { OUTLOOK_STEP } else { OCTAVE_STEP };
                let (factor, share) = best(solver, kernels, self.goal, (parameters, &scene), (limit, step))?;
                let best = Best { height: factor * height, share, looks };
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
    /// Less light, where the target is not seen and what is to be seen in its place is mostly saturated; where nobody knows its
    /// place, all that may be looked at.
    pub fn dazzled(&self, solver: &Solver, look: &Look, missed: &Estimate) -> Option<ExposureAdvice> {
        if !self.is_advisable {
            return None;
        }
        let is_placed = missed.state == TrackState::Coasting;
        let window = if is_placed { solver.window(look, &missed.parameters, Margin::NONE) } else { look.window };
        let view = solver.view(look, window);
        let mixture = Mixture::observed(solver.model(), &solver.constants);
        let saturated = Grey::as_it_is(&view.planes, window, &view.saturation, &mixture).saturated() as f64;
        let pixels = window.pixels() as f64;
        let share = if is_placed { share(solver, &missed.parameters, saturated, pixels) } else { saturated / pixels };
        let why = || format!("no target is seen, and {:.0} % of its place is saturated", 100.0 * share);
        (share >= DAZZLED).then(|| ExposureAdvice { factor: LESS, goal: self.goal, why: why() })
    }
}

/// True where advice can be given at all: the model has a brightness and what the goal asks for, and what it fits is channels as
/// they are.
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

/// Advice for a bright target that is not saturated, before any was fitted, at a made-up place in a window; `None` as for
/// [`Advisor::advise`].
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

/// So many times as much light is best, and saturates that share of the target.
fn best(
    solver: &Solver,
    kernels: &Kernels,
    goal: ExposureGoal,
    (parameters, scene): (&[f64], &TrialScene),
    (limit, octave_step): (f64, f64),
) -> Option<(f64, f64)> {
    let height = height(solver, parameters)?;
    let grounds = solver.model().roles().iter().filter_map(|roles| roles.background);
    let ground = grounds.map(|ground| parameters[ground.index()]).fold(0.0, f64::max);
    let black = solver.options.camera.linear_black();
    // With this much light the peak is at the limit.
    let unit = (limit - black) / (ground - black + height.max(0.0)).max(f64::MIN_POSITIVE);
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

/// ln of each outline's size, where there is one, of each brightness over its background, and of a pose's distance; `None` where
/// nothing shines.
fn looks(solver: &Solver, parameters: &[f64]) -> Option<Vec<f64>> {
    let (model, shining) = (solver.model(), shining(solver.model(), parameters));
    let mut looks = Vec::new();
    for roles in model.roles() {
        let widths = half_widths(roles, model.coordinates().len(), parameters).filter(|_| !roles.shape.is_empty());
        let size = widths.map(|widths| widths.product::<f64>());
        looks.push(size.unwrap_or_else(|| sizes(model, parameters).into_iter().product()).ln());
        let ground = roles.background.map_or(1.0, |background| parameters[background.index()]).abs().max(1.0);
        let brightness = roles.brightness.filter(|brightness| shining.contains(brightness));
        looks.extend(brightness.map(|brightness| (parameters[brightness.index()].abs() / ground).ln()));
        let squares = roles.position.iter().map(|place| parameters[place.index()].powi(2));
        looks.extend((!roles.position.is_empty()).then(|| 0.5 * squares.sum::<f64>().ln()));
    }
    looks.iter().all(|look| look.is_finite()).then_some(looks)
}
