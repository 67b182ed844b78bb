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

use serde::{Deserialize, Serialize};

use super::goal::{ExposureAdvice, ExposureGoal};
use super::trial::{Kernels, share, tried};
use crate::estimate::Estimate;
use crate::sight::grey::Mixture;
use crate::solve::exact;
use crate::track::solver::{Look, Solver};

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
/// Then the best is refined by so many halvings of the step.
const HALVINGS: usize = 4;
/// Advice is computed anew when size, or brightness over background, changed by so many e-folds.
const CHANGED: f64 = 0.1;

/// What is best for a target of some looks.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct Best {
    /// Of the brightness parameter.
    #[serde(with = "exact")]
    height: f64,
    #[serde(with = "exact")]
    share: f64,
    /// ln size and ln (brightness / background) that it is for.
    #[serde(with = "exact")]
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

impl Advisor {
    /// For so many targets.
    pub fn new(goal: ExposureGoal, targets: usize, solver: &Solver) -> Advisor {
        Advisor { goal, is_plain: is_plain(solver), kernels: None, best: vec![None; targets] }
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

    /// The best exposure for a target that was just fitted; `None` where the model has no brightness or mixes channels, or
    /// no limit is known.
    pub fn advise(&mut self, solver: &Solver, look: &Look, number: usize, seen: &Estimate) -> Option<ExposureAdvice> {
        let limit = solver.limit(look, &seen.parameters).filter(|limit| limit.is_finite() && self.is_plain)?;
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
        advice(self.goal, factor, now, best.share)
    }

    fn search(&mut self, solver: &Solver, parameters: &[f64], looks: [f64; 2], limit: f64) -> Option<Best> {
        if self.kernels.is_none() {
            self.kernels = Kernels::compile(solver, solver.compiled.precision());
        }
        let height = parameters[solver.model().roles().first()?.brightness?.index()];
        let (factor, share) = best(solver, self.kernels.as_ref()?, self.goal, parameters, (limit, OCTAVE_STEP))?;
        Some(Best { height: factor * height, share, looks })
    }
}

/// True where advice can be given at all: the model has a brightness, and what it fits is a channel as it is.
pub(crate) fn is_advisable(solver: &Solver) -> bool {
    let model = solver.model();
    model.roles().first().is_some_and(|roles| roles.brightness.is_some()) && is_plain(solver) && !model.needs_a_frame()
}

/// What is fitted is a channel as it is.
fn is_plain(solver: &Solver) -> bool {
    let mixture = Mixture::observed(solver.model(), &solver.constants);
    mixture.weights == [1.0] && mixture.constant == 0.0
}

/// Advice for a bright target that is not saturated, before any was fitted; `None` as for [`Advisor::advise`].
pub(crate) fn outlook(
    solver: &Solver,
    kernels: &Kernels,
    goal: ExposureGoal,
    parameters: &[f64],
    limit: f64,
) -> Option<ExposureAdvice> {
    let brightness = solver.model().roles().first()?.brightness?;
    if !is_plain(solver) || parameters[brightness.index()] <= 0.0 {
        return None;
    }
    let (factor, share) = best(solver, kernels, goal, parameters, (limit, OUTLOOK_STEP))?;
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
    parameters: &[f64],
    (limit, octave_step): (f64, f64),
) -> Option<(f64, f64)> {
    let roles = solver.model().roles().first()?;
    let value = |index: usize| parameters[index];
    let height = value(roles.brightness?.index());
    let ground = roles.background.map_or(0.0, |background| value(background.index()));
    let black = solver.options.camera.linear_black();
    // With this much light the peak is at the limit.
    let unit = (limit - black) / (ground - black + height.max(0.0)).max(f64::MIN_POSITIVE);
    let try_at = |octaves: f64| {
        let factor = unit * octaves.exp2();
        let tried = tried(solver, kernels, goal, parameters, factor, limit)?;
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

/// ln of the outline's size, 0 without one, and ln of brightness over background.
fn looks(solver: &Solver, parameters: &[f64]) -> Option<[f64; 2]> {
    let (size, brightness) = solver.looks(parameters);
    let ground = solver.model().roles().first()?.background.map_or(1.0, |background| parameters[background.index()]);
    Some([size.unwrap_or(0.0), brightness? - ground.abs().max(1.0).ln()])
}
