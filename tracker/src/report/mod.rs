//! `CheckReport`: what `model check` says about a model that compiles, and about what it promises.
//!
//! What comes in: a model's programs. What goes out: costs, self-check, and at made-up points the condition of each stage, the
//! Cramér–Rao bound and the best exposure. It never sees a frame.

mod bodies;
mod information;
mod loops;
mod outlook;
pub(crate) mod points;
#[cfg(test)]
mod tests;
mod unread;

use std::collections::BTreeMap;

use isophote_jit::{KernelOptions, PixelFormat, VectorWidth};
use isophote_symbolic::{Diagnostic, Diagnostics, Lowering, Method, Model, Objective, ParameterId, Proof, Stage};
use serde::{Deserialize, Serialize};

use self::outlook::Outlook;
use crate::exposure::ExposureAdvice;
use crate::solve::compiled::Compiled;
use crate::solve::stage_kernels::{CompileFailure, Control, lowering};
pub use bodies::{over_pixels_of, plain_flops, plain_program};
pub use loops::{BodyCost, LoopCost, LoopSums, loop_costs};

/// Costs and self-check of a model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct CheckReport {
    /// The model's name.
    pub model: String,
    /// Of its document.
    pub digest: String,
    /// One a stage.
    pub stages: Vec<StageCost>,
    /// The largest error of a stage's program in f64, over the sum of the absolute terms, at a made-up point (see
    /// [`Proof`]). Absent when F is finite at none.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub self_check_error: Option<f64>,
    /// What the model promises; absent where the normal equations are singular at the made-up point, or nothing can be made
    /// up.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub bound: Option<Bound>,
    /// How much light would be best for the target of `bound` on an 8-bit camera: for its centre and for its brightness, as
    /// far as the model has them.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub exposure: Vec<ExposureAdvice>,
    /// What is doubtful in the document.
    #[serde(default)]
    pub warnings: Vec<Diagnostic>,
}

/// The Cramér–Rao bound at a made-up point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Bound {
    /// The point: all parameters, by name.
    pub parameters: BTreeMap<String, f64>,
    /// The least standard deviation that an unbiased fit can have, for each free parameter of the last stage.
    pub deviation: BTreeMap<String, f64>,
    /// Share of the target that is saturated.
    pub saturated: f64,
    /// The standard deviation of a pixel that this is for, in pixel values; absent where the model says it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub noise: Option<f64>,
}

/// What one gradient pass of a stage costs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct StageCost {
    /// Names of the free parameters.
    pub parameters: Vec<String>,
    /// How the Hessian is made.
    pub method: Method,
    /// + − × ÷ √, an FMA 2, accumulation included, F itself not.
    pub flops_per_pixel: u32,
    /// Sums kept a pixel.
    pub accumulators: u32,
    /// Flops a row.
    pub flops_per_row: u32,
    /// Flops a pass.
    pub flops_per_pass: u32,
    /// Elementary functions a pixel, by name.
    pub calls: BTreeMap<String, u32>,
    /// What the check of its program found.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub proof: Option<Proof>,
    /// From checked model to native code.
    pub compile_ms: f64,
    /// The reciprocal condition of the Fisher matrix with a unit diagonal at the made-up point of the bound: 1 is best, 0 is
    /// singular. Absent where it is not known, also for parameters that the last stage does not free.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub condition: Option<f64>,
    /// The same with 30 % of the target saturated.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub condition_saturated: Option<f64>,
}

impl StageCost {
    /// The figures of an objective.
    ///
    /// # Errors
    /// When its program is too long.
    pub fn of(
        model: &Model,
        objective: &Objective,
        method: Method,
        lowering: Lowering,
        compile_ms: f64,
    ) -> Result<StageCost, Diagnostics> {
        let cost = objective.cost(lowering)?;
        Ok(StageCost {
            parameters: names(model, objective.subset()),
            method,
            flops_per_pixel: cost.flops_per_pixel,
            accumulators: cost.accumulators,
            flops_per_row: cost.flops_per_row,
            flops_per_pass: cost.flops_per_pass,
            calls: cost.calls.iter().map(|(name, count)| (name.to_string(), *count)).collect(),
            proof: objective.proof().copied(),
            compile_ms,
            condition: None,
            condition_saturated: None,
        })
    }
}

fn names(model: &Model, parameters: &[ParameterId]) -> Vec<String> {
    parameters.iter().map(|id| model.parameters()[id.index()].name.clone()).collect()
}

impl Compiled {
    /// Derives and compiles every stage once more, on 8-bit pixels, and says what it costs and promises. `clock_ns`: any
    /// monotonic clock.
    ///
    /// # Errors
    /// When a kernel cannot be made, or parameters of the last stage can never be told apart.
    pub fn report(&self, clock_ns: &dyn Fn() -> u64) -> Result<CheckReport, CompileFailure> {
        let model = self.model();
        let mut stages: Vec<StageCost> = Vec::new();
        for (index, stage) in model.stages().iter().enumerate() {
            // Stages that free the same parameters by the same method share a program.
            let is_same = |other: &Stage| {
                let mut sets = [stage, other].map(|stage| stage.parameters.clone());
                sets.iter_mut().for_each(|set| set.sort());
                sets[0] == sets[1] && stage.method == other.method
            };
            if let Some(known) = model.stages()[..index].iter().position(is_same) {
                stages.push(StageCost { parameters: names(model, &stage.parameters), ..stages[known].clone() });
                continue;
            }
            let begin_ns = clock_ns();
            let objective = model.objective(&stage.parameters, stage.method).map_err(CompileFailure::Model)?;
            let program = objective.program(lowering(Control::Plain)).map_err(CompileFailure::Model)?;
            let channels = model.channels().len();
            let options = KernelOptions {
                width: VectorWidth::Bits128,
                precision: self.precision(),
                formats: vec![PixelFormat::U8; channels],
                packed: channels == 1,
            };
            self.cache().compile(&program, &options).map_err(|error| CompileFailure::Kernel(error.into()))?;
            let end_ns = clock_ns();
            let compile_ms = end_ns.saturating_sub(begin_ns) as f64 / 1e6;
            let cost = StageCost::of(model, &objective, stage.method, lowering(Control::Plain), compile_ms);
            stages.push(cost.map_err(CompileFailure::Model)?);
        }
        let outlook = Outlook::of(self).map_err(CompileFailure::Model)?;
        for (stage, [clear, saturated]) in stages.iter_mut().zip(outlook.conditions) {
            (stage.condition, stage.condition_saturated) = (clear, saturated);
        }
        let errors = stages.iter().filter_map(|stage| stage.proof?.error);
        Ok(CheckReport {
            model: model.name().to_string(),
            digest: model.digest().to_string(),
            self_check_error: errors.reduce(f64::max),
            stages,
            bound: outlook.bound,
            exposure: outlook.exposure,
            warnings: outlook.warnings,
        })
    }
}
