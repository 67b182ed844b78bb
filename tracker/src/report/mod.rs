//! `CheckReport`, the result of `model check` for a model that compiles: costs, self-check, and at synthetic points the
//! condition of each stage, the Cramér–Rao bound and the best exposure.

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
use crate::solve::stage_kernels::{CompileFailure, PixelHandling, lowering};
pub use bodies::{over_pixels_of, plain_flops, plain_program};
pub use loops::{BodyCost, LoopCost, LoopSums, loop_costs};

/// Costs and self-check of a model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct CheckReport {
    /// The model's name.
    pub model: String,
    /// Digest of its document.
    pub digest: String,
    /// Costs of each stage.
    pub stages: Vec<StageCost>,
    /// Largest error of any stage's program in f64, relative to the sum of the absolute terms, at synthetic points (see
    /// [`Proof`]). Absent if F is finite at none of them.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub self_check_error: Option<f64>,
    /// The Cramér–Rao bound; absent if the normal equations are singular at the synthetic point or no such point exists.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub bound: Option<Bound>,
    /// The best exposure for the target of `bound` on an 8-bit camera: for its centre and for its brightness, if the model
    /// has them.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub exposure: Vec<ExposureAdvice>,
    /// Warnings about the document.
    #[serde(default)]
    pub warnings: Vec<Diagnostic>,
}

/// The Cramér–Rao bound at a synthetic point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Bound {
    /// All parameters of the point, by name.
    pub parameters: BTreeMap<String, f64>,
    /// Least standard deviation of an unbiased fit, for each free parameter of the last stage.
    pub deviation: BTreeMap<String, f64>,
    /// Saturated share of the target.
    pub saturated: f64,
    /// Assumed standard deviation of a pixel, in pixel values; absent if the model states its noise.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub noise: Option<f64>,
}

/// Cost of one gradient pass of a stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct StageCost {
    /// Names of the free parameters.
    pub parameters: Vec<String>,
    /// Fit method of the stage; it determines the Hessian.
    pub method: Method,
    /// Flops per pixel: + − × ÷ √ count 1, an FMA 2; including accumulation, without F itself.
    pub flops_per_pixel: u32,
    /// Sums accumulated per pixel.
    pub accumulators: u32,
    /// Flops per row.
    pub flops_per_row: u32,
    /// Flops per pass.
    pub flops_per_pass: u32,
    /// Elementary function calls per pixel, by name.
    pub calls: BTreeMap<String, u32>,
    /// Result of the check of its program.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub proof: Option<Proof>,
    /// Time from the checked model to native code, ms.
    pub compile_ms: f64,
    /// Reciprocal condition number of the Fisher matrix, scaled to a unit diagonal, at the synthetic point of the bound: 1 is
    /// best, 0 is singular. Absent if unknown, or if the last stage does not free all parameters of this stage.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub condition: Option<f64>,
    /// `condition` with 30 % of the target saturated.
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
    /// Derives and compiles every stage once more, on 8-bit pixels, and reports costs and bounds. `clock_ns`: any
    /// monotonic clock.
    ///
    /// # Errors
    /// When a kernel fails to compile, or parameters of the last stage are degenerate everywhere.
    pub fn report(&self, clock_ns: &dyn Fn() -> u64) -> Result<CheckReport, CompileFailure> {
        let model = self.model();
        let mut stages: Vec<StageCost> = Vec::new();
        for (index, stage) in model.stages().iter().enumerate() {
            // Stages with the same parameters and method share a program.
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
            let program = objective.program(lowering(PixelHandling::All)).map_err(CompileFailure::Model)?;
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
            let cost = StageCost::of(model, &objective, stage.method, lowering(PixelHandling::All), compile_ms);
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
