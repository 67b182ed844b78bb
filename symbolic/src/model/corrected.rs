//! Derives a model with per-pixel corrections of its predictions: the mean over a pixel's area minus the mean over a
//! few of its points is read from a plane instead of being computed in every pass.

use std::sync::Arc;

use crate::model::{Formulas, Model, Observation};
use crate::program::ChannelId;

/// The quantity that a corrected model differentiates.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Slopes {
    /// The intensity at the pixel's centre.
    Centre,
    /// Its mean over the pixel, as the document's `quadrature` says.
    Mean,
}

impl Model {
    /// The model with one more channel per entry of `observed`, behind the others; its value is added to the entry's
    /// intensity. Derivatives treat it as a constant, so they are the gradient of the F that is summed.
    pub fn corrected(&self, slopes: Slopes) -> Model {
        let mut model = self.clone();
        let mut graph = model.formulas.graph.drawing_on(self.rewriting());
        let mut entries = model.formulas.entries.clone();
        for (number, entry) in entries.iter_mut().enumerate() {
            let correction = graph.channel(ChannelId(model.channels.len() as u32));
            model.channels.push(format!("correction.{number}"));
            let sampled = match slopes {
                Slopes::Centre => entry.shown,
                Slopes::Mean => entry.intensity,
            };
            let intensity = graph.add2(sampled, correction);
            graph.set_opaque(intensity);
            let noise = entry.noise.map(|noise| graph.replaced(noise, entry.intensity, intensity));
            *entry = Observation { intensity, noise, ..*entry };
        }
        let formulas = Formulas { graph: Arc::new(graph), entries, ..model.formulas };
        Model { formulas, ..model }
    }
}
