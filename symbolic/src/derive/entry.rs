//! What a model says of one value of a pixel, in numbers: for whoever renders or looks at colours before a fit.
//!
//! What comes in: a model, the first entry of whose `observed` is meant ([`Model::summands`] has one model for each).
//! What goes out: the channel that it is, and its prediction at a place. It never knows a picture.

use crate::language::graph::{Node, NodeId};
use crate::language::model::Model;
use crate::program::{ChannelId, Input};

impl Model {
    /// The channel that the model's first observation is; `None` where it is a formula over channels.
    pub fn observed_channel(&self) -> Option<ChannelId> {
        match self.formulas.graph.node(self.formulas.observed) {
            Node::Channel(channel) => Some(*channel),
            _ => None,
        }
    }

    /// True when each observation is a channel as it is.
    pub fn observes_channels(&self) -> bool {
        let is_channel = |node: NodeId| matches!(self.formulas.graph.node(node), Node::Channel(_));
        self.formulas.entries.iter().all(|entry| is_channel(entry.observed))
    }

    /// The intensity of the model's first observation at a place, in pixel values; one number a coordinate.
    pub fn predicted(&self, place: &[f64], parameters: &[f64], constants: &[f64]) -> f64 {
        self.at_place(self.formulas.shown, place, parameters, constants)
    }

    /// The variances of a pixel's observations that the document states by channels, coordinates and constants alone, as those of a
    /// table with a column of errors are; without those of observations that have no value.
    pub fn stated_variances(&self, place: &[f64], channels: &[f64], constants: &[f64]) -> Vec<f64> {
        let graph = &self.formulas.graph;
        let leaf = |node: &Node| match node {
            Node::Channel(channel) => channels[channel.index()],
            Node::Input(Input::Constant(c)) => constants[c.index()],
            Node::Coordinate(c) => place[c.index()],
            _ => f64::NAN,
        };
        let is_parameter = |node: NodeId| matches!(graph.node(node), Node::Input(Input::Parameter(_)));
        let is_stated = |noise: &NodeId| !graph.reachable(&[*noise]).into_iter().any(is_parameter);
        let seen = self.formulas.entries.iter().filter(|entry| !graph.evaluate(entry.observed, &leaf).is_nan());
        seen.filter_map(|entry| entry.noise.filter(is_stated)).map(|noise| graph.evaluate(noise, &leaf)).collect()
    }

    /// A formula at a place; NaN where it reads a channel.
    pub(crate) fn at_place(&self, formula: NodeId, place: &[f64], parameters: &[f64], constants: &[f64]) -> f64 {
        let leaf = |node: &Node| match node {
            Node::Input(Input::Parameter(p)) => parameters[p.index()],
            Node::Input(Input::Constant(c)) => constants[c.index()],
            Node::Coordinate(c) => place[c.index()],
            _ => f64::NAN,
        };
        self.formulas.graph.evaluate(formula, &leaf)
    }
}
