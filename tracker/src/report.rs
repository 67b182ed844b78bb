//! `CheckReport`: what `model check` says about a model that compiles.

use std::collections::BTreeMap;

use isophote_jit::{Kernel, KernelOptions, PixelFormat};
use isophote_symbolic::Method;
use serde::{Deserialize, Serialize};

use crate::compiled::{CompileFailure, Compiled, Control, lowering};
use crate::self_check::self_check;

/// Costs and self-check of a model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CheckReport {
    /// The model's name.
    pub model: String,
    /// Of its document.
    pub digest: String,
    /// One a stage.
    pub stages: Vec<StageCost>,
    /// The largest difference between a compiled derivative and a difference quotient of compiled values, relative to what
    /// the derivative can be at most (`√(2 F H_ii)`), on a made-up picture in f64. Absent when F is not finite there.
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
    /// From checked model to native code.
    pub compile_ms: f64,
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
            let cost = objective.cost(lowering(Control::Plain)).map_err(CompileFailure::Model)?;
            stages.push(StageCost {
                parameters: stage.parameters.iter().map(|id| model.parameters()[id.index()].name.clone()).collect(),
                method: stage.method,
                flops_per_pixel: cost.flops_per_pixel,
                accumulators: cost.accumulators,
                flops_per_row: cost.flops_per_row,
                flops_per_pass: cost.flops_per_pass,
                calls: cost.calls.iter().map(|(name, count)| (name.to_string(), *count)).collect(),
                compile_ms: end_ns.saturating_sub(begin_ns) as f64 / 1e6,
            });
        }
        Ok(CheckReport {
            model: model.name().to_string(),
            digest: model.digest().to_string(),
            stages,
            self_check_error: self_check(model)?,
        })
    }
}
