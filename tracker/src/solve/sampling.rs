//! `Sampling`: chooses, for models with `quadrature = "auto"`, the coarsest averaging over a pixel's area that suffices for
//! a fit; the next fit reuses the choice.
//!
//! The mean over a pixel by n × n Gauss points costs n² predictions. So its difference to a coarse mean is computed once,
//! at the start, and this plane is added to the coarse prediction in every pass, `I(u) + [Iₙ − I](start)`. The gradient of
//! this F is exact, and the prediction is the fine one if the minimum is at the start. The neglected slope of the plane
//! matters less the shorter the way from there; after a long way the plane is recomputed. A plane that needs no recomputing
//! serves the next frames, too; any plane serves their first pass, whose step need not be better than the prediction that
//! it starts from.

use std::sync::Arc;

use isophote_jit::Window;
use isophote_symbolic::{Quadrature, Slopes};
use serde::{Deserialize, Serialize};

use crate::estimate::{Sampled, StageReport};
use crate::scaled::Definite;
use crate::sight::view::View;
use crate::solve::corrections::{Corrections, Planes, less, with_margin};
use crate::solve::exact;
use crate::solve::fit::{Fit, cut_short, distance_from_start, fit_controlled, pass_at, refined};
use crate::solve::means::{self, MeanKernels};
use crate::solve::refine::DistanceLimit;
use crate::solve::stage::Pass;
use crate::solve::stage::{PreviousStep, RefineOutcome};
use crate::solve::stage_kernels::{CompileFailure, FitStarts, PixelHandling, StageKernels};
use crate::solve::workers::InTurn;

/// Largest shift of the minimum by a choice, in standard deviations: `√(bᵀC⁻¹b)` with b the shift.
const BIAS: f64 = 0.1;
/// The same limit for choosing fewer points than before.
const BIAS_COARSER: f64 = 0.05;
/// Derivatives at the pixel's centre suffice where their Fisher information differs by no more than this share from that of
/// means. The lost variance is of the order of its square.
const INFORMATION: f64 = 0.08;
/// The same limit for returning to them.
const INFORMATION_COARSER: f64 = 0.05;
/// Largest error from a plane that is not recomputed, in standard deviations.
const PLANE_ERROR_MAX: f64 = 0.05;
/// A choice holds until a parameter's information has changed by this share.
const CHANGED: f64 = 0.2;
/// Predictions that cost as much as a pixel of a pass.
const POINTS_A_PASS: usize = 4;
/// Safety factor of the lag with derivatives of means, which is inferred, not measured.
const CONCLUDED: f64 = 2.5;
/// Planes after which [`PLANE_ERROR_MAX_SHARP`] replaces [`PLANE_ERROR_MAX`]: a rim may be so sharp that no step leads
/// closer.
const PATIENT: usize = 6;
/// Largest error after [`PATIENT`] planes, in standard deviations.
const PLANE_ERROR_MAX_SHARP: f64 = 0.5;
/// Largest error in the last round, in standard deviations, where steps oscillate between two points.
const PLANE_ERROR_MAX_LAST: f64 = 2.0;
/// Most fits until a choice and its plane suit.
const ROUNDS: usize = 10;
const LAST: usize = ROUNDS - 1;
/// Steps between planes that do not shrink by this factor oscillate; the next plane is then made half-way.
const SHRINKING: f64 = 0.6;

/// The sampling of a fit, and the conditions that it was chosen for.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct SamplingChoice {
    pub sampled: Sampled,
    /// 1/variance of each free parameter, if all others were known. Empty before the first fit.
    #[serde(with = "exact")]
    information: Vec<f64>,
    /// The share of a step by which the plane would have followed.
    #[serde(with = "exact")]
    lag: f64,
    /// The last prediction was too far off for a plane computed there.
    #[serde(default)]
    is_strained: bool,
    /// The corrections of the last fit.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    corrections: Option<Corrections>,
}

impl SamplingChoice {
    /// Whether it is valid for a model with this many parameters.
    pub fn suits(&self, parameters: usize) -> bool {
        let Sampled { points, slopes } = self.sampled;
        means::levels(2).contains(&points)
            && (1..=2).contains(&slopes)
            && self.corrections.as_ref().is_none_or(|corrections| corrections.at.len() == parameters)
    }
}

/// The kind of fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FitMethod {
    /// A refinement only: from a target's predicted position.
    RefineOnly,
    /// A refinement, else a full fit: from the end of another fit.
    RefineOrFull,
}

/// A part of a fit, with one plane of corrections.
#[derive(Clone, Copy, Debug)]
struct Leg {
    /// The step that led to its start.
    before: Option<PreviousStep>,
    /// That step shrank too little: steps oscillate.
    is_oscillating: bool,
    method: FitMethod,
}

/// A model's kernels with corrections; its default cannot fit.
#[derive(Default)]
pub(crate) struct Sampling {
    kernels: Option<Kernels>,
}

struct Kernels {
    /// The kernels with slopes at the centre, and those with mean slopes.
    centre: StageKernels,
    mean: StageKernels,
    entries: Vec<MeanKernels>,
    /// Available points per side, from one on.
    levels: Vec<u32>,
}

impl Sampling {
    /// Derives the models; kernels are compiled on demand. Empty for models that state their quadrature, for those without
    /// a refinement, and where a limit is exceeded.
    pub fn new(base: &StageKernels) -> Sampling {
        Sampling { kernels: Sampling::applies(base).then(|| Kernels::new(base).ok()).flatten() }
    }

    /// True for models with automatic quadrature whose fits may be refinements.
    pub fn applies(base: &StageKernels) -> bool {
        base.model().quadrature() == Quadrature::Auto && base.refine_stage().is_some()
    }

    /// True if it cannot fit.
    pub fn is_empty(&self) -> bool {
        self.kernels.is_none()
    }

    /// The models whose kernels depend on the pixel layout.
    pub fn compiled(&self) -> impl Iterator<Item = &StageKernels> {
        self.kernels.iter().flat_map(|kernels| [&kernels.centre, &kernels.mean])
    }

    /// Compiles the kernels of corrections at all levels while `should_continue` returns true.
    ///
    /// # Errors
    /// When a kernel fails to compile.
    pub fn warm(&self, should_continue: &dyn Fn() -> bool) -> Result<(), CompileFailure> {
        let Some(kernels) = &self.kernels else { return Ok(()) };
        let levels = || kernels.levels.iter().filter(|points| **points > 1);
        let all = kernels.entries.iter().flat_map(|entry| levels().map(move |points| (entry, *points)));
        all.take_while(|_| should_continue()).try_for_each(|(entry, points)| entry.kernel(points).map(drop))
    }

    /// Fits from a nearly right start, with the choice of an earlier fit; `None` where the start is not nearly right, or
    /// where there is no choice. `domain`: the pixels that a refinement from a point can use.
    pub fn fit(
        &self,
        view: &View,
        domain: &dyn Fn(&[f64]) -> Window,
        constants: &[f64],
        start: &[f64],
        before: Option<&SamplingChoice>,
        method: FitMethod,
    ) -> Result<Option<Fit>, CompileFailure> {
        let Some(kernels) = &self.kernels else { return Ok(None) };
        let mut sampling_choice = match before {
            Some(before) => before.clone(),
            None => match kernels.choose(view, constants, start, None)? {
                Some(sampling_choice) => sampling_choice,
                None => return Ok(None),
            },
        };
        let mut from = start.to_vec();
        let mut is_strained = false;
        let mut earlier: Option<StageReport> = None;
        let (mut leg, mut last) = (Leg { before: None, is_oscillating: false, method }, None);
        for round in 0..ROUNDS {
            let narrow = if leg.method == FitMethod::RefineOnly { Some(view.narrowed(domain(&from))) } else { None };
            let seen = narrow.as_ref().unwrap_or(view);
            let wanted_window = with_margin(seen.window, view.window);
            let kept = sampling_choice
                .corrections
                .take()
                .filter(|corrections| corrections.covers(sampling_choice.sampled, seen.window));
            // Where a plane made at the prediction would suit, an unsuitable one costs a pass.
            let kept = kept.filter(|corrections| {
                sampling_choice.is_strained || kernels.is_near(&sampling_choice, &corrections.at, &from)
            });
            let corrections = match kept {
                None => kernels.corrections(seen, wanted_window, constants, &from, sampling_choice.sampled)?,
                kept => kept,
            };
            let outcome = match &corrections {
                Some(corrections) => {
                    let left = match round {
                        ..PATIENT => PLANE_ERROR_MAX,
                        LAST if leg.is_oscillating => PLANE_ERROR_MAX_LAST,
                        _ => PLANE_ERROR_MAX_SHARP,
                    };
                    kernels.fit(seen, corrections, constants, &from, left / sampling_choice.lag, leg)?
                }
                None => RefineOutcome::Failed,
            };
            let found = match outcome {
                RefineOutcome::Done(fit) => fit,
                RefineOutcome::BeyondLimit { parameters, previous_step, report } => {
                    if earlier.is_none() {
                        is_strained =
                            previous_step.length.is_none_or(|length| sampling_choice.lag * length > PLANE_ERROR_MAX);
                    }
                    earlier = Some(earlier.map_or(report.clone(), |earlier| report.after(&earlier)));
                    let lengths = previous_step.length.zip(leg.before.and_then(|before| before.length));
                    let is_oscillating = lengths.is_some_and(|(now, before)| now > SHRINKING * before);
                    let share = if is_oscillating { 0.5 } else { 1.0 };
                    from.iter_mut().zip(parameters).for_each(|(from, to)| *from += share * (to - *from));
                    leg.before = Some(PreviousStep {
                        length: previous_step.length.map(|length| share * length),
                        ..previous_step
                    });
                    leg.is_oscillating = is_oscillating;
                    last = corrections;
                    continue;
                }
                RefineOutcome::Failed => {
                    let is_cut = |corrections: &Corrections| {
                        view.is_over() && corrections.covers(sampling_choice.sampled, seen.window)
                    };
                    let Some((report, corrections)) = earlier.zip(last.filter(is_cut)) else { return Ok(None) };
                    let Some(fit) = kernels.cut_short(seen, &corrections, constants, from, report)? else {
                        return Ok(None);
                    };
                    return Ok(Some(Fit {
                        sampling_choice: Some(SamplingChoice { corrections: Some(corrections), ..sampling_choice }),
                        ..fit
                    }));
                }
            };
            (sampling_choice.corrections, sampling_choice.is_strained) = (corrections, is_strained);
            let mut fit = found;
            if let (Some(earlier), Some(last)) = (earlier.take(), fit.stages.last_mut()) {
                *last = last.clone().after(&earlier);
            }
            if fit.ending.is_unfinished() {
                fit.sampling_choice = Some(sampling_choice);
                return Ok(Some(fit));
            }
            let Some(information) = kernels.information(&fit) else { return Ok(None) };
            let is_changed = |(now, then): (&f64, &f64)| (now / then - 1.0).abs() > CHANGED;
            let fitted = sampling_choice.sampled;
            if information.iter().zip(&sampling_choice.information).any(is_changed) {
                match kernels.choose(view, constants, &fit.parameters, Some(fitted))? {
                    Some(anew) => {
                        sampling_choice =
                            SamplingChoice { corrections: sampling_choice.corrections, is_strained, ..anew }
                    }
                    None => return Ok(None),
                }
            }
            if sampling_choice.information.is_empty() {
                sampling_choice.information = information;
            }
            if sampling_choice.sampled == fitted {
                fit.sampling_choice = Some(sampling_choice);
                return Ok(Some(fit));
            }
            from.clone_from(&fit.parameters);
            earlier = fit.stages.pop();
            leg = Leg { before: None, is_oscillating: false, method: FitMethod::RefineOrFull };
        }
        Ok(None)
    }
}

impl Kernels {
    fn new(base: &StageKernels) -> Result<Kernels, CompileFailure> {
        let (model, precision, cache) = (base.model(), base.precision(), base.cache());
        let derived = |slopes| {
            let model = Arc::new(model.corrected(slopes));
            StageKernels::new(model, precision, cache.clone(), &InTurn, FitStarts::Nearby)
                .map(StageKernels::without_predictions)
        };
        let entries = model.summands().into_iter().filter(|summand| !summand.is_clipped());
        let entries = entries.map(|summand| MeanKernels::new(summand, cache)).collect();
        let levels = means::levels(model.coordinates().len());
        Ok(Kernels { centre: derived(Slopes::Centre)?, mean: derived(Slopes::Mean)?, entries, levels })
    }

    fn of(&self, slopes: u32) -> &StageKernels {
        if slopes > 1 { &self.mean } else { &self.centre }
    }

    /// Whether a plane made at one point is still accurate at another.
    fn is_near(&self, sampling_choice: &SamplingChoice, from: &[f64], to: &[f64]) -> bool {
        let moved =
            self.centre.last_parameters().iter().map(|parameter| to[parameter.index()] - from[parameter.index()]);
        let square: f64 =
            moved.zip(&sampling_choice.information).map(|(moved, information)| information * moved * moved).sum();
        sampling_choice.lag * square.sqrt() <= PLANE_ERROR_MAX
    }

    /// One fit with one plane of corrections, valid within `reach` standard deviations.
    fn fit(
        &self,
        view: &View,
        corrections: &Corrections,
        constants: &[f64],
        start: &[f64],
        reach: f64,
        leg: Leg,
    ) -> Result<RefineOutcome<Fit>, CompileFailure> {
        let Some(view) = self.corrected(view, corrections, constants)? else { return Ok(RefineOutcome::Failed) };
        let kernels = self.of(corrections.sampled.slopes);
        let distance_limit = DistanceLimit { from: &corrections.at, length: reach };
        let refined = refined(kernels, &view, constants, start, leg.before, Some(&distance_limit))?;
        if leg.method == FitMethod::RefineOnly || !matches!(refined, RefineOutcome::Failed) {
            return Ok(refined);
        }
        // Oscillating steps near the minimum.
        let mut full = fit_controlled(kernels, &view, constants, start, PixelHandling::SkipSaturated)?;
        let Some(far) =
            distance_from_start(&full, &corrections.at, kernels.last_parameters()).filter(|_| full.ending.is_fit())
        else {
            return Ok(RefineOutcome::Failed);
        };
        Ok(match full.stages.pop() {
            Some(report) if far > distance_limit.length => {
                let previous_step = PreviousStep { length: Some(far), mean: f64::INFINITY };
                RefineOutcome::BeyondLimit { parameters: full.parameters, previous_step, report }
            }
            report => {
                full.stages.extend(report);
                RefineOutcome::Done(full)
            }
        })
    }

    /// Builds the fit that the frame's budget has cut short.
    fn cut_short(
        &self,
        view: &View,
        corrections: &Corrections,
        constants: &[f64],
        at: Vec<f64>,
        report: StageReport,
    ) -> Result<Option<Fit>, CompileFailure> {
        let Some(view) = self.corrected(view, corrections, constants)? else { return Ok(None) };
        cut_short(self.of(corrections.sampled.slopes), &view, constants, at, report).map(Some)
    }

    /// Computes corrections at a point; `None` where there is no budget for them.
    fn corrections(
        &self,
        view: &View,
        window: Window,
        constants: &[f64],
        at: &[f64],
        sampled: Sampled,
    ) -> Result<Option<Corrections>, CompileFailure> {
        let corrections = Corrections::of(at, sampled, window);
        let work: usize = corrections.terms().iter().map(|points| self.work(window, *points)).sum();
        if view.spend(work).is_err() {
            return Ok(None);
        }
        Ok(self.planes(&corrections, constants)?.is_some().then_some(corrections))
    }

    /// Recomputing them for a restored tracker is not charged to the budget.
    fn planes<'a>(
        &self,
        corrections: &'a Corrections,
        constants: &[f64],
    ) -> Result<Option<&'a Planes>, CompileFailure> {
        if corrections.planes.get().is_none() {
            let [fine, coarse] = corrections.terms();
            let means = |points| self.means(corrections.window(), constants, &corrections.at, points);
            let Some(mut planes) = means(fine)? else { return Ok(None) };
            if coarse > 1 {
                let Some(coarse) = means(coarse)? else { return Ok(None) };
                planes = less(planes, &coarse);
            }
            corrections.planes.get_or_init(|| planes);
        }
        Ok(corrections.planes.get())
    }

    fn corrected<'a>(
        &self,
        view: &View<'a>,
        corrections: &'a Corrections,
        constants: &[f64],
    ) -> Result<Option<View<'a>>, CompileFailure> {
        Ok(self.planes(corrections, constants)?.and_then(|planes| view.corrected(planes, corrections.window())))
    }

    /// The coarsest choice within the limits.
    fn choose(
        &self,
        view: &View,
        constants: &[f64],
        at: &[f64],
        before: Option<Sampled>,
    ) -> Result<Option<SamplingChoice>, CompileFailure> {
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
            let Some(stage) = kernels.refine_stage() else { return Ok(None) };
            pass_at(kernels, &view, constants, stage, PixelHandling::SkipSaturated, at)
        };
        let (Some(first), Some(second)) = (pass(1, 0)?, pass(1, 1)?) else { return Ok(None) };
        let Some(definite) = Definite::of(&second.quadratic.hessian) else { return Ok(None) };
        // With noise F is that of unit variance; without it F gives the variance.
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
        // H is twice JᵀWJ, whose two factors J both lag.
        let lag = 0.5 * differs * if is_centre { 1.0 } else { CONCLUDED * (of_mean / of_centre).min(1.0) };
        let sampled = Sampled { points, slopes: if is_centre { 1 } else { 2 } };
        // Without corrections there is no lag.
        let lag = if sampled.points == sampled.slopes { 0.0 } else { lag };
        Ok(Some(SamplingChoice { sampled, information: Vec::new(), lag, is_strained: false, corrections: None }))
    }

    /// 1/variance of each free parameter, if all others were known; for unit residual variance where the model states no
    /// noise.
    fn information(&self, fit: &Fit) -> Option<Vec<f64>> {
        let summary = fit.summary.as_ref()?;
        let variance = if self.centre.model().has_noise() { 1.0 } else { summary.reduced_chi_square? };
        Some(summary.variance_alone.iter().map(|alone| variance / alone).collect())
    }

    /// Means by this many points per side minus the values at the centres, one plane per entry; `None` where a kernel fails.
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

    /// Their cost, in pixels of a pass.
    fn work(&self, window: Window, points: u32) -> usize {
        let all = points.pow(self.centre.model().coordinates().len() as u32) as usize;
        if points > 1 { self.entries.len() * all * window.pixels() / POINTS_A_PASS } else { 0 }
    }
}
