//! A model whose predictions are corrected pixel by pixel: what the mean over a pixel's area has beyond a few points of it is
//! read from a plane, and not worked out in every pass.
//!
//! What comes in: a checked model. What goes out: a model with more channels. It never knows what stands in them.

use std::sync::Arc;

use crate::language::model::{Formulas, Model, Observation};
use crate::program::ChannelId;

/// What a corrected model's derivatives are taken of.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Slopes {
    /// The intensity at the pixel's centre.
    Centre,
    /// Its mean over the pixel, as the document's `quadrature` says.
    Mean,
}

impl Model {
    /// The model with a channel more for each entry of `observed`, behind those that it has: what stands there is added to
    /// the entry's intensity. It is a number to all derivatives, so these are the gradient of the F that is summed.
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
        let Observation { observed, intensity, shown, noise } = entries[0];
        let graph = Arc::new(graph);
        let formulas = Formulas { graph, observed, intensity, shown, noise, entries, ..model.formulas };
        Model { formulas, ..model }
    }
}
