//! `PredictedPlanes`: what a model predicts of each pixel, compiled for whoever looks.
//!
//! What comes in: a model. What goes out: intensities, NaN outside of the domain, and standard deviations. Its kernels are its own:
//! no fit ever waits until they are compiled.

use isophote_jit::{Kernel, KernelOptions, VectorWidth, Window};
use isophote_symbolic::{Bindings, Model, Precision, Prediction};

use crate::sight::grey::Mixture;
use crate::solve::stage_kernels::{Control, lowering};

/// One observed value, as far as it can be predicted without the picture.
struct PredictedEntry {
    mixture: Option<Mixture>,
    intensity: Option<Kernel>,
    /// Absent without `noise`, and where that reads the picture.
    variance: Option<Kernel>,
}

/// See above.
pub(super) struct PredictedPlanes {
    entries: Vec<PredictedEntry>,
    constants: Vec<f64>,
}

/// Of one observed value, for each pixel of a window.
pub(super) struct PredictedValue<'a> {
    /// How the planes make what is observed.
    pub mixture: &'a Mixture,
    /// NaN outside of the domain.
    pub intensity: Vec<f32>,
    /// What `noise` states; absent where it states nothing that is known here.
    pub deviation: Option<Vec<f32>>,
}

impl PredictedPlanes {
    /// Derives and compiles; what cannot be stays unknown.
    pub fn new(model: &Model, constants: &[f64]) -> PredictedPlanes {
        let kernel = |model: &Model, what| -> Option<Kernel> {
            let program = model.prediction(what, lowering(Control::Plain))?.ok()?;
            let (width, precision) = (VectorWidth::Bits128, Precision::F32);
            Kernel::compile(&program, &KernelOptions { width, precision, formats: Vec::new(), packed: true }).ok()
        };
        let summands = model.summands().into_iter().filter(|summand| !summand.is_clipped);
        let entry = |summand: isophote_symbolic::Summand| PredictedEntry {
            mixture: Mixture::linear(&summand.model, constants),
            intensity: kernel(&summand.model, Prediction::Intensity),
            variance: kernel(&summand.model, Prediction::Variance).filter(|_| model.has_noise()),
        };
        PredictedPlanes { entries: summands.map(entry).collect(), constants: constants.to_vec() }
    }

    /// What is predicted in a window, of each observed value of which it is known.
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
