//! Programs that fill a plane: what is rendered, and what is predicted of each pixel.
//!
//! What comes in: a model. What goes out: a program that was held against its formulas.

use crate::derive::schedule;
use crate::derive::whole_model::WholeModel;
use crate::language::graph::{Graph, Node, NodeId};
use crate::language::model::{Lowering, Model};
use crate::language::reader::formulas_of_model::averaged;
use crate::program::{Input, Program};
use crate::proof::plane::{self, Shown};
use isophote_syntax::diagnostic::Diagnostics;

/// What a plane of predictions holds.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Prediction {
    /// The intensity, as it is fitted; NaN outside of the domain.
    Intensity,
    /// The intensity everywhere.
    Unbounded,
    /// A pixel's variance.
    Variance,
    /// What the intensity's mean by so many Gauss points a side has beyond its value at the pixel's centre.
    Correction(usize),
}

/// The program that adds the intensity, at shifted coordinates, to a plane.
pub(crate) fn rendering(model: &Model, lowering: Lowering) -> Result<Program, Diagnostics> {
    let mut graph = model.formulas.graph.drawing_on(model.budget());
    let mut shifted = |graph: &mut Graph, node: &Node| match node {
        Node::Coordinate(c) => {
            let shift = graph.input(Input::Shift(*c));
            let coordinate = graph.coordinate(*c);
            Some(graph.add2(coordinate, shift))
        }
        _ => None,
    };
    let intensity = graph.substitute(model.formulas.shown, &mut shifted);
    let read = &model.formulas.graph;
    let shown = Shown { model, graph: read, value: model.formulas.shown, domain: None, is_shifted: true };
    filling(&mut graph, &shown, intensity, lowering, "intensity")
}

/// The program that fills a plane with `value`, which must be what is to be shown.
fn filling(
    graph: &mut Graph,
    shown: &Shown<'_>,
    value: NodeId,
    lowering: Lowering,
    name: &str,
) -> Result<Program, Diagnostics> {
    let origin = WholeModel::of(shown.model);
    for lowering in [lowering, Lowering { fma: false, ..lowering }] {
        let draft = schedule::plane(graph, value, lowering, shown.model.names(vec![name.into()]).into());
        if let Some(program) = plane::proved(shown, origin.checked(graph, draft)?) {
            return Ok(program);
        }
    }
    Err(if shown.is_blind() { origin.undefined() } else { origin.bug() })
}

/// The program that adds what is predicted of a pixel to a plane. `None` where that reads a channel.
pub(crate) fn prediction(model: &Model, what: Prediction, lowering: Lowering) -> Option<Result<Program, Diagnostics>> {
    let formulas = &model.formulas;
    let formula = |graph: &mut Graph| match what {
        Prediction::Intensity | Prediction::Unbounded => formulas.intensity,
        Prediction::Variance => formulas.noise.unwrap_or_else(|| graph.number(1.0)),
        Prediction::Correction(points) => {
            let mean = averaged(graph, formulas.shown, points, model.coordinates.len());
            graph.sub(mean, formulas.shown)
        }
    };
    let domain = formulas.domain.filter(|_| what == Prediction::Intensity);
    let mut graph = formulas.graph.drawing_on(model.budget());
    let mut value = formula(&mut graph);
    if graph.reachable(&[value]).iter().any(|n| matches!(graph.node(*n), Node::Channel(_))) {
        return None;
    }
    if let Some(domain) = domain {
        let outside = graph.number(f64::NAN);
        value = graph.select(domain, value, outside);
    }
    // As it was read: what is predicted, and where.
    let mut read = formulas.graph.drawing_on(model.budget());
    let formula = formula(&mut read);
    let shown = Shown { model, graph: &read, value: formula, domain, is_shifted: false };
    Some(filling(&mut graph, &shown, value, lowering, "prediction"))
}
