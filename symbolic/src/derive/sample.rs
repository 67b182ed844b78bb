//! What a model says at single places: the prediction, its variance, and whether it is said at all.
//!
//! What comes in: places, parameters and constants. What goes out: a [`Sample`] each, in f64. For whoever needs a model's
//! profile and not its sums; a picture is what [`Model::rendering`] is for.

use crate::language::graph::Node;
use crate::language::model::Model;
use crate::program::Input;
use crate::proof::hyper::Values;

/// A model at one place.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Of each entry of `observed` the prediction, pixel value (NaN where it needs a channel), and its variance, with `noise`.
    pub entries: Vec<(f64, Option<f64>)>,
    /// Whether the place is in the domain.
    pub inside: bool,
}

impl Model {
    /// The model at each of `places` (one number a coordinate). `parameters` and `constants` in document order.
    pub fn samples(&self, places: &[Vec<f64>], parameters: &[f64], constants: &[f64]) -> Vec<Sample> {
        let (formulas, entries) = (&self.formulas, &self.formulas.entries);
        let at = |node: &Node, place: &[f64]| leaf(node, place, parameters, constants);
        let roots: Vec<_> = entries.iter().map(|e| e.intensity).chain(entries.iter().filter_map(|e| e.noise)).collect();
        let mut numbers = Values::of(&formulas.graph, &roots, &|node: &Node| at(node, &[]));
        let mut is_inside = self.insides(parameters, constants);
        let sample = |place: &Vec<f64>| {
            let values = numbers.at(&|node: &Node| at(node, place));
            let entry = |k: usize| (values[k].value, values.get(entries.len() + k).map(|variance| variance.value));
            Sample { entries: (0..entries.len()).map(entry).collect(), inside: is_inside(place) }
        };
        places.iter().map(sample).collect()
    }

    /// Whether places (one number a coordinate) are in the domain; what does not depend on the place is worked out once.
    pub fn insides<'a>(&'a self, parameters: &'a [f64], constants: &'a [f64]) -> impl FnMut(&[f64]) -> bool + 'a {
        let at = move |node: &Node, place: &[f64]| leaf(node, place, parameters, constants);
        let domain: Vec<_> = self.formulas.domain.into_iter().collect();
        let mut bounds = Values::of(&self.formulas.graph, &domain, &|node: &Node| at(node, &[]));
        move |place| domain.is_empty() || bounds.holds_at(&|node: &Node| at(node, place))
    }
}

/// What a node is at a place, or without one.
fn leaf(node: &Node, place: &[f64], parameters: &[f64], constants: &[f64]) -> f64 {
    match node {
        Node::Coordinate(c) => place.get(c.index()).copied().unwrap_or(f64::NAN),
        Node::Input(Input::Parameter(p) | Input::Entry(p)) => parameters[p.index()],
        Node::Input(Input::Constant(c)) => constants[c.index()],
        Node::Input(Input::Shift(_)) => 0.0,
        _ => f64::NAN,
    }
}

#[cfg(test)]
#[path = "sample_tests.rs"]
mod tests;
