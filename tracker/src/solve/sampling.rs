//! `Sampling`: how finely predictions are averaged over a pixel's area, chosen for a fit and no finer than it needs, for
//! models whose document says `quadrature = "auto"`.
//!
//! What comes in: a view, and a start that is nearly right. What goes out: a fit, and the choice, which the next one goes on
//! with. It never knows earlier frames.
//!
//! The mean over a pixel by n × n Gauss points costs n² predictions. So it is worked out once, at the start, and what it has
//! beyond a coarse one is a plane of numbers that is added to that in every pass, `I(u) + [Iₙ − I](start)`. The gradient of
//! this F is exact, and at the minimum, where the start was, the prediction is the fine one. What the plane's own slope would
//! have added shrinks with the way from there; where that is long, the plane is made anew. Where it is not it serves the next
//! frames, too, and in any case their first pass, whose step need not be better than the prediction that it begins at.

use std::sync::Arc;

use isophote_jit::Window;
use isophote_symbolic::{Quadrature, Slopes, Summand};
use serde::{Deserialize, Serialize};

use crate::estimate::{Sampled, StageReport};
use crate::scaled::Definite;
use crate::sight::view::View;
use crate::solve::corrections::{Corrections, Planes, less, roomy};
use crate::solve::exact;
use crate::solve::fit::{Fit, cut_short, fit_controlled, followed, pass_at, way_of};
use crate::solve::follow::Tether;
use crate::solve::means::{self, MeanKernels};
use crate::solve::stage::Pass;
use crate::solve::stage::{Arrival, Stride};
use crate::solve::stage_kernels::{Begins, CompileFailure, Control, StageKernels};
use crate::solve::workers::InTurn;

/// A choice may shift the minimum by so many standard deviations, `√(bᵀC⁻¹b)` with b the shift.
const BIAS: f64 = 0.1;
/// Fewer points than before are chosen where it would be no more than this.
const BIAS_COARSER: f64 = 0.05;
/// Derivatives at the pixel's centre do where their Fisher information differs by no more than this share from that of
/// means. The variance that they lose is of the order of its square.
const INFORMATION: f64 = 0.08;
/// They are gone back to at this.
const INFORMATION_COARSER: f64 = 0.05;
/// What is left of a plane that is not made anew, in standard deviations.
const LEFT: f64 = 0.05;
/// A choice holds until a parameter's information has changed by this share.
const CHANGED: f64 = 0.2;
/// Predictions that cost what a pixel of a pass does.
const POINTS_A_PASS: usize = 4;
/// By how many times this may be more for derivatives of means, of which it is not known but concluded.
const CONCLUDED: f64 = 2.5;
/// What is left after so many planes, of a rim so sharp that no step leads closer, …
const PATIENT: usize = 6;
/// … in standard deviations, …
const LEFT_SHARP: f64 = 0.5;
/// … and in the last round, where steps go to and fro between two places and neither leads nearer.
const LEFT_LAST: f64 = 2.0;
/// Fits until a choice and its plane suit.
const ROUNDS: usize = 10;
const LAST: usize = ROUNDS - 1;
/// Steps from plane to plane that do not shrink by this factor go to and fro around where the next plane is made then.
const SHRINKING: f64 = 0.6;

/// How a fit samples, and what that was chosen for.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Chosen {
    pub sampled: Sampled,
    /// Of each free parameter, if all others were known: 1/variance. Empty before the first fit.
    #[serde(with = "exact")]
    information: Vec<f64>,
    /// By this share of a step the plane would have followed.
    #[serde(with = "exact")]
    lag: f64,
    /// The last prediction was too far off for a plane made there.
    #[serde(default)]
    is_strained: bool,
    /// What the last fit went on with.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    corrections: Option<Corrections>,
}

impl Chosen {
    /// Whether it can be of a model with so many parameters.
    pub fn suits(&self, parameters: usize) -> bool {
        let Sampled { points, slopes } = self.sampled;
        means::levels(2).contains(&points)
            && (1..=2).contains(&slopes)
            && self.corrections.as_ref().is_none_or(|corrections| corrections.at.len() == parameters)
    }
}

/// How a fit goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    /// The short way or not at all: from where a target is predicted to be.
    Short,
    /// As it has to: from where another fit has ended.
    Any,
}

/// A part of it, with one plane of corrections.
#[derive(Clone, Copy, Debug)]
struct Leg {
    /// The step that led to its start, …
    before: Option<Stride>,
    /// … and whether it went back on the one before.
    is_to_and_fro: bool,
    way: Way,
}

/// A model's kernels with corrections, and its pictures; its default cannot fit.
#[derive(Default)]
pub(crate) struct Sampling {
    kernels: Option<Kernels>,
}

struct Kernels {
    /// By where their slopes are taken.
    centre: StageKernels,
    mean: StageKernels,
    entries: Vec<MeanKernels>,
    /// Points a side, from one on.
    levels: Vec<u32>,
}

impl Sampling {
    /// Derives what is needed; kernels follow. Nothing for models that say how they sample, for those whose fits take the long
    /// way in any case, and where it is too much.
    pub fn new(base: &StageKernels) -> Sampling {
        Sampling { kernels: Sampling::applies(base).then(|| Kernels::new(base).ok()).flatten() }
    }

    /// True for models that leave their quadrature open, and whose fits may take the short way.
    pub fn applies(base: &StageKernels) -> bool {
        base.model().quadrature() == Quadrature::Auto && base.short_stage().is_some()
    }

    /// True where there is nothing to fit with.
    pub fn is_empty(&self) -> bool {
        self.kernels.is_none()
    }

    /// All that has kernels to be compiled for pixels.
    pub fn compiled(&self) -> impl Iterator<Item = &StageKernels> {
        self.kernels.iter().flat_map(|kernels| [&kernels.centre, &kernels.mean])
    }

    /// Compiles what corrections of all finenesses need, as long as `keeps_going` says so.
    ///
    /// # Errors
    /// When a kernel cannot be made.
    pub fn warm(&self, keeps_going: &dyn Fn() -> bool) -> Result<(), CompileFailure> {
        let Some(kernels) = &self.kernels else { return Ok(()) };
        let levels = || kernels.levels.iter().filter(|points| **points > 1);
        let all = kernels.entries.iter().flat_map(|entry| levels().map(move |points| (entry, *points)));
        all.take_while(|_| keeps_going()).try_for_each(|(entry, points)| entry.kernel(points).map(drop))
    }

    /// The fit from a start that is nearly right, by the choice of a fit before it; `None` where the start was not, or where
    /// there is no choice. `domain`: all that the short way from a point can look at.
    pub fn fit(
        &self,
        view: &View,
        domain: &dyn Fn(&[f64]) -> Window,
        constants: &[f64],
        start: &[f64],
        before: Option<&Chosen>,
        way: Way,
    ) -> Result<Option<Fit>, CompileFailure> {
        let Some(kernels) = &self.kernels else { return Ok(None) };
        let mut chosen = match before {
            Some(before) => before.clone(),
            None => match kernels.choose(view, constants, start, None)? {
                Some(chosen) => chosen,
                None => return Ok(None),
            },
        };
        let mut from = start.to_vec();
        let mut strained = false;
        let mut earlier: Option<StageReport> = None;
        let (mut leg, mut last) = (Leg { before: None, is_to_and_fro: false, way }, None);
        for round in 0..ROUNDS {
            let narrow = if leg.way == Way::Short { Some(view.narrowed(domain(&from))) } else { None };
            let seen = narrow.as_ref().unwrap_or(view);
            let room = roomy(seen.window, view.window);
            let kept = chosen.corrections.take().filter(|made| made.serves(chosen.sampled, seen.window));
            // Where a plane at the prediction would be right, one that is not costs a pass.
            let kept = kept.filter(|made| chosen.is_strained || kernels.is_near(&chosen, &made.at, &from));
            let made = match kept {
                None => kernels.made(seen, room, constants, &from, chosen.sampled)?,
                kept => kept,
            };
            let arrival = match &made {
                Some(made) => {
                    let left = match round {
                        ..PATIENT => LEFT,
                        LAST if leg.is_to_and_fro => LEFT_LAST,
                        _ => LEFT_SHARP,
                    };
                    kernels.fit(seen, made, constants, &from, left / chosen.lag, leg)?
                }
                None => Arrival::Lost,
            };
            let found = match arrival {
                Arrival::There(fit) => fit,
                Arrival::Far { parameters, stride, report } => {
                    if earlier.is_none() {
                        strained = stride.length.is_none_or(|length| chosen.lag * length > LEFT);
                    }
                    earlier = Some(earlier.map_or(report.clone(), |earlier| report.after(&earlier)));
                    let lengths = stride.length.zip(leg.before.and_then(|before| before.length));
                    let is_to_and_fro = lengths.is_some_and(|(now, before)| now > SHRINKING * before);
                    let share = if is_to_and_fro { 0.5 } else { 1.0 };
                    from.iter_mut().zip(parameters).for_each(|(from, to)| *from += share * (to - *from));
                    leg.before = Some(Stride { length: stride.length.map(|length| share * length), ..stride });
                    leg.is_to_and_fro = is_to_and_fro;
                    last = made;
                    continue;
                }
                Arrival::Lost => {
                    let is_cut = |made: &Corrections| view.is_over() && made.serves(chosen.sampled, seen.window);
                    let Some((report, made)) = earlier.zip(last.filter(is_cut)) else { return Ok(None) };
                    let Some(fit) = kernels.cut_short(seen, &made, constants, from, report)? else { return Ok(None) };
                    return Ok(Some(Fit { chosen: Some(Chosen { corrections: Some(made), ..chosen }), ..fit }));
                }
            };
            (chosen.corrections, chosen.is_strained) = (made, strained);
            let mut fit = found;
            if let (Some(earlier), Some(last)) = (earlier.take(), fit.stages.last_mut()) {
                *last = last.clone().after(&earlier);
            }
            if fit.ending.is_unfinished() {
                fit.chosen = Some(chosen);
                return Ok(Some(fit));
            }
            let Some(information) = kernels.information(&fit) else { return Ok(None) };
            let is_changed = |(now, then): (&f64, &f64)| (now / then - 1.0).abs() > CHANGED;
            let fitted = chosen.sampled;
            if information.iter().zip(&chosen.information).any(is_changed) {
                match kernels.choose(view, constants, &fit.parameters, Some(fitted))? {
                    Some(anew) => chosen = Chosen { corrections: chosen.corrections, is_strained: strained, ..anew },
                    None => return Ok(None),
                }
            }
            if chosen.information.is_empty() {
                chosen.information = information;
            }
            if chosen.sampled == fitted {
                fit.chosen = Some(chosen);
                return Ok(Some(fit));
            }
            from.clone_from(&fit.parameters);
            earlier = fit.stages.pop();
            leg = Leg { before: None, is_to_and_fro: false, way: Way::Any };
        }
        Ok(None)
    }
}

impl Kernels {
    fn new(base: &StageKernels) -> Result<Kernels, CompileFailure> {
        let (model, precision, cache) = (base.model(), base.precision(), base.cache());
        let derived = |slopes| {
            let model = Arc::new(model.corrected(slopes));
            StageKernels::new(model, precision, cache.clone(), &InTurn, Begins::Nearby)
                .map(StageKernels::without_predictions)
        };
        let entries = model.summands().into_iter().filter(|summand| !summand.is_clipped);
        let entries = entries.map(|Summand { model, .. }| MeanKernels::new(model, cache)).collect();
        let levels = means::levels(model.coordinates().len());
        Ok(Kernels { centre: derived(Slopes::Centre)?, mean: derived(Slopes::Mean)?, entries, levels })
    }

    fn of(&self, slopes: u32) -> &StageKernels {
        if slopes > 1 { &self.mean } else { &self.centre }
    }

    /// Whether a plane made at one point is likely to be right at another.
    fn is_near(&self, chosen: &Chosen, from: &[f64], to: &[f64]) -> bool {
        let moved =
            self.centre.last_parameters().iter().map(|parameter| to[parameter.index()] - from[parameter.index()]);
        let square: f64 = moved.zip(&chosen.information).map(|(moved, information)| information * moved * moved).sum();
        chosen.lag * square.sqrt() <= LEFT
    }

    /// One fit by one plane of corrections, which holds for so many standard deviations.
    fn fit(
        &self,
        view: &View,
        made: &Corrections,
        constants: &[f64],
        start: &[f64],
        reach: f64,
        leg: Leg,
    ) -> Result<Arrival<Fit>, CompileFailure> {
        let Some(view) = self.corrected(view, made, constants)? else { return Ok(Arrival::Lost) };
        let kernels = self.of(made.sampled.slopes);
        let tether = Tether { from: &made.at, length: reach };
        let followed = followed(kernels, &view, constants, start, leg.before, Some(&tether))?;
        if leg.way == Way::Short || !matches!(followed, Arrival::Lost) {
            return Ok(followed);
        }
        // Steps that go to and fro near the minimum.
        let mut walked = fit_controlled(kernels, &view, constants, start, Control::Dropping)?;
        let Some(far) = way_of(&walked, &made.at, kernels.last_parameters()).filter(|_| walked.ending.is_fit()) else {
            return Ok(Arrival::Lost);
        };
        Ok(match walked.stages.pop() {
            Some(report) if far > tether.length => {
                let stride = Stride { length: Some(far), mean: f64::INFINITY };
                Arrival::Far { parameters: walked.parameters, stride, report }
            }
            report => {
                walked.stages.extend(report);
                Arrival::There(walked)
            }
        })
    }

    /// What a fit that the frame's budget has cut short had come to.
    fn cut_short(
        &self,
        view: &View,
        made: &Corrections,
        constants: &[f64],
        at: Vec<f64>,
        report: StageReport,
    ) -> Result<Option<Fit>, CompileFailure> {
        let Some(view) = self.corrected(view, made, constants)? else { return Ok(None) };
        cut_short(self.of(made.sampled.slopes), &view, constants, at, report).map(Some)
    }

    /// Corrections at a point; `None` where there is no time for them.
    fn made(
        &self,
        view: &View,
        window: Window,
        constants: &[f64],
        at: &[f64],
        sampled: Sampled,
    ) -> Result<Option<Corrections>, CompileFailure> {
        let made = Corrections::of(at, sampled, window);
        let work: usize = made.terms().iter().map(|points| self.work(window, *points)).sum();
        if view.spend(work).is_err() {
            return Ok(None);
        }
        Ok(self.planes(&made, constants)?.is_some().then_some(made))
    }

    /// They cost nothing where they were made before, by a tracker that is gone.
    fn planes<'a>(&self, made: &'a Corrections, constants: &[f64]) -> Result<Option<&'a Planes>, CompileFailure> {
        if made.planes.get().is_none() {
            let [fine, coarse] = made.terms();
            let means = |points| self.means(made.window(), constants, &made.at, points);
            let Some(mut planes) = means(fine)? else { return Ok(None) };
            if coarse > 1 {
                let Some(coarse) = means(coarse)? else { return Ok(None) };
                planes = less(planes, &coarse);
            }
            made.planes.get_or_init(|| planes);
        }
        Ok(made.planes.get())
    }

    fn corrected<'a>(
        &self,
        view: &View<'a>,
        made: &'a Corrections,
        constants: &[f64],
    ) -> Result<Option<View<'a>>, CompileFailure> {
        Ok(self.planes(made, constants)?.and_then(|planes| view.corrected(planes, made.window())))
    }

    /// The coarsest choice that does.
    fn choose(
        &self,
        view: &View,
        constants: &[f64],
        at: &[f64],
        before: Option<Sampled>,
    ) -> Result<Option<Chosen>, CompileFailure> {
        let mut means: Vec<Planes> = Vec::new();
        let mut pass = |slopes: u32, level: usize| -> Result<Option<Pass>, CompileFailure> {
            while means.len() <= level {
                let points = self.levels[means.len()];
                if view.spend(self.work(view.window, points)).is_err() {
                    return Ok(None);
                }
                let Some(finer) = self.means(view.window, constants, at, points)? else { return Ok(None) };
                means.push(finer);
            }
            let fine = means[level].clone();
            let planes = if slopes > 1 { less(fine, &means[slopes as usize - 1]) } else { fine };
            let Some(view) = view.corrected(&planes, view.window) else { return Ok(None) };
            if view.spend(view.window.pixels()).is_err() {
                return Ok(None);
            }
            let kernels = self.of(slopes);
            let Some(stage) = kernels.short_stage() else { return Ok(None) };
            pass_at(kernels, &view, constants, stage, Control::Dropping, at)
        };
        let (Some(first), Some(second)) = (pass(1, 0)?, pass(1, 1)?) else { return Ok(None) };
        let Some(definite) = Definite::of(&second.quadratic.hessian) else { return Ok(None) };
        // With ln σ² in it a pixel's F is that of unit variance; without noise it says the variance itself.
        let deviation = match self.centre.model().has_noise() {
            true => 1.0,
            false => (second.quadratic.objective / second.pixels.max(1) as f64).sqrt(),
        };
        let bias = |coarse: &Pass, fine: &Pass| {
            definite.length(&(&coarse.quadratic.gradient - &fine.quadratic.gradient))
                / (deviation * std::f64::consts::SQRT_2)
        };
        let of_centre = bias(&first, &second);
        let (mut level, mut now, mut shift, mut of_mean) = (0, second, of_centre, of_centre);
        loop {
            let coarser = before.is_some_and(|before| before.points > self.levels[level]);
            if shift <= if coarser { BIAS_COARSER } else { BIAS } {
                break;
            }
            level += 1;
            if level + 1 == self.levels.len() {
                break;
            }
            let Some(finer) = pass(1, level + 1)? else { return Ok(None) };
            shift = bias(&now, &finer);
            if level == 1 {
                of_mean = shift;
            }
            now = finer;
        }
        let Some(mean) = pass(2, level.max(1))? else { return Ok(None) };
        let points = self.levels[level];
        let differs = definite.differs(&mean.quadratic.hessian);
        let coarser = before.is_some_and(|before| before.slopes > 1);
        let is_centre = points == 1 || differs <= if coarser { INFORMATION_COARSER } else { INFORMATION };
        // H is twice JᵀWJ, whose derivatives both lag.
        let lag = 0.5 * differs * if is_centre { 1.0 } else { CONCLUDED * (of_mean / of_centre).min(1.0) };
        let sampled = Sampled { points, slopes: if is_centre { 1 } else { 2 } };
        // Without corrections nothing lags.
        let lag = if sampled.points == sampled.slopes { 0.0 } else { lag };
        Ok(Some(Chosen { sampled, information: Vec::new(), lag, is_strained: false, corrections: None }))
    }

    /// 1/variance of each free parameter, if all others were known; of a residual's variance of 1, where the model does not say
    /// it.
    fn information(&self, fit: &Fit) -> Option<Vec<f64>> {
        let worth = fit.worth.as_ref()?;
        let variance = if self.centre.model().has_noise() { 1.0 } else { worth.reduced? };
        Some(worth.variance_alone.iter().map(|alone| variance / alone).collect())
    }

    /// What means by so many points a side have beyond the pixels' centres; `None` where they cannot be made.
    fn means(
        &self,
        window: Window,
        constants: &[f64],
        at: &[f64],
        points: u32,
    ) -> Result<Option<Planes>, CompileFailure> {
        let mut planes = Vec::new();
        for entry in &self.entries {
            let Some(plane) = entry.mean(window, constants, at, points)? else { return Ok(None) };
            planes.push(plane);
        }
        Ok(Some(planes))
    }

    /// What they cost.
    fn work(&self, window: Window, points: u32) -> usize {
        let all = points.pow(self.centre.model().coordinates().len() as u32) as usize;
        if points > 1 { self.entries.len() * all * window.pixels() / POINTS_A_PASS } else { 0 }
    }
}
