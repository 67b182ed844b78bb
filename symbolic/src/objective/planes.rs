//! Programs that fill a plane, checked against the model's formulas: renderings and predictions of each pixel.

use crate::graph::{Graph, Node, NodeId};
use crate::language::reader::formulas_of_model::averaged;
use crate::model::Summand;
use crate::program::Input;
use crate::proof::plane::{self, Shown};
use crate::proof::program::Program;
use crate::schedule;
use crate::schedule::Lowering;
use isophote_syntax::diagnostic::Diagnostics;

/// Contents of a plane of predictions.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Prediction {
    /// The intensity, as it is fitted; NaN outside of the domain.
    Intensity,
    /// The intensity everywhere.
    Unbounded,
    /// A pixel's variance.
    Variance,
    /// The intensity's mean over this many Gauss points a side, minus its value at the pixel's centre.
    Correction(usize),
}

/// The program that fills a plane with `value`, which must agree with `shown`.
fn filling(
    graph: &mut Graph,
    shown: &Shown<'_>,
    value: NodeId,
    lowering: Lowering,
    name: &str,
) -> Result<Program, Diagnostics> {
    for lowering in [lowering, Lowering { fma: false, ..lowering }] {
        let nest = schedule::plane(graph, value, lowering, shown.summand.model().names(vec![name.into()]).into());
        if let Some(program) = plane::proved(shown, shown.summand.within_limits(graph, nest)?) {
            return Ok(program);
        }
    }
    Err(shown.summand.unproved(shown.is_blind()))
}

impl Summand {
    /// The program that adds the intensity of the first entry to a plane, at coordinates plus their shifts.
    pub fn rendering(&self, lowering: Lowering) -> Result<Program, Diagnostics> {
        let (read, value) = (&self.model().formulas.graph, self.first().shown);
        let mut graph = read.drawing_on(self.budget());
        let mut shifted = |graph: &mut Graph, node: &Node| match node {
            Node::Coordinate(c) => {
                let shift = graph.input(Input::Shift(*c));
                let coordinate = graph.coordinate(*c);
                Some(graph.add2(coordinate, shift))
            }
            _ => None,
        };
        let intensity = graph.substitute(value, &mut shifted);
        let shown = Shown { summand: self, graph: read, value, domain: None, is_shifted: true };
        filling(&mut graph, &shown, intensity, lowering, "intensity")
    }

    /// The program that adds a prediction of each pixel to a plane. `None` for a prediction that reads a channel.
    pub fn prediction(&self, what: Prediction, lowering: Lowering) -> Option<Result<Program, Diagnostics>> {
        let (model, entry) = (self.model(), self.first());
        let formulas = &model.formulas;
        let formula = |graph: &mut Graph| match what {
            Prediction::Intensity | Prediction::Unbounded => entry.intensity,
            Prediction::Variance => entry.noise.unwrap_or_else(|| graph.number(1.0)),
            Prediction::Correction(points) => {
                let mean = averaged(graph, entry.shown, points, model.coordinates.len());
                graph.sub(mean, entry.shown)
            }
        };
        let domain = formulas.domain.filter(|_| what == Prediction::Intensity);
        let mut graph = formulas.graph.drawing_on(self.budget());
        let mut value = formula(&mut graph);
        if graph.reachable(&[value]).iter().any(|n| matches!(graph.node(*n), Node::Channel(_))) {
            return None;
        }
        if let Some(domain) = domain {
            let outside = graph.number(f64::NAN);
            value = graph.select(domain, value, outside);
        }
        // The formula and its domain as they were read.
        let mut read = formulas.graph.drawing_on(self.budget());
        let formula = formula(&mut read);
        let shown = Shown { summand: self, graph: &read, value: formula, domain, is_shifted: false };
        Some(filling(&mut graph, &shown, value, lowering, "prediction"))
    }
}
