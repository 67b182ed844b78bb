//! A model whose pixels may be off by something that many of them have in common: an offset a row, say.
//!
//! What comes in: a checked model. What goes out: a model with one more parameter. It never knows which pixels share it.

use std::sync::Arc;

use crate::language::budget::Budget;
use crate::language::model::{Formulas, Model, Observation, Parameter, Start};
use crate::program::{Input, ParameterId};

impl Model {
    /// The model with a parameter more, the last one, in pixel values: it is added to the intensity of every entry of
    /// `observed`, and not to what its noise follows from. No stage frees it.
    pub fn with_offset(&self) -> (Model, ParameterId) {
        let mut model = self.clone();
        let id = ParameterId(model.parameters.len() as u32);
        model.parameters.push(Parameter {
            name: "common.offset".to_string(),
            start: Start::Number(0.0),
            others: Vec::new(),
            min: None,
            max: None,
            unit: None,
            span: Default::default(),
        });
        let mut graph = model.formulas.graph.drawing_on(Budget::default());
        let offset = graph.input(Input::Parameter(id));
        let mut entries = model.formulas.entries.clone();
        for entry in &mut entries {
            entry.intensity = graph.add2(entry.intensity, offset);
            graph.set_opaque(entry.intensity);
        }
        let Observation { observed, intensity, shown, noise } = entries[0];
        let graph = Arc::new(graph);
        let formulas = Formulas { graph, observed, intensity, shown, noise, entries, ..model.formulas };
        (Model { formulas, ..model }, id)
    }
}
