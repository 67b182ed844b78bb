//! `PredictedPlanes`: a model's predictions of each pixel, compiled for previews: intensities, NaN outside the domain,
//! and standard deviations.
//!
//! It has its own kernels, so that no fit waits for their compilation.

use isophote_jit::{Kernel, KernelOptions, VectorWidth, Window};
use isophote_symbolic::{Bindings, Model, Precision, Prediction, Summand};

use crate::sight::grey::Mixture;
use crate::solve::stage_kernels::{PixelHandling, lowering};

/// Kernels of one observed value, as far as it can be predicted without the frame.
struct PredictedEntry {
    mixture: Option<Mixture>,
    intensity: Option<Kernel>,
    /// Absent without `noise`, and when that reads the frame.
    variance: Option<Kernel>,
}

/// See above.
pub(super) struct PredictedPlanes {
    entries: Vec<PredictedEntry>,
    constants: Vec<f64>,
}

/// Prediction of one observed value for each pixel of a window.
pub(super) struct PredictedValue<'a> {
    /// How the planes combine to the observed value.
    pub mixture: &'a Mixture,
    /// NaN outside of the domain.
    pub intensity: Vec<f32>,
    /// Standard deviation by `noise`; absent when it cannot be predicted.
    pub deviation: Option<Vec<f32>>,
}

impl PredictedPlanes {
    /// Derives and compiles; failures leave values unknown.
    pub fn new(model: &Model, constants: &[f64]) -> PredictedPlanes {
        let kernel = |summand: &Summand, what| -> Option<Kernel> {
            let program = summand.prediction(what, lowering(PixelHandling::All))?.ok()?;
            let (width, precision) = (VectorWidth::Bits128, Precision::F32);
            Kernel::compile(&program, &KernelOptions { width, precision, formats: Vec::new(), packed: true }).ok()
        };
        let summands = model.summands().into_iter().filter(|summand| !summand.is_clipped());
        let entry = |summand: Summand| PredictedEntry {
            mixture: Mixture::of_summand(&summand, constants),
            intensity: kernel(&summand, Prediction::Intensity),
            variance: kernel(&summand, Prediction::Variance).filter(|_| model.has_noise()),
        };
        PredictedPlanes { entries: summands.map(entry).collect(), constants: constants.to_vec() }
    }

    /// Predictions in a window, for each observed value where known.
    pub fn of(&self, parameters: &[f64], window: Window) -> Vec<PredictedValue<'_>> {
        let constants = &self.constants;
        let bindings = Bindings { parameters, entry: parameters, constants, saturation: &[], shift: &[] };
        let plane = |kernel: &Kernel| {
            let mut plane = vec![0.0; window.pixels()];
            kernel.render(&bindings, window, &mut plane).ok().map(|()| plane)
        };
        let deviation = |kernel: &Kernel| {
            let mut variance = plane(kernel)?;
            variance.iter_mut().for_each(|value| *value = value.sqrt());
            Some(variance)
        };
        let one = |entry: &'_ PredictedEntry| -> Option<(Vec<f32>, Option<Vec<f32>>)> {
            Some((plane(entry.intensity.as_ref()?)?, entry.variance.as_ref().and_then(deviation)))
        };
        let known = self.entries.iter().filter_map(|entry| {
            let (intensity, deviation) = one(entry)?;
            Some(PredictedValue { mixture: entry.mixture.as_ref()?, intensity, deviation })
        });
        known.collect()
    }

    /// The intensity of the first observed value alone.
    pub fn first(&self, parameters: &[f64], window: Window) -> Option<Vec<f32>> {
        let constants = &self.constants;
        let bindings = Bindings { parameters, entry: parameters, constants, saturation: &[], shift: &[] };
        let kernel = self.entries.first()?.intensity.as_ref()?;
        let mut plane = vec![0.0; window.pixels()];
        kernel.render(&bindings, window, &mut plane).ok()?;
        Some(plane)
    }
}
