//! Evaluates the first entry of a model's `observed` ([`Model::summands`] has one summand per entry): its prediction,
//! for rendering and for colours before a fit.

use crate::graph::{Node, NodeId};
use crate::model::{Leaves, Model};
use crate::program::Input;

impl Model {
    /// True when each observation is a plain channel.
    pub fn observes_channels(&self) -> bool {
        let is_channel = |node: NodeId| matches!(self.formulas.graph.node(node), Node::Channel(_));
        self.formulas.entries.iter().all(|entry| is_channel(entry.observed))
    }

    /// The intensity of the model's first observation at a position (one number a coordinate), in pixel values.
    pub fn predicted(&self, place: &[f64], parameters: &[f64], constants: &[f64]) -> f64 {
        self.at_place(self.formulas.entries[0].shown, place, parameters, constants)
    }

    /// The variances that the document states by channels, coordinates and constants alone, as for a table with an
    /// error column; observations without a value are left out.
    pub fn stated_variances(&self, place: &[f64], channels: &[f64], constants: &[f64]) -> Vec<f64> {
        let graph = &self.formulas.graph;
        let leaves = Leaves { place, channels, constants, ..Leaves::default() };
        let value = |node: NodeId| graph.evaluate(node, &|node| leaves.value(node));
        let is_parameter = |node: NodeId| matches!(graph.node(node), Node::Input(Input::Parameter(_)));
        let is_stated = |noise: &NodeId| !graph.reachable(&[*noise]).into_iter().any(is_parameter);
        let seen = self.formulas.entries.iter().filter(|entry| !value(entry.observed).is_nan());
        seen.filter_map(|entry| entry.noise.filter(is_stated)).map(value).collect()
    }

    /// Evaluates a formula at a position; NaN where it reads a channel.
    pub(crate) fn at_place(&self, formula: NodeId, place: &[f64], parameters: &[f64], constants: &[f64]) -> f64 {
        let leaves = Leaves { place, parameters, constants, ..Leaves::default() };
        self.formulas.graph.evaluate(formula, &|node| leaves.value(node))
    }
}
