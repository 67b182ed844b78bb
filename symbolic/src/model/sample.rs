//! Evaluates a model at single positions, in f64: prediction, variance and membership of the domain. This serves a
//! model's profile; [`Model::rendering`] renders pictures.

use crate::graph::Node;
use crate::graph::hyper::Values;
use crate::model::{Leaves, Model, Observation, Summand};

/// A model at one position.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Per entry of `observed`: prediction in pixel values (NaN where it needs a channel), and variance, with `noise`.
    pub entries: Vec<(f64, Option<f64>)>,
    /// True inside the domain.
    pub inside: bool,
}

impl Model {
    /// The model at each of `places` (one number a coordinate), with `parameters` and `constants` in document order.
    pub fn samples(&self, places: &[Vec<f64>], parameters: &[f64], constants: &[f64]) -> Vec<Sample> {
        self.samples_of(&self.formulas.entries, places, parameters, constants)
    }

    /// The same for some entries of `observed`.
    fn samples_of(
        &self,
        entries: &[Observation],
        places: &[Vec<f64>],
        parameters: &[f64],
        constants: &[f64],
    ) -> Vec<Sample> {
        let at = |node: &Node, place: &[f64]| Leaves { place, parameters, constants, channels: &[] }.value(node);
        let roots: Vec<_> = entries.iter().map(|e| e.intensity).chain(entries.iter().filter_map(|e| e.noise)).collect();
        let mut numbers = Values::of(&self.formulas.graph, &roots, &|node: &Node| at(node, &[]));
        let mut is_inside = self.insides(parameters, constants);
        let sample = |place: &Vec<f64>| {
            let values = numbers.at(&|node: &Node| at(node, place));
            let entry = |k: usize| (values[k].value, values.get(entries.len() + k).map(|variance| variance.value));
            Sample { entries: (0..entries.len()).map(entry).collect(), inside: is_inside(place) }
        };
        places.iter().map(sample).collect()
    }

    /// Tests positions (one number a coordinate) for the domain; position-independent values are computed once.
    pub fn insides<'a>(&'a self, parameters: &'a [f64], constants: &'a [f64]) -> impl FnMut(&[f64]) -> bool + 'a {
        let at = move |node: &Node, place: &[f64]| Leaves { place, parameters, constants, channels: &[] }.value(node);
        let domain: Vec<_> = self.formulas.domain.into_iter().collect();
        let mut bounds = Values::of(&self.formulas.graph, &domain, &|node: &Node| at(node, &[]));
        move |place| domain.is_empty() || bounds.holds_at(&|node: &Node| at(node, place))
    }
}

impl Summand {
    /// [`Model::samples`] of its entries.
    pub fn samples(&self, places: &[Vec<f64>], parameters: &[f64], constants: &[f64]) -> Vec<Sample> {
        self.model().samples_of(self.summed(), places, parameters, constants)
    }
}

#[cfg(test)]
#[path = "sample_tests.rs"]
mod tests;
