//! `Residuals`: what a model with given parameters leaves unexplained, pixel by pixel.
//!
//! What comes in: a model's predictions and a picture. What goes out: whitened residuals over the model's domain. It never
//! knows how the parameters were found.

use std::sync::Arc;

use isophote_jit::{Kernel, KernelCache, KernelOptions, Window};
use isophote_symbolic::{Bindings, Model, Precision, Prediction};

use crate::sight::grey::{Grey, Mixture};
use crate::sight::view::View;
use crate::solve::stage_kernels::{CompileFailure, Control, lowering};

/// Predictions of one observed value.
struct Observed {
    model: Model,
    intensity: Arc<Kernel>,
    unbounded: Arc<Kernel>,
    variance: Arc<Kernel>,
}

/// The predictions of a model, compiled.
pub(crate) struct Predictions {
    entries: Vec<Observed>,
}

/// Which pixels of a window are looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Over {
    /// Those of the domain.
    Domain,
    /// All.
    Everything,
}

/// A pixel of the domain.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Residual {
    /// Its number in the window.
    pub pixel: usize,
    /// Predicted intensity.
    pub predicted: f64,
    /// (observed − predicted)/σ; of a saturated pixel what the prediction lacks to the limit, at least 0.
    pub whitened: f64,
    /// σ; 1 where the model does not say it.
    pub deviation: f64,
    pub saturated: bool,
}

/// Of one observed value.
pub(crate) struct Seen {
    /// In the order of the window's pixels.
    pub residuals: Vec<Residual>,
    /// The limit, a value of what is observed.
    pub limit: f64,
}

impl Predictions {
    /// Nothing for a model whose variance is not predicted.
    pub fn new(
        model: &Model,
        precision: Precision,
        cache: &KernelCache,
    ) -> Result<Option<Predictions>, CompileFailure> {
        let options = KernelOptions { width: cache.width(), precision, formats: Vec::new(), packed: true };
        let kernel = |model: &Model, what| -> Result<Option<Arc<Kernel>>, CompileFailure> {
            let Some(program) = model.prediction(what, lowering(Control::Plain)) else { return Ok(None) };
            let program = program.map_err(CompileFailure::Model)?;
            let kernel = cache.get_or_compile_wide(&program, &options);
            kernel.map(Some).map_err(|error| CompileFailure::Kernel(Arc::new(error)))
        };
        let mut entries = Vec::new();
        for summand in model.summands().into_iter().filter(|summand| !summand.is_clipped) {
            let model = summand.model;
            let [intensity, unbounded, variance] =
                [Prediction::Intensity, Prediction::Unbounded, Prediction::Variance].map(|what| kernel(&model, what));
            let (Some(intensity), Some(unbounded), Some(variance)) = (intensity?, unbounded?, variance?) else {
                return Ok(None);
            };
            entries.push(Observed { model, intensity, unbounded, variance });
        }
        Ok(Some(Predictions { entries }))
    }

    /// The residuals of each observed value; `None` when a kernel refuses, or nobody waits any longer.
    pub fn residuals(&self, view: &View, parameters: &[f64], constants: &[f64], over: Over) -> Option<Vec<Seen>> {
        // Two predictions, and the picture.
        view.spend(3 * self.entries.len() * view.window.pixels()).ok()?;
        let saturation = &view.saturation;
        let bindings = Bindings { parameters, entry: parameters, constants, saturation, shift: &[] };
        let one = |entry: &Observed| {
            let kernel = match over {
                Over::Domain => &entry.intensity,
                Over::Everything => &entry.unbounded,
            };
            let predicted = plane(kernel, &bindings, view.window)?;
            let variance = plane(&entry.variance, &bindings, view.window)?;
            let mut observed =
                Grey::as_it_is(&view.planes, view.window, saturation, &Mixture::linear(&entry.model, constants)?);
            observed.blank(view.window, &view.gaps);
            let limit = observed.saturation;
            let pixels = observed.values.iter().zip(predicted).zip(variance).enumerate();
            let residual = |(pixel, ((&value, predicted), variance)): (usize, ((&f64, f32), f32))| {
                let predicted = f64::from(predicted);
                let deviation = f64::from(variance).sqrt();
                let saturated = value >= limit;
                let difference = if saturated { (limit - predicted).max(0.0) } else { value - predicted };
                let whitened = difference / deviation;
                // NaN: outside of the domain, no number in the picture, or one that says nothing.
                (!whitened.is_nan()).then_some(Residual { pixel, predicted, whitened, deviation, saturated })
            };
            Some(Seen { residuals: pixels.filter_map(residual).collect(), limit })
        };
        self.entries.iter().map(one).collect()
    }
}

fn plane(kernel: &Kernel, bindings: &Bindings, window: Window) -> Option<Vec<f32>> {
    let mut plane = vec![0.0; window.pixels()];
    kernel.render(bindings, window, &mut plane).ok()?;
    Some(plane)
}
