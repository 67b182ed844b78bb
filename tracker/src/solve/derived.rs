//! `Derived`: the programs of a model's fits, one for each sum and summand.

use std::sync::{Mutex, PoisonError};

use isophote_symbolic::{Cost, Method, Model, Objective, ParameterId, Program, Summand, ValueKind};

use crate::solve::stage_kernels::{CompileFailure, Job, PixelHandling, curvature, held, lowering};
use crate::solve::trust::Curvature;
use crate::solve::workers::Workers;

/// Flops per pixel of a pass of `spot`, the unit of a pass's cost.
const USUAL_FLOPS: usize = 256;
/// Cost of an elementary function in flops.
const CALL_FLOPS: u32 = 400;

/// The programs of one sum over one of the model's summands.
pub(super) struct SummandPrograms {
    /// Index of the sum.
    pub sum: usize,
    pub is_clipped: bool,
    /// It sums several values per pixel and outputs how many it counted.
    pub is_joint: bool,
    /// Only fits from nearby use it.
    pub is_refine_only: bool,
    pub plain: Program,
    pub dropping: Program,
    pub objective: Objective,
}

/// The programs of a model. Jobs with the same sum share it: stages that free the same parameters, the covariance and a
/// last stage with a Gauss–Newton Hessian.
pub(super) struct Derived {
    pub parts: Vec<SummandPrograms>,
    /// The sum for each job.
    pub jobs: Vec<(Job, usize)>,
    /// The offset of the rows, free in each job besides its parameters.
    pub offset: Option<ParameterId>,
    /// Cost per pixel of a pass of the last stage, relative to a typical model.
    pub weight: usize,
}

/// Calls `make` with each number; returns the results, or the first fault.
pub(super) fn all<T: Send + Sync>(
    count: usize,
    workers: &dyn Workers,
    make: &(dyn Fn(usize) -> Result<T, CompileFailure> + Sync),
) -> Result<Vec<T>, CompileFailure> {
    let made: Vec<Mutex<Option<Result<T, CompileFailure>>>> = (0..count).map(|_| Mutex::default()).collect();
    // Last first: see `Derived::of`.
    workers.each(count, &|i| {
        let i = count - 1 - i;
        *made[i].lock().unwrap_or_else(PoisonError::into_inner) = Some(make(i));
    });
    // Runs those that the workers skipped.
    let each = made.into_iter().enumerate();
    each.map(|(i, one)| one.into_inner().unwrap_or_else(PoisonError::into_inner).unwrap_or_else(|| make(i))).collect()
}

/// A sum over pixels.
#[derive(Clone)]
enum Sum {
    /// F, gradient and Hessian, in this parameter order.
    Derivatives(Vec<ParameterId>, Curvature),
    Value(ValueKind),
}

impl Sum {
    fn of(model: &Model, job: Job, offset: Option<ParameterId>) -> Sum {
        let last = || model.stages().last().map_or(&[][..], |stage| &stage.parameters);
        let free = |parameters: &[ParameterId]| parameters.iter().copied().chain(offset).collect();
        match job {
            Job::Stage(index) => {
                let method = if offset.is_some() { held(model, index) } else { model.stages()[index].method };
                Sum::Derivatives(free(&model.stages()[index].parameters), curvature(method))
            }
            Job::Covariance | Job::Opening | Job::Closing => Sum::Derivatives(free(last()), Curvature::GaussNewton),
            // With an offset, F has derivatives with respect to it.
            Job::Value if offset.is_some() => Sum::Derivatives(free(&[]), Curvature::GaussNewton),
            Job::Value => Sum::Value(ValueKind::Entry),
            Job::Report => Sum::Value(ValueKind::Full),
        }
    }

    /// True when the outputs are the same as the other's, in any order.
    fn has_outputs_of(&self, other: &Sum) -> bool {
        match (self, other) {
            (Sum::Derivatives(a, curvature), Sum::Derivatives(b, wanted)) => {
                curvature == wanted && a.len() == b.len() && a.iter().all(|parameter| b.contains(parameter))
            }
            (Sum::Value(a), Sum::Value(b)) => a == b,
            _ => false,
        }
    }
}

impl Derived {
    /// The distinct sums of all jobs of a model, for each of its summands.
    pub fn of(model: &Model, workers: &dyn Workers) -> Result<Derived, CompileFailure> {
        Derived::with_offset(model, None, workers)
    }

    /// Like [`Derived::of`], with an offset of the pixels free in each sum.
    pub fn of_rows(model: &Model, workers: &dyn Workers) -> Result<Derived, CompileFailure> {
        let (model, offset) = model.with_offset();
        Derived::with_offset(&model, Some(offset), workers)
    }

    fn with_offset(
        model: &Model,
        offset: Option<ParameterId>,
        workers: &dyn Workers,
    ) -> Result<Derived, CompileFailure> {
        // The last stage comes first: its parameter order is the covariance's.
        let mut jobs: Vec<Job> = (0..model.stages().len()).rev().map(Job::Stage).collect();
        jobs.extend((!jobs.is_empty()).then_some(Job::Covariance));
        jobs.push(Job::Value);
        if model.has_noise() && offset.is_none() {
            jobs.push(Job::Report);
        }
        let mut sums: Vec<Sum> = Vec::new();
        let served = jobs.into_iter().map(|job| {
            let wanted = Sum::of(model, job, offset);
            let known = sums.iter().position(|sum| sum.has_outputs_of(&wanted));
            (job, known.unwrap_or_else(|| (sums.len(), sums.push(wanted)).0))
        });
        let jobs = served.collect();
        // The last stage has the most parameters; starting with the largest work avoids waiting for it alone. `all` begins
        // at the end.
        let order: Vec<usize> = (0..sums.len()).rev().collect();
        let of = |summands: &[Summand]| {
            all(order.len() * summands.len(), workers, &|i| {
                let sum = order[i / summands.len()];
                part(&summands[i % summands.len()], sum, &sums[sum])
            })
        };
        // Rows have an offset per entry of `observed`.
        let joint = if offset.is_none() { joint(model) } else { None };
        let parts = match joint.map(|summands| of(&summands)) {
            Some(Ok(parts)) => parts,
            // A joint loop may exceed limits that separate loops do not.
            _ => of(&model.summands())?,
        };
        let derived = Derived { parts, jobs, offset, weight: 1 };
        let weight = derived.pass_weight();
        Ok(Derived { weight, ..derived })
    }

    fn pass_weight(&self) -> usize {
        let joint = self.sum_of(Job::Covariance);
        let parts = self.parts.iter().filter(|part| Some(part.sum) == joint && !part.is_clipped);
        let flops = |part: &SummandPrograms| {
            let Cost { flops_per_pixel, calls, .. } = part.plain.cost();
            (flops_per_pixel + CALL_FLOPS * calls.values().sum::<u32>()) as usize
        };
        (parts.map(flops).sum::<usize>() / USUAL_FLOPS).max(1)
    }

    /// The last stage, where it frees every parameter of the others and sums what the covariance needs: fits from nearby
    /// then skip the others.
    pub fn refine_stage(&self, model: &Model) -> Option<usize> {
        let (last, earlier) = model.stages().split_last()?;
        let is_whole = earlier.iter().flat_map(|stage| &stage.parameters).all(|one| last.parameters.contains(one));
        let stage = earlier.len();
        (is_whole && self.sum_of(Job::Stage(stage)) == self.sum_of(Job::Covariance)).then_some(stage)
    }

    /// Adds the sums of fits from nearby, where a stage suffices for them. Where they exceed a document's limits, such fits
    /// do without.
    pub fn add_refine_sums(&mut self, model: &Model, workers: &dyn Workers) {
        if self.refine_stage(model).is_none() {
            return;
        }
        let joint = self.sum_of(Job::Covariance);
        let of_joint: Vec<&SummandPrograms> = self.parts.iter().filter(|part| Some(part.sum) == joint).collect();
        let jobs = if model.has_noise() { &[Job::Opening, Job::Closing][..] } else { &[Job::Closing] };
        let first = self.parts.iter().map(|part| part.sum + 1).max().unwrap_or(0);
        let parts = all(jobs.len() * of_joint.len(), workers, &|i| {
            let (number, part) = (i / of_joint.len(), of_joint[i % of_joint.len()]);
            let objective = match jobs[number] {
                Job::Opening => part.objective.opening(),
                _ => part.objective.closing(),
            };
            let kind = (part.is_clipped, part.is_joint);
            let part = SummandPrograms::of(objective.map_err(CompileFailure::Model)?, first + number, kind)?;
            Ok(SummandPrograms { is_refine_only: true, ..part })
        });
        if let Ok(parts) = parts {
            self.parts.extend(parts);
            self.jobs.extend(jobs.iter().copied().zip(first..));
        }
    }

    /// A job's free parameters, in the order of its sums.
    pub fn order(&self, job: Job) -> &[ParameterId] {
        let sum = self.sum_of(job);
        let part = self.parts.iter().find(|part| Some(part.sum) == sum);
        part.map_or(&[], |part| part.objective.subset())
    }

    pub fn sum_of(&self, job: Job) -> Option<usize> {
        self.jobs.iter().find(|(known, _)| *known == job).map(|(_, sum)| *sum)
    }
}

/// The summands with all unsaturated ones joined, where they share work.
fn joint(model: &Model) -> Option<Vec<Summand>> {
    let summands = model.summands();
    let joint = Summand::joint(&summands)?;
    Some([joint].into_iter().chain(summands.into_iter().filter(|summand| summand.is_clipped())).collect())
}

/// The programs of a sum.
fn part(summand: &Summand, sum: usize, what: &Sum) -> Result<SummandPrograms, CompileFailure> {
    let objective = match what {
        Sum::Derivatives(parameters, Curvature::Full) => summand.objective(parameters, Method::Newton),
        Sum::Derivatives(parameters, Curvature::GaussNewton) => summand.objective(parameters, Method::GaussNewton),
        Sum::Value(kind) => summand.value_objective(*kind),
    };
    SummandPrograms::of(objective.map_err(CompileFailure::Model)?, sum, (summand.is_clipped(), summand.entries() > 1))
}

impl SummandPrograms {
    fn of(
        objective: Objective,
        sum: usize,
        (is_clipped, is_joint): (bool, bool),
    ) -> Result<SummandPrograms, CompileFailure> {
        let lowered = |handling| objective.program(lowering(handling)).map_err(CompileFailure::Model);
        let (plain, dropping) = (lowered(PixelHandling::All)?, lowered(PixelHandling::SkipSaturated)?);
        Ok(SummandPrograms { sum, is_clipped, is_joint, is_refine_only: false, plain, dropping, objective })
    }
}
