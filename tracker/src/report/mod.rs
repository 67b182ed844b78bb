//! `CheckReport`: what `model check` says about a model that compiles.

use std::collections::BTreeMap;

use isophote_jit::{Kernel, KernelOptions, PixelFormat};
use isophote_symbolic::{Diagnostics, Lowering, Method, Model, Objective, Proof};
use serde::{Deserialize, Serialize};

use crate::compiled::{CompileFailure, Compiled, Control, lowering};

/// Costs and self-check of a model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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
}

/// What one gradient pass of a stage costs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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
            parameters: objective.subset().iter().map(|id| model.parameters()[id.index()].name.clone()).collect(),
            method,
            flops_per_pixel: cost.flops_per_pixel,
            accumulators: cost.accumulators,
            flops_per_row: cost.flops_per_row,
            flops_per_pass: cost.flops_per_pass,
            calls: cost.calls.iter().map(|(name, count)| (name.to_string(), *count)).collect(),
            proof: objective.proof().copied(),
            compile_ms,
        })
    }
}

impl Compiled {
    /// Derives and compiles every stage once more, on 8-bit pixels, and says what it costs. `clock_ns`: any monotonic clock.
    ///
    /// # Errors
    /// When a kernel cannot be made.
    pub fn report(&self, clock_ns: &dyn Fn() -> u64) -> Result<CheckReport, CompileFailure> {
        let model = self.model();
        let mut stages = Vec::new();
        for stage in model.stages() {
            let begin_ns = clock_ns();
            let objective = model.objective(&stage.parameters, stage.method).map_err(CompileFailure::Model)?;
            let program = objective.program(lowering(Control::Plain)).map_err(CompileFailure::Model)?;
            let channels = model.channels().len();
            let options = KernelOptions {
                precision: self.precision(),
                formats: vec![PixelFormat::U8; channels],
                packed: channels == 1,
            };
            Kernel::compile(&program, &options).map_err(|error| CompileFailure::Kernel(error.into()))?;
            let end_ns = clock_ns();
            let compile_ms = end_ns.saturating_sub(begin_ns) as f64 / 1e6;
            let cost = StageCost::of(model, &objective, stage.method, lowering(Control::Plain), compile_ms);
            stages.push(cost.map_err(CompileFailure::Model)?);
        }
        let errors = stages.iter().filter_map(|stage| stage.proof?.error);
        Ok(CheckReport {
            model: model.name().to_string(),
            digest: model.digest().to_string(),
            self_check_error: errors.reduce(f64::max),
            stages,
        })
    }
}
