//! `Derived`: the programs of all that a model's fits sum.
//!
//! What comes in: a checked model. What goes out: a program for each sum and each of the model's summands. It never knows kernels.

use std::sync::{Mutex, PoisonError};

use isophote_symbolic::{Cost, Method, Model, Objective, ParameterId, Program, Summand, ValueKind};

use crate::solve::stage_kernels::{CompileFailure, Control, Job, curvature, held, lowering};
use crate::solve::trust::Curvature;
use crate::solve::workers::Workers;

/// A pixel of a pass of `spot` takes about so many flops, …
const USUAL_FLOPS: usize = 256;
/// … and an elementary function as long as so many.
const CALL_FLOPS: u32 = 400;

/// A sum for one of the model's summands.
pub(super) struct SummandPrograms {
    /// Which of the sums.
    pub sum: usize,
    pub is_clipped: bool,
    /// It sums several values of a pixel, and says of how many.
    pub is_joint: bool,
    /// It is asked for by fits from nearby alone.
    pub is_short: bool,
    pub plain: Program,
    pub dropping: Program,
    pub objective: Objective,
}

/// What is derived of a model. Jobs that ask for the same sum share it: stages that free the same parameters, the covariance
/// and a last stage with a Gauss–Newton Hessian.
pub(super) struct Derived {
    pub parts: Vec<SummandPrograms>,
    /// The sum that serves each job.
    pub jobs: Vec<(Job, usize)>,
    /// Free beside what each job asks for: the offset of the rows.
    pub offset: Option<ParameterId>,
    /// What a pixel of a pass of the last stage costs, in pixels of a usual one.
    pub weight: usize,
}

/// What each number gives, or the first fault.
pub(super) fn all<T: Send + Sync>(
    count: usize,
    workers: &dyn Workers,
    make: &(dyn Fn(usize) -> Result<T, CompileFailure> + Sync),
) -> Result<Vec<T>, CompileFailure> {
    let made: Vec<Mutex<Option<Result<T, CompileFailure>>>> = (0..count).map(|_| Mutex::default()).collect();
    // From the end: see `Derived::of`.
    workers.each(count, &|i| {
        let i = count - 1 - i;
        *made[i].lock().unwrap_or_else(PoisonError::into_inner) = Some(make(i));
    });
    // Whom the workers left out is done here.
    let each = made.into_iter().enumerate();
    each.map(|(i, one)| one.into_inner().unwrap_or_else(PoisonError::into_inner).unwrap_or_else(|| make(i))).collect()
}

/// Something to sum over pixels.
#[derive(Clone)]
enum Sum {
    /// F, gradient and Hessian, in this order of the parameters.
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
            // With an offset, F has derivatives by it.
            Job::Value if offset.is_some() => Sum::Derivatives(free(&[]), Curvature::GaussNewton),
            Job::Value => Sum::Value(ValueKind::Entry),
            Job::Report => Sum::Value(ValueKind::Full),
        }
    }

    /// True when the other one's outputs are these, in whatever order.
    fn serves(&self, other: &Sum) -> bool {
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
    /// The sums of every job of a model, each of them once, for each of its summands.
    pub fn of(model: &Model, workers: &dyn Workers) -> Result<Derived, CompileFailure> {
        Derived::with_offset(model, None, workers)
    }

    /// The same with an offset of the pixels free in each of them.
    pub fn of_rows(model: &Model, workers: &dyn Workers) -> Result<Derived, CompileFailure> {
        let (model, offset) = model.with_offset();
        Derived::with_offset(&model, Some(offset), workers)
    }

    fn with_offset(
        model: &Model,
        offset: Option<ParameterId>,
        workers: &dyn Workers,
    ) -> Result<Derived, CompileFailure> {
        // The last stage comes first: its order of parameters is that of the covariance.
        let mut jobs: Vec<Job> = (0..model.stages().len()).rev().map(Job::Stage).collect();
        jobs.extend((!jobs.is_empty()).then_some(Job::Covariance));
        jobs.push(Job::Value);
        if model.has_noise() && offset.is_none() {
            jobs.push(Job::Report);
        }
        let mut sums: Vec<Sum> = Vec::new();
        let served = jobs.into_iter().map(|job| {
            let wanted = Sum::of(model, job, offset);
            let known = sums.iter().position(|sum| sum.serves(&wanted));
            (job, known.unwrap_or_else(|| (sums.len(), sums.push(wanted)).0))
        });
        let jobs = served.collect();
        // The last stage has the most parameters, and work is begun at the end: nobody waits for it alone.
        let order: Vec<usize> = (0..sums.len()).rev().collect();
        let of = |summands: &[Summand]| {
            all(order.len() * summands.len(), workers, &|i| {
                let sum = order[i / summands.len()];
                part(&summands[i % summands.len()], sum, &sums[sum])
            })
        };
        // Rows have an offset for each entry of `observed`.
        let joint = if offset.is_none() { joint(model) } else { None };
        let parts = match joint.map(|summands| of(&summands)) {
            Some(Ok(parts)) => parts,
            // What is too much in one loop may not be in several.
            _ => of(&model.summands())?,
        };
        let derived = Derived { parts, jobs, offset, weight: 1 };
        let weight = derived.weighed();
        Ok(Derived { weight, ..derived })
    }

    fn weighed(&self) -> usize {
        let joint = self.sum_of(Job::Covariance);
        let parts = self.parts.iter().filter(|part| Some(part.sum) == joint && !part.is_clipped);
        let flops = |part: &SummandPrograms| {
            let Cost { flops_per_pixel, calls, .. } = part.plain.cost();
            (flops_per_pixel + CALL_FLOPS * calls.values().sum::<u32>()) as usize
        };
        (parts.map(flops).sum::<usize>() / USUAL_FLOPS).max(1)
    }

    /// The last stage, where it fits whatever the others do, and sums what the covariance is made of: nearby it does without them.
    pub fn short_stage(&self, model: &Model) -> Option<usize> {
        let (last, earlier) = model.stages().split_last()?;
        let is_whole = earlier.iter().flat_map(|stage| &stage.parameters).all(|one| last.parameters.contains(one));
        let stage = earlier.len();
        (is_whole && self.sum_of(Job::Stage(stage)) == self.sum_of(Job::Covariance)).then_some(stage)
    }

    /// The sums of fits from nearby, where a stage does for those. Where they are too much for a document, such fits go on without.
    pub fn add_short(&mut self, model: &Model, workers: &dyn Workers) {
        if self.short_stage(model).is_none() {
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
            Ok(SummandPrograms { is_short: true, ..part })
        });
        if let Ok(parts) = parts {
            self.parts.extend(parts);
            self.jobs.extend(jobs.iter().copied().zip(first..));
        }
    }

    /// The free parameters of a job, in the order of its sums.
    pub fn order(&self, job: Job) -> &[ParameterId] {
        let sum = self.sum_of(job);
        let part = self.parts.iter().find(|part| Some(part.sum) == sum);
        part.map_or(&[], |part| part.objective.subset())
    }

    pub fn sum_of(&self, job: Job) -> Option<usize> {
        self.jobs.iter().find(|(known, _)| *known == job).map(|(_, sum)| *sum)
    }
}

/// The summands with those of pixels below their limit in one, where they share work.
fn joint(model: &Model) -> Option<Vec<Summand>> {
    let summands = model.summands();
    let joint = Summand::joint(&summands)?;
    Some([joint].into_iter().chain(summands.into_iter().filter(|summand| summand.is_clipped)).collect())
}

/// The programs of a sum.
fn part(
    Summand { model, is_clipped, entries }: &Summand,
    sum: usize,
    what: &Sum,
) -> Result<SummandPrograms, CompileFailure> {
    let objective = match what {
        Sum::Derivatives(parameters, Curvature::Full) => model.objective(parameters, Method::Newton),
        Sum::Derivatives(parameters, Curvature::GaussNewton) => model.objective(parameters, Method::GaussNewton),
        Sum::Value(kind) => model.value_objective(*kind),
    };
    SummandPrograms::of(objective.map_err(CompileFailure::Model)?, sum, (*is_clipped, *entries > 1))
}

impl SummandPrograms {
    fn of(
        objective: Objective,
        sum: usize,
        (is_clipped, is_joint): (bool, bool),
    ) -> Result<SummandPrograms, CompileFailure> {
        let lowered = |control| objective.program(lowering(control)).map_err(CompileFailure::Model);
        let (plain, dropping) = (lowered(Control::Plain)?, lowered(Control::Dropping)?);
        Ok(SummandPrograms { sum, is_clipped, is_joint, is_short: false, plain, dropping, objective })
    }
}
