//! One stage: some of the parameters, one method, a bounded number of steps.
//!
//! What comes in: a [`CostFunction`], something that can sum F, its gradient and its Hessian over pixels. What goes out: moved
//! parameters and a [`StageReport`]. It never knows kernels, pixels or roles.
//!
//! A pass *enters* at a point, and that point fixes its pixel set and its noise weights. F(u) and F(u + δ) are compared on
//! the set of u; only after a step is accepted a new pass enters at u + δ, on its own set. So a domain that moves with the
//! parameters cannot lower F by losing pixels; and a step after which the new set is explained much worse, pixel by pixel,
//! is taken back, so that it cannot grow without end either.
//!
//! Near the minimum, one pixel at the rim of a domain or of a kink in the formula may come and go with every step, which
//! then go to and fro for ever, some hundredths of a standard deviation long. So when a step that insignificant turns back,
//! the pixel set is kept from there on, and each turn halves what a step may be: the last steps are a bisection.
//!
//! Where steps were refused last, the stage does not end before F was seen to fall along its own gradient (see
//! [`Walk::agrees`]): a start from which every step is refused is no minimum.

use std::sync::Arc;

use isophote_symbolic::Precision;
use nalgebra::{DMatrix, DVector};

use crate::estimate::{Ending, StageReport, TracePoint};
use crate::solve::trust::{Curvature, Quadratic, Spectrum, TrustRegion, TrustStep};

/// What one gradient pass brings back.
#[derive(Clone, Debug)]
pub(crate) struct Pass {
    /// F, g, H for the stage's free parameters.
    pub quadratic: Quadratic,
    /// Pixels summed.
    pub pixels: u64,
}

impl Pass {
    /// Room for one over so many free parameters.
    pub fn of(free: usize) -> Pass {
        let (gradient, hessian) = (DVector::zeros(free), DMatrix::zeros(free, free));
        let curvature = Curvature::GaussNewton;
        Pass { quadratic: Quadratic { objective: 0.0, gradient, hessian, curvature }, pixels: 0 }
    }
}

/// A function to minimise. Points are full parameter vectors; free ones are the stage's. An error is how the stage ends when
/// there can be no further pass: no kernel could run, or nobody waits any longer.
pub(crate) trait CostFunction {
    /// Puts F, g and H at `point`, on the pixel set and with the weights of `entry`, into `pass`.
    fn gradient(&mut self, point: &[f64], entry: &[f64], pass: &mut Pass) -> Result<(), Ending>;
    /// The same of F, g and the diagonal of H, where the way is likely to end at `point`, whose H is much that of `pass`: that is
    /// scaled to this diagonal. By what share entries of the diagonal differ at most; `None` where that is not to be had.
    fn closing(&mut self, _point: &[f64], _entry: &[f64], _pass: &mut Pass) -> Option<Result<f64, Ending>> {
        None
    }
    /// F at `point`, on the pixel set and with the weights of `entry`.
    fn value(&mut self, point: &[f64], entry: &[f64]) -> Result<f64, Ending>;
    /// True when bounds and constraints hold.
    fn allowed(&self, point: &[f64]) -> bool;
}

/// What a stage may do and what its numbers mean.
#[derive(Clone, Debug)]
pub(crate) struct Rules {
    /// Free parameters, as indices into the full vector.
    pub free: Arc<[usize]>,
    /// Which of these say where the target is, as rows of H.
    pub places: Arc<[usize]>,
    /// Steps tried, at most.
    pub iterations: u32,
    /// A stage ends when every |δ| is below this times its standard deviation.
    pub tolerance: f64,
    /// Residuals are whitened: the variance of a pixel is known.
    pub noise: bool,
    /// Arithmetic of the pixel sums.
    pub precision: Precision,
    /// What rounding does to one residual, in pixel values; 0 when not known.
    pub rounding: f64,
    /// The points that are tried are kept.
    pub is_traced: bool,
    /// Pixels that the window holds.
    pub window_pixels: u64,
}

/// A domain keeps at least this share of the pixels that the stage began with.
const DOMAIN_SHARE: f64 = 0.02;
/// … and at least this many pixels, twice the parameters, or all that the window has.
const DOMAIN_PIXELS: u64 = 8;
/// |δ| ≤ this · (|u| + this) ends a stage whatever σ says.
const STEP_RELATIVE: f64 = 1e-10;
/// Where the unlimited step is shorter than this many standard deviations, `δᵀC⁻¹δ ≤ 1²`, F has little more to give.
const INSIGNIFICANT: f64 = 1.0;
/// Refusals from one point after which a short step is short because there is no descent.
const REJECTED: u32 = 3;
/// ‖Dδ‖ below this share of ‖D u‖ is no step any more.
const COLLAPSED: f64 = 1e-15;
/// F per pixel on a step's own pixel set may be this many times the least so far, and a little more (see [`Walk::strays`]).
const WORSE: f64 = 1.5;
/// Variance of rounding to whole pixel values.
pub(crate) const QUANTISATION: f64 = 1.0 / 12.0;
/// Radius over the length of a step that strayed.
const STRAYED: f64 = 0.25;
/// How far aside of a start without derivatives a stage begins: this share of each parameter, …
const ASIDE: f64 = 1.0 / 1024.0;
/// … and this where the parameter is 0.
const ASIDE_OF_ZERO: f64 = 1e-6;
/// Halvings of a step that breaks a bound or a constraint.
const HALVINGS: usize = 40;
/// Steps down the gradient by which F is held against its derivatives, each an eighth of the one before, …
const RUNGS: usize = 12;
const RUNG: f64 = 0.125;
/// … as long as they promise so many times what rounding may hide. …
const TELLING: f64 = 16.0;
/// … After fewer than these nothing can be said: the curvature may be so much larger than it is thought to be.
const RUNGS_LEAST: usize = 4;
/// F falls when it falls by this share of what the gradient says.
const FALLS: f64 = 0.1;

/// Size of an eigenvalue that the sums cannot tell from zero, relative to the largest, per parameter.
pub(crate) fn eigen_resolution(precision: Precision) -> f64 {
    match precision {
        Precision::F32 => 1e-8,
        Precision::F64 => f64::EPSILON,
    }
}

impl Rules {
    /// By how much rounding may shift F between two passes. With ρ the largest rounding of a residual, about ρ/4 the usual
    /// one, `|Σ (r + ρ)² − Σ r²| ≈ 2 (ρ/4) √F` for random signs, and n (ρ/4)² where r vanishes; twice that; and the rounding
    /// of the sums themselves.
    pub(super) fn slack(&self, objective: f64, pixels: u64) -> f64 {
        let relative = match self.precision {
            Precision::F32 => 5e-8,
            Precision::F64 => 4.0 * f64::EPSILON,
        };
        // With ln σ² in it, F may be negative.
        let objective = objective.abs();
        let rho = self.rounding / 4.0;
        relative * objective + 4.0 * rho * objective.sqrt() + 2.0 * pixels as f64 * rho * rho
    }

    pub(super) fn pixels_needed(&self, first: u64) -> u64 {
        let parameters = self.free.len() as u64;
        let enough = DOMAIN_PIXELS.max(2 * parameters).min(self.window_pixels.max(parameters).max(1));
        enough.max((DOMAIN_SHARE * first as f64).ceil() as u64)
    }

    /// χ²/ν with ν = pixels − parameters; `None` when ν ≤ 0.
    pub(super) fn reduced(&self, pass: &Pass) -> Option<f64> {
        let freedom = pass.pixels.checked_sub(self.free.len() as u64).filter(|&n| n > 0)?;
        Some(pass.quadratic.objective / freedom as f64)
    }

    /// Standard deviations from `2 H⁻¹`, the covariance at unit variance: times that of a residual, and times what rounding
    /// does to a residual. 0 where H is indefinite.
    fn deviations(&self, spectrum: &Spectrum, pass: &Pass) -> Deviations {
        let zero = DVector::zeros(self.free.len());
        let Some(inverse) = spectrum.inverse_diagonal() else {
            return Deviations { noise: zero.clone(), rounding: zero };
        };
        let times = |unit: f64| inverse.map(|entry| if unit > 0.0 { unit * (2.0 * entry).sqrt() } else { 0.0 });
        match self.noise {
            true => Deviations { noise: times(1.0), rounding: zero },
            false => Deviations {
                noise: times(self.reduced(pass).unwrap_or(0.0).max(0.0).sqrt()),
                rounding: times(self.rounding),
            },
        }
    }
}

/// How far off each free parameter may be.
struct Deviations {
    /// By the noise of the pixels.
    noise: DVector<f64>,
    /// By the arithmetic.
    rounding: DVector<f64>,
}

impl Deviations {
    /// Every |δ| ≤ share · σ, or ≤ what rounding amounts to, or ≤ 1e-10 (|u| + 1e-10).
    fn cover(&self, delta: &DVector<f64>, u: &DVector<f64>, share: f64) -> bool {
        let enough =
            |i: usize| (share * self.noise[i]).max(self.rounding[i]).max(STEP_RELATIVE * (u[i].abs() + STEP_RELATIVE));
        (0..delta.len()).all(|i| delta[i].abs() <= enough(i))
    }
}

/// One stage at work.
struct Walk<'a, P: CostFunction> {
    problem: &'a mut P,
    rules: &'a Rules,
    report: StageReport,
    /// Where the step at hand leads: all parameters.
    next: Vec<f64>,
    /// Steps from the point at hand that were refused.
    refused: u32,
    /// The least F per pixel of a pass so far.
    least_mean: f64,
    /// The last accepted step, scaled: D δ.
    last: Option<DVector<f64>>,
    /// Since steps have turned back near the minimum.
    turned: Option<Turned>,
}

/// The end game.
struct Turned {
    /// Fixes the pixel set from here on.
    entry: Vec<f64>,
    /// The longest step, ‖Dδ‖.
    length: f64,
}

/// What became of the steps from one point.
enum Descent {
    /// One was accepted; [`Walk::next`] is where it leads.
    Accepted,
    /// There is no further step.
    Over(Ending),
    /// The last step is shorter than its tolerance.
    Converged(TrustStep),
    /// There can be no further pass.
    Stopped(Ending),
}

/// Runs a stage; `point` ends at the last accepted point (see [`Ending`]).
///
/// Where F is known at the start but its derivatives are not finite, the stage begins a little aside: a start in round
/// numbers may put a pixel on the very rim of the domain, where a root has no slope.
pub(crate) fn run<P: CostFunction>(problem: &mut P, rules: &Rules, point: &mut [f64]) -> StageReport {
    let report = run_from(problem, rules, point);
    let never_began = report.ending == Ending::NonFinite && report.passes <= 1;
    if !never_began || !problem.value(point, point).is_ok_and(f64::is_finite) {
        return report;
    }
    let Some(mut aside) = [-1.0, 1.0].into_iter().map(|sign| aside(point, rules, sign)).find(|p| problem.allowed(p))
    else {
        return report;
    };
    let report = run_from(problem, rules, &mut aside);
    if report.ending != Ending::NonFinite {
        point.copy_from_slice(&aside);
    }
    report
}

/// Beside `point`, to one side of it.
fn aside(point: &[f64], rules: &Rules, sign: f64) -> Vec<f64> {
    let mut aside = point.to_vec();
    for i in rules.free.iter() {
        aside[*i] += sign * if aside[*i] == 0.0 { ASIDE_OF_ZERO } else { ASIDE * aside[*i].abs() };
    }
    aside
}

fn run_from<P: CostFunction>(problem: &mut P, rules: &Rules, point: &mut [f64]) -> StageReport {
    let mut walk = Walk {
        problem,
        rules,
        report: StageReport::default(),
        next: point.to_vec(),
        refused: 0,
        least_mean: f64::INFINITY,
        last: None,
        turned: None,
    };
    walk.report.ending = walk.walk(point);
    walk.report
}

impl<P: CostFunction> Walk<'_, P> {
    fn walk(&mut self, point: &mut [f64]) -> Ending {
        let free = self.rules.free.len();
        let (mut pass, mut entered) = (Pass::of(free), Pass::of(free));
        if let Err(ending) = self.enter(point, &mut pass) {
            return ending;
        }
        let mut region = TrustRegion::new(&pass.quadratic.hessian, &self.free(point));
        loop {
            region.rescale(&pass.quadratic.hessian);
            let Some(spectrum) =
                Spectrum::new(&pass.quadratic, &region.scale(), eigen_resolution(self.rules.precision))
            else {
                return Ending::NonFinite;
            };
            if pass.quadratic.curvature == Curvature::Full && spectrum.is_indefinite() {
                self.report.indefinite_steps += 1;
            }
            match self.descend(point, &pass, &spectrum, &mut region) {
                Descent::Accepted => {}
                Descent::Over(ending) => return self.agreed(ending, point, &pass, &spectrum),
                Descent::Converged(step) => {
                    let ending = self.agreed(Ending::SmallStep, point, &pass, &spectrum);
                    if ending == Ending::SmallStep && self.is_allowed(point, &step) {
                        point.copy_from_slice(&self.next);
                    }
                    return ending;
                }
                Descent::Stopped(ending) => return ending,
            }
            let next = std::mem::take(&mut self.next);
            let is_entered = self.enter(&next, &mut entered);
            self.next = next;
            if let Err(ending) = is_entered {
                return ending; // `point` is the last one with a usable pass
            }
            if self.strays(&pass, &entered) {
                region.limit(STRAYED * self.last.as_ref().map_or(0.0, |step| step.norm()));
                self.last = None;
                continue;
            }
            std::mem::swap(&mut pass, &mut entered);
            point.copy_from_slice(&self.next);
        }
    }

    /// F fell on the old pixel set, but the new point's own set is explained much worse, pixel by pixel: the step led the
    /// domain to where the model does not hold.
    fn strays(&mut self, old: &Pass, new: &Pass) -> bool {
        let mean = |pass: &Pass| pass.quadratic.objective / pass.pixels.max(1) as f64;
        self.least_mean = self.least_mean.min(mean(old));
        // With ln σ² in it, F per pixel is a log-likelihood: it may be negative, and one unit of it is what 1 is for r²/σ².
        let slack = match (self.rules.noise, old.quadratic.curvature) {
            (true, Curvature::Full) => 1.0,
            (true, Curvature::GaussNewton) => 0.0,
            (false, _) => QUANTISATION + self.rules.rounding.powi(2),
        };
        let much_worse = self.least_mean + (WORSE - 1.0) * self.least_mean.abs() + slack;
        new.pixels != old.pixels && mean(new) > much_worse
    }

    /// A gradient pass at `point`, when it is one to go on with.
    fn enter(&mut self, point: &[f64], pass: &mut Pass) -> Result<(), Ending> {
        let entry = self.turned.as_ref().map_or(point, |turned| &turned.entry);
        self.problem.gradient(point, entry, pass)?;
        if self.report.passes == 0 {
            self.report.pixels_first = pass.pixels;
            self.report.pixels_least = pass.pixels;
            self.note(TracePoint { objective: pass.quadratic.objective, radius: None, ratio: None });
        }
        self.report.passes += 1;
        self.report.pixels_last = pass.pixels;
        self.report.pixels_least = self.report.pixels_least.min(pass.pixels);
        if pass.pixels < self.rules.pixels_needed(self.report.pixels_first) {
            return Err(Ending::DomainVanished);
        }
        if pass.quadratic.is_finite() { Ok(()) } else { Err(Ending::NonFinite) }
    }

    fn note(&mut self, point: TracePoint) {
        if self.rules.is_traced {
            self.report.note(point);
        }
    }

    /// Tries ever shorter steps from `point` until one is accepted.
    fn descend(&mut self, point: &[f64], pass: &Pass, spectrum: &Spectrum, region: &mut TrustRegion) -> Descent {
        let here = self.free(point);
        let scale = region.scale();
        let deviations = self.rules.deviations(spectrum, pass);
        let slack = self.rules.slack(pass.quadratic.objective, pass.pixels);
        let length = scale.component_mul(&here).norm();
        let unlimited = spectrum.step(f64::INFINITY);
        // C = 2 s² H⁻¹ with s² the variance of a residual, so δᵀC⁻¹δ = ½ δᵀHδ / s² = reduction / s².
        let variance = if self.rules.noise { 1.0 } else { self.rules.reduced(pass).unwrap_or(0.0) };
        let little = slack.max(INSIGNIFICANT * INSIGNIFICANT * variance);
        // Every δ at `tolerance` deviations, were they independent.
        let promised = here.len() as f64 * self.rules.tolerance.powi(2) * variance;
        let nearly_there = unlimited.interior && unlimited.reduction <= little;
        self.refused = 0;
        let turns = |last: &&DVector<f64>| nearly_there && unlimited.delta.component_mul(&scale).dot(last) < 0.0;
        if let Some(last) = self.last.as_ref().filter(turns) {
            let entry = self.turned.take().map_or_else(|| point.to_vec(), |turned| turned.entry);
            self.turned = Some(Turned { entry, length: 0.5 * last.norm() });
        }
        match &self.turned {
            Some(turned) if nearly_there => region.limit(turned.length),
            _ => self.turned = None,
        }
        loop {
            let step = spectrum.step(region.radius());
            let final_step = step.interior || nearly_there && (self.turned.is_some() || self.refused >= REJECTED);
            // Where parameters go together, each may move by little of its own deviation and F still fall by much: δᵀC⁻¹δ is
            // asked as well.
            let is_covered = |share| deviations.cover(&step.delta, &here, share);
            let is_slight = step.reduction <= slack.max(promised);
            if final_step && (is_covered(self.rules.tolerance) && is_slight || is_covered(0.0)) {
                return Descent::Converged(step);
            }
            if self.report.iterations == self.rules.iterations {
                return Descent::Over(Ending::IterationLimit);
            }
            let Some(step) = self.within_bounds(point, step) else {
                return Descent::Over(Ending::NoDescent);
            };
            if step.length <= COLLAPSED * length {
                return Descent::Over(Ending::NoDescent);
            }
            self.report.iterations += 1;
            let entry = self.turned.as_ref().map_or(point, |turned| &turned.entry);
            let value = match self.problem.value(&self.next, entry) {
                Ok(value) => value,
                Err(ending) => return Descent::Stopped(ending),
            };
            let (actual, radius) = (pass.quadratic.objective - value, Some(region.radius()));
            let ratio = Some((actual + slack) / (step.reduction + slack));
            self.note(TracePoint { objective: value, radius, ratio });
            if region.judge(&step, actual, slack) {
                self.last = Some(step.delta.component_mul(&scale));
                return Descent::Accepted;
            }
            self.refused += 1;
            if !region.radius().is_normal() {
                return Descent::Over(Ending::NoDescent);
            }
        }
    }

    /// The ending; where steps were refused before it only if F and its derivatives agree.
    fn agreed(&mut self, ending: Ending, point: &[f64], pass: &Pass, spectrum: &Spectrum) -> Ending {
        if self.refused == 0 {
            return ending;
        }
        match self.agrees(point, pass, spectrum) {
            Ok(Agreement::Holds) => ending,
            Ok(Agreement::Broken) => Ending::NotDescending,
            Err(stopped) => stopped,
        }
    }

    /// Whether F at `point` is that of the gradient pass, and falls along −g: by ever shorter steps, since the curvature may
    /// be underestimated, down to where rounding hides what they promise. At a kink F may rise to either side: that is a
    /// minimum, of which no gradient tells.
    fn agrees(&mut self, point: &[f64], pass: &Pass, spectrum: &Spectrum) -> Result<Agreement, Ending> {
        let objective = pass.quadratic.objective;
        let told = TELLING * self.rules.slack(objective, pass.pixels);
        let Some(steepest) = spectrum.steepest() else { return Ok(Agreement::Holds) };
        let entry = self.turned.as_ref().map_or_else(|| point.to_vec(), |turned| turned.entry.clone());
        let (mut share, mut rungs, mut shortest) = (1.0, 0, None);
        for _ in 0..RUNGS {
            let step = steepest.shortened(share);
            share *= RUNG;
            if step.reduction <= told {
                break;
            }
            if !self.is_allowed(point, &step) {
                continue;
            }
            if objective - self.problem.value(&self.next, &entry)? >= FALLS * step.reduction {
                return Ok(Agreement::Holds);
            }
            rungs += 1;
            shortest = Some(step);
        }
        let Some(step) = shortest.filter(|_| rungs >= RUNGS_LEAST) else { return Ok(Agreement::Holds) };
        if (self.problem.value(point, &entry)? - objective).abs() > told {
            return Ok(Agreement::Broken);
        }
        let is_kink = self.is_allowed(point, &step.reversed())
            && self.problem.value(&self.next, &entry)? - objective >= FALLS * step.reduction;
        Ok(if is_kink { Agreement::Holds } else { Agreement::Broken })
    }

    /// Halves the step until bounds (exclusive) and constraints hold.
    fn within_bounds(&mut self, point: &[f64], step: TrustStep) -> Option<TrustStep> {
        if self.is_allowed(point, &step) {
            return Some(step);
        }
        let mut share = 1.0;
        for _ in 1..HALVINGS {
            share *= 0.5;
            let shorter = step.shortened(share);
            if self.is_allowed(point, &shorter) {
                return Some(shorter);
            }
        }
        None
    }

    fn free(&self, point: &[f64]) -> DVector<f64> {
        DVector::from_iterator(self.rules.free.len(), self.rules.free.iter().map(|&i| point[i]))
    }

    /// Takes a step to [`Walk::next`]; true when bounds and constraints hold there.
    fn is_allowed(&mut self, point: &[f64], step: &TrustStep) -> bool {
        self.next.copy_from_slice(point);
        for (&i, delta) in self.rules.free.iter().zip(step.delta.iter()) {
            self.next[i] += delta;
        }
        self.problem.allowed(&self.next)
    }
}

/// Whether a function is the one that its derivatives are of.
enum Agreement {
    Holds,
    Broken,
}

#[cfg(test)]
#[path = "stage_tests.rs"]
mod tests;
