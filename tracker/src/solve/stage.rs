//! One stage of a fit: minimises over some of the parameters, with one method and a bounded number of steps, in rounds.
//!
//! A *round* fixes the pixel set and the noise weights at its entry point, so that F is one function throughout it, and
//! runs the trust region ([`round`](crate::solve::round)). Where the outline has moved by half its size, or grown by 1.6,
//! the round ends and the next one begins. Near the minimum a round may change the fit only by the noise of its rim pixels.
//! A new round is kept where it does not increase F over the pixels of both, and rounds repeat while they move the fit.

use std::sync::Arc;

use isophote_symbolic::{Model, Precision};
use nalgebra::{DMatrix, DVector};

use crate::estimate::{Ending, StageReport};
use crate::outline::{Moved, ends_at_outline, has_domain};
use crate::solve::round::{Round, Until};
use crate::solve::trust::{Curvature, Quadratic, Spectrum};

/// The result of one gradient pass.
#[derive(Clone, Debug)]
pub(crate) struct Pass {
    /// F, g, H over the stage's free parameters.
    pub quadratic: Quadratic,
    /// Pixels summed.
    pub pixels: u64,
}

impl Pass {
    /// A zeroed pass over this many free parameters.
    pub fn of(free: usize) -> Pass {
        let (gradient, hessian) = (DVector::zeros(free), DMatrix::zeros(free, free));
        let curvature = Curvature::GaussNewton;
        Pass { quadratic: Quadratic { objective: 0.0, gradient, hessian, curvature }, pixels: 0 }
    }
}

/// A function to minimise. Points are full parameter vectors; the stage's parameters are free. An error ends the stage: no
/// kernel could run, or the budget is used up or the caller has cancelled.
pub(crate) trait CostFunction {
    /// Computes F, g and H at `point`, with the pixel set and weights of `entry`, into `pass`.
    fn gradient(&mut self, point: &[f64], entry: &[f64], pass: &mut Pass) -> Result<(), Ending>;
    /// Computes F, g and the diagonal of H at a point that is probably the end, and scales the H of `pass` to that
    /// diagonal. Returns the mean relative change of the diagonal's entries; `None` where that is unsupported.
    fn closing(&mut self, _point: &[f64], _entry: &[f64], _pass: &mut Pass) -> Option<Result<f64, Ending>> {
        None
    }
    /// True when the constraints hold. A bound itself is an allowed value.
    fn allowed(&self, point: &[f64]) -> bool;
    /// Increase of F from the first point to the second, over the pixels of both entries, with the weights of the second
    /// and squared residuals capped at 16 variances; `None` where that is unsupported. `variance`: of a residual.
    fn change(&mut self, _points: [&[f64]; 2], _entries: [&[f64]; 2], _variance: f64) -> Option<f64> {
        None
    }
    /// How far outlines have moved; `None` without outlines.
    fn moved(&self, _from: &[f64], _to: &[f64]) -> Option<Moved> {
        None
    }
}

/// When the pixel set and weights, which depend on the parameters, are renewed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Renewal {
    /// Never: the model has neither a domain nor noise.
    Never,
    /// After a round.
    ByRound,
    /// After every step, until little is left to do: the domain ends at the outline, and the formula has no meaning beyond
    /// it.
    ByStep,
}

impl Renewal {
    /// The renewal policy of a model.
    pub fn of(model: &Model) -> Renewal {
        match (has_domain(model), model.has_noise()) {
            (false, false) => Renewal::Never,
            (true, _) if ends_at_outline(model) => Renewal::ByStep,
            _ => Renewal::ByRound,
        }
    }
}

/// The settings of a stage.
#[derive(Clone, Debug)]
pub(crate) struct Rules {
    /// Free parameters, as indices into the full vector.
    pub free: Arc<[usize]>,
    /// Lower and upper bound of each.
    pub bounds: Arc<[[f64; 2]]>,
    /// Rows of H of the position's parameters.
    pub position_rows: Arc<[usize]>,
    /// Most steps to try.
    pub iterations: u32,
    /// A stage ends when every |δ| is below this times its standard deviation.
    pub tolerance: f64,
    /// The noise is stated: residuals are whitened.
    pub noise: bool,
    /// When pixels and weights are renewed.
    pub renewal: Renewal,
    /// The document states a domain.
    pub has_domain: bool,
    /// Converge to the minimum, instead of ending where little is left to do.
    pub converges_fully: bool,
    /// Precision of the pixel sums.
    pub precision: Precision,
    /// Rounding error of a residual, in pixel values; 0 when unknown.
    pub rounding: f64,
    /// Variance of a residual from this and from the rounding of pixels to whole values.
    pub rounding_variance: f64,
    /// Record the points tried.
    pub is_traced: bool,
    /// Pixels of the window.
    pub window_pixels: u64,
}

/// Smallest share of the stage's first pixels that a domain must keep.
const DOMAIN_SHARE: f64 = 0.02;
/// Fewest pixels of a domain: this, twice the parameters, or all pixels of the window.
const DOMAIN_PIXELS: u64 = 8;
/// |δ| ≤ this · (|u| + this) ends a stage regardless of σ.
const STEP_RELATIVE: f64 = 1e-10;
/// Displacement of a start without derivatives, as a share of each parameter.
const ASIDE: f64 = 1.0 / 1024.0;
/// Displacement of a parameter that is 0.
const ASIDE_OF_ZERO: f64 = 1e-6;
/// A budget: most rounds that end because the outline has left its pixels.
const ROUNDS_FAR: u32 = 8;
/// A budget: most rounds after one that has converged.
pub(super) const ROUNDS_AGAIN: u32 = 3;
/// A round that moves the fit by no more than this, in standard deviations, is the last. It adds less than 1 % to them.
const LAST_ROUND_MOVE: f64 = 0.1;
/// If the last round still moves the fit by more, in standard deviations, it has not converged.
const NOT_CONVERGED_MOVE: f64 = 0.5;

/// Size of an eigenvalue that the sums cannot distinguish from zero, relative to the largest, per parameter.
pub(crate) fn eigen_resolution(precision: Precision) -> f64 {
    match precision {
        Precision::F32 => 1e-8,
        Precision::F64 => f64::EPSILON,
    }
}

impl Rules {
    /// Shift of F between two passes by rounding. With ρ the largest rounding of a residual, about ρ/4 the typical one,
    /// `|Σ (r + ρ)² − Σ r²| ≈ 2 (ρ/4) √F` for random signs, and n (ρ/4)² where r vanishes; twice that; plus the rounding of
    /// the sums themselves.
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
    pub(super) fn reduced_chi_square(&self, pass: &Pass) -> Option<f64> {
        let freedom = pass.pixels.checked_sub(self.free.len() as u64).filter(|&n| n > 0)?;
        Some(pass.quadratic.objective / freedom as f64)
    }

    /// The variance of a residual, whitened where the noise is stated: then at least 1, and more where the model does not
    /// describe the picture. With ln σ² in F, F does not give it.
    pub(super) fn variance(&self, pass: &Pass) -> f64 {
        match (self.noise, pass.quadratic.curvature) {
            (true, Curvature::Full) => 1.0,
            (true, Curvature::GaussNewton) => self.reduced_chi_square(pass).unwrap_or(1.0).max(1.0),
            (false, _) => self.reduced_chi_square(pass).unwrap_or(0.0).max(0.0),
        }
    }

    /// Standard deviations from `2 H⁻¹`, the covariance at unit variance: times that of a residual, and times the rounding
    /// error of a residual. 0 where H is indefinite.
    pub(super) fn deviations(&self, spectrum: &Spectrum, pass: &Pass) -> Deviations {
        let unknown = Deviations::unknown(self.free.len());
        let Some(inverse) = spectrum.inverse_diagonal() else { return unknown };
        let times = |unit: f64| inverse.map(|entry| if unit > 0.0 { unit * (2.0 * entry).sqrt() } else { 0.0 });
        let rounding = if self.noise { 0.0 } else { self.rounding };
        Deviations { noise: times(self.variance(pass).sqrt()), rounding: times(rounding) }
    }
}

/// Standard errors of the free parameters.
pub(super) struct Deviations {
    /// From the noise of the pixels.
    noise: DVector<f64>,
    /// From rounding.
    rounding: DVector<f64>,
}

impl Deviations {
    /// Zeros for this many parameters.
    pub fn unknown(count: usize) -> Deviations {
        Deviations { noise: DVector::zeros(count), rounding: DVector::zeros(count) }
    }

    /// Every |δ| ≤ share · σ, or ≤ the rounding error, or ≤ 1e-10 (|u| + 1e-10).
    pub fn cover(&self, delta: &DVector<f64>, u: &DVector<f64>, share: f64) -> bool {
        let enough =
            |i: usize| (share * self.noise[i]).max(self.rounding[i]).max(STEP_RELATIVE * (u[i].abs() + STEP_RELATIVE));
        (0..delta.len()).all(|i| delta[i].abs() <= enough(i))
    }
}

/// The result of a stage.
pub(crate) struct StageRun {
    pub report: StageReport,
    /// Movement of the free parameters in its last round; `None` where pixels and weights do not depend on them.
    pub moved: Option<DVector<f64>>,
    /// The parameters that fix the pixels and weights of that round.
    pub entry: Vec<f64>,
}

/// A step whose end has other pixels, so that F is only nearly comparable.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PreviousStep {
    /// In standard deviations; `None` if it did not move all parameters.
    pub length: Option<f64>,
    /// F per pixel at its start.
    pub mean: f64,
}

/// How a refinement ended.
pub(crate) enum RefineOutcome<T> {
    /// At a minimum, or after a step when the frame's budget was used up.
    Done(T),
    /// Its last step led beyond its tether; to be continued from there. Holds all parameters.
    BeyondLimit { parameters: Vec<f64>, previous_step: PreviousStep, report: StageReport },
    /// Failed: the start was not nearly right.
    Failed,
}

impl<T> RefineOutcome<T> {
    /// The result, if it arrived.
    pub fn done(self) -> Option<T> {
        match self {
            RefineOutcome::Done(found) => Some(found),
            RefineOutcome::BeyondLimit { .. } | RefineOutcome::Failed => None,
        }
    }
}

/// Runs a stage; `point` ends at the last accepted point (see [`Ending`]).
///
/// Where F is known at the start but its derivatives are not finite, the stage begins beside it: a start in round numbers
/// may put a pixel exactly on the rim of the domain, where a root has no slope.
pub(crate) fn run<P: CostFunction>(problem: &mut P, rules: &Rules, point: &mut [f64]) -> StageRun {
    for (&i, [low, high]) in rules.free.iter().zip(rules.bounds.iter()) {
        point[i] = point[i].clamp(*low, *high);
    }
    let ran = run_from(problem, rules, point);
    if ran.report.ending != Ending::NonFinite || ran.report.passes > 1 {
        return ran;
    }
    let Some(mut aside) = [-1.0, 1.0].into_iter().map(|sign| aside(point, rules, sign)).find(|p| problem.allowed(p))
    else {
        return ran;
    };
    let ran = run_from(problem, rules, &mut aside);
    if ran.report.ending != Ending::NonFinite {
        point.copy_from_slice(&aside);
    }
    ran
}

/// A point beside `point`, on the side of `sign`.
fn aside(point: &[f64], rules: &Rules, sign: f64) -> Vec<f64> {
    let mut aside = point.to_vec();
    for i in rules.free.iter() {
        aside[*i] += sign * if aside[*i] == 0.0 { ASIDE_OF_ZERO } else { ASIDE * aside[*i].abs() };
    }
    aside
}

fn run_from<P: CostFunction>(problem: &mut P, rules: &Rules, point: &mut [f64]) -> StageRun {
    let mut run = StageRun { report: StageReport::default(), moved: None, entry: point.to_vec() };
    // Entry and end of the first round that has converged.
    let mut first: Option<[Vec<f64>; 2]> = None;
    let (mut far, mut again) = (0, 0);
    loop {
        let entry = point.to_vec();
        let until = match (&first, rules.renewal) {
            (Some(_), _) | (None, Renewal::Never) => Until::Converged,
            (None, Renewal::ByRound) if far < ROUNDS_FAR => Until::Left,
            (None, Renewal::ByRound) => Until::Little,
            (None, Renewal::ByStep) => Until::Stepped,
        };
        let end = Round::new(problem, rules, &mut run.report, &entry, until).run(point);
        let Some(ending) = end.ending else {
            far += 1;
            continue;
        };
        run.report.ending = ending;
        if let (Ending::DomainVanished, Some([entered, ended])) = (ending, &first) {
            // Noise has drawn the fit to ever fewer pixels: returns the fit over the first of these sets.
            run.report.ending = Ending::SmallStep;
            run.entry.clone_from(entered);
            point.copy_from_slice(ended);
            return run;
        }
        if ending != Ending::SmallStep || rules.renewal == Renewal::Never || !rules.converges_fully {
            run.entry = entry;
            return run;
        }
        let at = DVector::from_iterator(rules.free.len(), rules.free.iter().map(|&i| point[i]));
        let moved = DVector::from_iterator(rules.free.len(), rules.free.iter().map(|&i| point[i] - entry[i]));
        let is_settled = end.deviations.cover(&moved, &at, LAST_ROUND_MOVE);
        if first.is_some() && !is_settled {
            let change = problem.change([&entry, point], [&run.entry, &entry], end.variance);
            if change.is_some_and(|change| change > 0.0) {
                point.copy_from_slice(&entry);
                return run;
            }
            again += 1;
        }
        if is_settled || again == ROUNDS_AGAIN {
            if !end.deviations.cover(&moved, &at, NOT_CONVERGED_MOVE) {
                run.report.ending = Ending::IterationLimit;
            }
            (run.moved, run.entry) = (Some(moved), entry);
            return run;
        }
        first.get_or_insert_with(|| [entry.clone(), point.to_vec()]);
        run.entry = entry;
    }
}

#[cfg(test)]
#[path = "stage_tests.rs"]
mod tests;
