//! One round of a stage: a trust region with bounds, over one pixel set with one set of weights.
//!
//! Every step is judged by a gradient pass at its end, which also makes the next step. A step to a bound at which the
//! formula or a constraint fails goes most of the way there instead, in that parameter alone; a step that violates a
//! constraint is shortened as a whole.
//!
//! Near the minimum a kink in the formula, where a pixel changes sides, may reverse every step. So there no step after a
//! reversal is longer than half the previous one: the last steps are a bisection.

use nalgebra::DVector;

use crate::estimate::{Ending, StageReport, TracePoint};
use crate::solve::bounded::Bounded;
use crate::solve::stage::{CostFunction, Deviations, Pass, Rules, eigen_resolution};
use crate::solve::trust::{Curvature, TrustRegion, TrustStep};

/// When a round ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Until {
    /// After a step, unless little is left to do.
    Stepped,
    /// When the outline has left its pixels, or when little is left to do: the next round settles it.
    Left,
    /// When little is left to do.
    Little,
    /// When it has converged.
    Converged,
}

/// A budget: the outline has left a round's pixels when its centre has moved by this many semi-axes; by then half of the
/// pixels have changed.
const LEFT_BY: f64 = 0.5;
/// The outline has also left them when it has grown by this factor.
const LEFT_GROWN: f64 = 1.6;
/// Little is left to do where no parameter moves by more than this, in standard deviations: that adds less than 1 % to
/// them.
const LITTLE: f64 = 0.1;
/// Where the unlimited step is shorter than this many standard deviations, `δᵀC⁻¹δ ≤ 1²`, F can hardly decrease further.
const INSIGNIFICANT: f64 = 1.0;
/// Refusals from one point after which a short step counts as convergence.
const REJECTED: u32 = 3;
/// ‖Dδ‖ below this share of ‖D u‖ is no step: it is a few roundings of f64.
const COLLAPSED: f64 = 1e-15;
/// Most halvings of a step that violates a constraint.
const HALVINGS: usize = 40;
/// A budget: fraction of the way to a bound that cannot be taken; ten times nearer with each step.
const SHARE_OF_WAY: f64 = 0.9;

/// The result of a round.
pub(super) struct RoundEnd {
    /// `None`: the outline has left its pixels.
    pub ending: Option<Ending>,
    /// The variance of a residual.
    pub variance: f64,
    /// Standard errors of the free parameters.
    pub deviations: Deviations,
}

/// A running round.
pub(super) struct Round<'a, P: CostFunction> {
    problem: &'a mut P,
    rules: &'a Rules,
    report: &'a mut StageReport,
    entry: &'a [f64],
    until: Until,
    /// End of the current step: all parameters.
    next: Vec<f64>,
    /// Bounds, lower and upper, at which the function fails.
    open: Vec<[bool; 2]>,
    /// The last accepted step, scaled: D δ.
    last: Option<DVector<f64>>,
    /// Limit of ‖Dδ‖ since steps have reversed near the minimum.
    longest: Option<f64>,
}

/// The outcome of the steps from one point.
enum Descent {
    /// One was accepted, to [`Round::next`]; `is_near`: little was left to do before it.
    Accepted { is_near: bool },
    /// The last step is shorter than its tolerance.
    Converged,
    /// No further step or pass is possible.
    Over(Ending),
}

impl<'a, P: CostFunction> Round<'a, P> {
    pub fn new(
        problem: &'a mut P,
        rules: &'a Rules,
        report: &'a mut StageReport,
        entry: &'a [f64],
        until: Until,
    ) -> Round<'a, P> {
        let open = vec![[false; 2]; rules.free.len()];
        Round { problem, rules, report, entry, until, next: entry.to_vec(), open, last: None, longest: None }
    }

    /// Minimises from `point`, where the round is entered.
    pub fn run(mut self, point: &mut [f64]) -> RoundEnd {
        let free = self.rules.free.len();
        let (mut pass, mut trial) = (Pass::of(free), Pass::of(free));
        let mut end = RoundEnd { ending: None, variance: 1.0, deviations: Deviations::unknown(free) };
        if let Err(ending) = self.enter(&mut pass) {
            return RoundEnd { ending: Some(ending), ..end };
        }
        let mut region = TrustRegion::new(&pass.quadratic.hessian, &self.free(point));
        loop {
            region.rescale(&pass.quadratic.hessian);
            match self.descend(point, &pass, &mut trial, &mut region, &mut end.deviations) {
                Descent::Accepted { is_near } => {
                    point.copy_from_slice(&self.next);
                    std::mem::swap(&mut pass, &mut trial);
                    if self.until == Until::Stepped && !is_near || self.until == Until::Left && self.has_left(point) {
                        return end;
                    }
                }
                Descent::Converged => {
                    point.copy_from_slice(&self.next);
                    end.variance = self.rules.variance(&pass);
                    return RoundEnd { ending: Some(Ending::SmallStep), ..end };
                }
                Descent::Over(ending) => return RoundEnd { ending: Some(ending), ..end },
            }
        }
    }

    fn has_left(&self, point: &[f64]) -> bool {
        self.problem.moved(self.entry, point).is_some_and(|moved| moved.by > LEFT_BY || moved.grown > LEFT_GROWN)
    }

    /// Runs the first pass; an error when it is unusable.
    fn enter(&mut self, pass: &mut Pass) -> Result<(), Ending> {
        self.problem.gradient(self.entry, self.entry, pass)?;
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

    /// Tries ever shorter steps from `point` until one is accepted; its pass is `trial`.
    fn descend(
        &mut self,
        point: &[f64],
        pass: &Pass,
        trial: &mut Pass,
        region: &mut TrustRegion,
        deviations: &mut Deviations,
    ) -> Descent {
        let (rules, here, scale) = (self.rules, self.free(point), region.scale());
        let slack = rules.slack(pass.quadratic.objective, pass.pixels);
        // C = 2 s² H⁻¹ with s² the variance of a residual, so δᵀC⁻¹δ = ½ δᵀHδ / s² = reduction / s².
        let variance = rules.variance(pass);
        let little = slack.max(INSIGNIFICANT * INSIGNIFICANT * variance);
        let tolerance = if self.until == Until::Converged { rules.tolerance } else { rules.tolerance.max(LITTLE) };
        let promised = here.len() as f64 * tolerance * tolerance * variance;
        let shortest = COLLAPSED * scale.component_mul(&here).norm();
        let (mut refused, mut step_ranges) = (0, self.step_ranges(&here));
        loop {
            let Some(bounded) = Bounded::new(&pass.quadratic, &scale, eigen_resolution(rules.precision), &step_ranges)
            else {
                return Descent::Over(Ending::NonFinite);
            };
            let is_bent = pass.quadratic.curvature == Curvature::Full && bounded.spectrum.is_indefinite();
            self.report.indefinite_steps += u32::from(is_bent);
            *deviations = rules.deviations(&bounded.spectrum, pass);
            let unlimited = bounded.step(f64::INFINITY);
            let nearly_there = unlimited.interior && unlimited.reduction <= little;
            let turns = |last: &&DVector<f64>| unlimited.delta.component_mul(&scale).dot(last) < 0.0;
            self.longest = match self.last.as_ref().filter(turns) {
                _ if !nearly_there => None,
                Some(last) => Some(0.5 * last.norm()),
                None => self.longest,
            };
            self.longest.into_iter().for_each(|longest| region.limit(longest));
            loop {
                let step = bounded.step(region.radius());
                let is_final = step.interior || nearly_there && (self.longest.is_some() || refused >= REJECTED);
                // With correlated parameters each may move by little of its own deviation and F still fall by much, so
                // δᵀC⁻¹δ is tested as well.
                let is_refine_only =
                    deviations.cover(&step.delta, &here, tolerance) && step.reduction <= slack.max(promised);
                let is_allowed = self.is_allowed(point, &step);
                if is_final && (is_refine_only || deviations.cover(&step.delta, &here, 0.0)) {
                    if !is_allowed {
                        self.next.copy_from_slice(point);
                    }
                    return Descent::Converged;
                }
                if self.report.iterations == rules.iterations {
                    return Descent::Over(Ending::IterationLimit);
                }
                if !is_allowed && self.opens(point) {
                    break;
                }
                let Some(step) = self.within_constraints(point, step) else { return Descent::Over(Ending::NoDescent) };
                if step.length <= shortest {
                    return Descent::Over(Ending::NoDescent);
                }
                self.report.iterations += 1;
                self.report.passes += 1;
                if let Err(ending) = self.problem.gradient(&self.next, self.entry, trial) {
                    return Descent::Over(ending);
                }
                let objective = if trial.quadratic.is_finite() { trial.quadratic.objective } else { f64::NAN };
                let (actual, radius) = (pass.quadratic.objective - objective, Some(region.radius()));
                self.note(TracePoint { objective, radius, ratio: Some((actual + slack) / (step.reduction + slack)) });
                if objective.is_nan() && self.opens(point) {
                    break;
                }
                if region.judge(&step, actual, slack) {
                    self.last = Some(step.delta.component_mul(&scale));
                    return Descent::Accepted { is_near: nearly_there };
                }
                refused += 1;
                if !region.radius().is_normal() {
                    return Descent::Over(Ending::NoDescent);
                }
            }
            step_ranges = self.step_ranges(&here);
        }
    }

    /// Range of the next step for each free parameter.
    fn step_ranges(&self, here: &DVector<f64>) -> Vec<[f64; 2]> {
        let each = here.iter().zip(self.rules.bounds.iter()).zip(&self.open);
        let share = |is_open: bool| if is_open { SHARE_OF_WAY } else { 1.0 };
        each.map(|((at, [low, high]), [below, above])| [share(*below) * (low - at), share(*above) * (high - at)])
            .collect()
    }

    /// Marks the bounds that the current step meets from `point` as not to be taken; false where there are none.
    fn opens(&mut self, point: &[f64]) -> bool {
        let mut any = false;
        for ((open, [low, high]), &i) in self.open.iter_mut().zip(self.rules.bounds.iter()).zip(self.rules.free.iter())
        {
            for (open, bound) in open.iter_mut().zip([*low, *high]) {
                let is_met = !*open && self.next[i] == bound && point[i] != bound;
                (*open, any) = (*open || is_met, any || is_met);
            }
        }
        any
    }

    /// Halves the step until the constraints hold.
    fn within_constraints(&mut self, point: &[f64], step: TrustStep) -> Option<TrustStep> {
        let mut share = 1.0;
        for _ in 0..HALVINGS {
            let shorter = step.shortened(share);
            if self.is_allowed(point, &shorter) {
                return Some(if share == 1.0 { step } else { shorter });
            }
            share *= 0.5;
        }
        None
    }

    fn free(&self, point: &[f64]) -> DVector<f64> {
        DVector::from_iterator(self.rules.free.len(), self.rules.free.iter().map(|&i| point[i]))
    }

    /// Writes the step's end to [`Round::next`]; true when bounds and constraints hold there.
    fn is_allowed(&mut self, point: &[f64], step: &TrustStep) -> bool {
        self.next.copy_from_slice(point);
        let each = self.rules.free.iter().zip(self.rules.bounds.iter()).zip(step.delta.iter());
        for ((&i, [low, high]), delta) in each {
            // Rounding may put the sum beyond a bound.
            self.next[i] = (self.next[i] + delta).clamp(*low, *high);
        }
        self.problem.allowed(&self.next)
    }
}
