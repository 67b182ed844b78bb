//! One stage: some of the parameters, one method, a bounded number of steps, in rounds.
//!
//! What comes in: a [`CostFunction`], something that can sum F, its gradient and its Hessian over pixels. What goes out: moved
//! parameters and a [`StageReport`]. It never knows kernels, pixels or roles.
//!
//! A *round* fixes the pixel set and the noise weights at the point where it is entered, so F is one function throughout it, and
//! runs the trust region over that ([`round`](crate::solve::round)). Where the outline has moved by half its size, or grown by
//! 1.6, the round ends there, and the next one begins. Near the minimum a round may change the fit by what its pixels at the rim
//! say alone. A new round is kept where F over the pixels of both is not larger by it, and rounds go on while they move the fit.

use std::sync::Arc;

use isophote_symbolic::{Model, Precision};
use nalgebra::{DMatrix, DVector};

use crate::estimate::{Ending, StageReport};
use crate::outline::{Moved, ends_at_outline, has_domain};
use crate::solve::round::{Round, Until};
use crate::solve::trust::{Curvature, Quadratic, Spectrum};

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
    /// True when bounds, which are values that a parameter may have, and constraints hold.
    fn allowed(&self, point: &[f64]) -> bool;
    /// By how much F is larger at the second point than at the first, over the pixels of both entries, with the weights of the
    /// second and the square of each residual at most 16 variances; `None` where that is not to be had. `variance`: of a residual.
    fn change(&mut self, _points: [&[f64]; 2], _entries: [&[f64]; 2], _variance: f64) -> Option<f64> {
        None
    }
    /// How far outlines are from where they were; `None` where there are none.
    fn moved(&self, _from: &[f64], _to: &[f64]) -> Option<Moved> {
        None
    }
}

/// When pixels and their weights, which follow the parameters, are taken anew.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Renewal {
    /// Never: there is neither a domain nor noise.
    Never,
    /// After a round.
    ByRound,
    /// After every step, until little is left to do: the domain ends at the outline, and what the formula says of pixels beyond it
    /// has no meaning.
    ByStep,
}

impl Renewal {
    /// Of a model's fits.
    pub fn of(model: &Model) -> Renewal {
        match (has_domain(model), model.has_noise()) {
            (false, false) => Renewal::Never,
            (true, _) if ends_at_outline(model) => Renewal::ByStep,
            _ => Renewal::ByRound,
        }
    }
}

/// What a stage may do and what its numbers mean.
#[derive(Clone, Debug)]
pub(crate) struct Rules {
    /// Free parameters, as indices into the full vector.
    pub free: Arc<[usize]>,
    /// The least and largest value of each.
    pub bounds: Arc<[[f64; 2]]>,
    /// Which of these say where the target is, as rows of H.
    pub places: Arc<[usize]>,
    /// Steps tried, at most.
    pub iterations: u32,
    /// A stage ends when every |δ| is below this times its standard deviation.
    pub tolerance: f64,
    /// Residuals are whitened: the variance of a pixel is known.
    pub noise: bool,
    /// When pixels and weights are taken anew.
    pub renewal: Renewal,
    /// The document says which pixels count.
    pub has_domain: bool,
    /// The minimum is wanted, not only the way to it, that ends where little is left to do.
    pub settles: bool,
    /// Arithmetic of the pixel sums.
    pub precision: Precision,
    /// What rounding does to one residual, in pixel values; 0 when not known.
    pub rounding: f64,
    /// The variance that this and the rounding of pixels to whole values add to one.
    pub rounding_variance: f64,
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
/// How far aside of a start without derivatives a stage begins: this share of each parameter, …
const ASIDE: f64 = 1.0 / 1024.0;
/// … and this where the parameter is 0.
const ASIDE_OF_ZERO: f64 = 1e-6;
/// Rounds that end because the outline has left its pixels, at most: a budget.
const ROUNDS_FAR: u32 = 8;
/// Rounds after one that has converged, at most: a budget.
pub(super) const ROUNDS_AGAIN: u32 = 3;
/// A round that moves the fit by no more than this, in standard deviations, was the last. It adds less than 1 % to them.
const SETTLED: f64 = 0.1;
/// A fit that the last round still moves by more, in standard deviations, has not converged.
const UNSETTLED: f64 = 0.5;

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

    /// That of a residual, whitened where the noise is stated: it is no less than 1 then, and more where the model does not
    /// describe the picture. With ln σ² in it F does not say it.
    pub(super) fn variance(&self, pass: &Pass) -> f64 {
        match (self.noise, pass.quadratic.curvature) {
            (true, Curvature::Full) => 1.0,
            (true, Curvature::GaussNewton) => self.reduced(pass).unwrap_or(1.0).max(1.0),
            (false, _) => self.reduced(pass).unwrap_or(0.0).max(0.0),
        }
    }

    /// Standard deviations from `2 H⁻¹`, the covariance at unit variance: times that of a residual, and times what rounding
    /// does to a residual. 0 where H is indefinite.
    pub(super) fn deviations(&self, spectrum: &Spectrum, pass: &Pass) -> Deviations {
        let unknown = Deviations::unknown(self.free.len());
        let Some(inverse) = spectrum.inverse_diagonal() else { return unknown };
        let times = |unit: f64| inverse.map(|entry| if unit > 0.0 { unit * (2.0 * entry).sqrt() } else { 0.0 });
        let rounding = if self.noise { 0.0 } else { self.rounding };
        Deviations { noise: times(self.variance(pass).sqrt()), rounding: times(rounding) }
    }
}

/// How far off each free parameter may be.
pub(super) struct Deviations {
    /// By the noise of the pixels.
    noise: DVector<f64>,
    /// By the arithmetic.
    rounding: DVector<f64>,
}

impl Deviations {
    /// Of so many parameters.
    pub fn unknown(count: usize) -> Deviations {
        Deviations { noise: DVector::zeros(count), rounding: DVector::zeros(count) }
    }

    /// Every |δ| ≤ share · σ, or ≤ what rounding amounts to, or ≤ 1e-10 (|u| + 1e-10).
    pub fn cover(&self, delta: &DVector<f64>, u: &DVector<f64>, share: f64) -> bool {
        let enough =
            |i: usize| (share * self.noise[i]).max(self.rounding[i]).max(STEP_RELATIVE * (u[i].abs() + STEP_RELATIVE));
        (0..delta.len()).all(|i| delta[i].abs() <= enough(i))
    }
}

/// The end of a stage.
pub(crate) struct StageRun {
    pub report: StageReport,
    /// By how much its last round moved the free parameters; none where pixels and weights do not follow them.
    pub moved: Option<DVector<f64>>,
    /// What fixes the pixels and weights of that round.
    pub entry: Vec<f64>,
}

/// A step that ends where F is another, over other pixels, but nearly the same.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stride {
    /// In standard deviations; not known of one that did not move all.
    pub length: Option<f64>,
    /// F a pixel where it began.
    pub mean: f64,
}

/// How a short way has ended, and what that leaves.
pub(crate) enum Arrival<T> {
    /// At a minimum, or where the frame's budget was used up after a step.
    There(T),
    /// Beyond its tether, by that last step: it is to be gone on from there, all parameters.
    Far { parameters: Vec<f64>, stride: Stride, report: StageReport },
    /// Nowhere: the start was not nearly right.
    Lost,
}

impl<T> Arrival<T> {
    /// That which is there.
    pub fn there(self) -> Option<T> {
        match self {
            Arrival::There(found) => Some(found),
            Arrival::Far { .. } | Arrival::Lost => None,
        }
    }
}

/// Runs a stage; `point` ends at the last accepted point (see [`Ending`]).
///
/// Where F is known at the start but its derivatives are not finite, the stage begins a little aside: a start in round
/// numbers may put a pixel on the very rim of the domain, where a root has no slope.
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

/// Beside `point`, to one side of it.
fn aside(point: &[f64], rules: &Rules, sign: f64) -> Vec<f64> {
    let mut aside = point.to_vec();
    for i in rules.free.iter() {
        aside[*i] += sign * if aside[*i] == 0.0 { ASIDE_OF_ZERO } else { ASIDE * aside[*i].abs() };
    }
    aside
}

fn run_from<P: CostFunction>(problem: &mut P, rules: &Rules, point: &mut [f64]) -> StageRun {
    let mut run = StageRun { report: StageReport::default(), moved: None, entry: point.to_vec() };
    // Where the first round that has converged was entered, and where it ended.
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
            // Noise has drawn the fit to ever fewer pixels: it is that over the first of these sets.
            run.report.ending = Ending::SmallStep;
            run.entry.clone_from(entered);
            point.copy_from_slice(ended);
            return run;
        }
        if ending != Ending::SmallStep || rules.renewal == Renewal::Never || !rules.settles {
            run.entry = entry;
            return run;
        }
        let at = DVector::from_iterator(rules.free.len(), rules.free.iter().map(|&i| point[i]));
        let moved = DVector::from_iterator(rules.free.len(), rules.free.iter().map(|&i| point[i] - entry[i]));
        let is_settled = end.deviations.cover(&moved, &at, SETTLED);
        if first.is_some() && !is_settled {
            let change = problem.change([&entry, point], [&run.entry, &entry], end.variance);
            if change.is_some_and(|change| change > 0.0) {
                point.copy_from_slice(&entry);
                return run;
            }
            again += 1;
        }
        if is_settled || again == ROUNDS_AGAIN {
            if !end.deviations.cover(&moved, &at, UNSETTLED) {
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
