//! Reads the formulas of `[model]`.

use std::sync::Arc;

use crate::graph::{Graph, Node, NodeId};
use crate::language::document::{Entry, Item, Key};
use crate::language::formulas::FormulaReader;
use crate::language::reader::faults::get;
use crate::language::reader::likelihood_of_model::{Likelihood, read_likelihood};
use crate::model::{Formulas, Observation, Quadrature, Saturated};
use crate::program::{ChannelId, ConstantId, CoordinateId};
use isophote_syntax::diagnostic::Span;
use isophote_syntax::limits::LIMITS;

/// Reads the table `[model]`.
pub(crate) fn read_model(
    mut reader: FormulaReader<'_, '_>,
    model: &[(Key, Entry)],
    at: Span,
    channels: &[String],
    coordinates: usize,
    defects: Option<ConstantId>,
) -> Option<Formulas> {
    let likelihood = read_likelihood(reader.faults, model, coordinates);
    let intensity = match get(model, "intensity") {
        Some(entry) => reader.column("model.intensity", entry),
        None => {
            reader.faults.tell(
                "missing-key",
                "model.intensity",
                at,
                "the key `intensity` is missing",
                "write what a pixel's value is predicted to be",
            );
            None
        }
    };
    let count = intensity.as_ref().map_or(1, Vec::len);
    let observed = match get(model, "observed") {
        Some(entry) => reader.column("model.observed", entry),
        // A vector with one prediction for each channel needs no `observed`.
        None if channels.len() == count => {
            Some((0..count).map(|c| reader.graph.channel(ChannelId(c as u32))).collect::<Vec<_>>())
        }
        None if channels.len() > 1 => {
            let message =
                format!("with {} channels the key `observed` says which formula over them is fitted", channels.len());
            reader.faults.tell(
                "missing-key",
                "model.observed",
                at,
                message,
                format!("add `observed = \"{}\"`", channels[0]),
            );
            None
        }
        None => Some(vec![reader.graph.channel(ChannelId(0))]),
    };
    let domain = get(model, "domain").map(|e| reader.truth("model.domain", e));
    // Keeps the prediction whole where `noise` subtracts from it: its mean over the pixel, or a corrected one, replaces
    // it.
    intensity.iter().flatten().for_each(|node| reader.graph.set_opaque(*node));
    let mut noise = Some(vec![None; count]);
    if let Some(entry) = get(model, "noise") {
        let values = |i: usize| intensity.as_ref().and_then(|list| list.get(i)).copied();
        let mut one = |i: usize| reader.number_of_intensity("model.noise", entry, values(i)).map(Some);
        noise = (0..count).map_while(|i| one(i).map(Some)).collect();
        noise = noise.filter(|list: &Vec<Option<NodeId>>| list.len() == count);
    }
    let mut constraints = Vec::new();
    if let Some(entry) = get(model, "constraint") {
        let single = std::slice::from_ref(entry);
        let list = if let Item::List(list) = &entry.item { list.as_slice() } else { single };
        for (i, item) in list.iter().enumerate() {
            constraints.push(reader.truth(&format!("model.constraint[{i}]"), item));
        }
    }
    let none = Vec::new();
    reader.check_levels(
        model,
        intensity.as_ref().unwrap_or(&none),
        observed.as_ref().unwrap_or(&none),
        domain.flatten(),
        &constraints,
    );
    // Faults inside formulas are already reported; the model needs all of them valid.
    let constraints = constraints.into_iter().collect::<Option<Vec<_>>>()?;
    let (intensity, observed, noise) = (intensity?, observed?, noise?);
    if domain == Some(None) {
        return None;
    }
    if intensity.len() != observed.len() {
        let message = format!(
            "the prediction has {}, and what is observed has {}",
            entries(intensity.len()),
            entries(observed.len())
        );
        let span = get(model, "intensity").map_or(at, |e| e.span);
        let help = "`intensity` has one entry for each entry of `observed` (without it: for each channel)";
        reader.faults.tell("shape", "model.intensity", span, message, help);
        return None;
    }
    if observed.len() > LIMITS.channels {
        let message = format!("at most {} values are fitted, not {}", LIMITS.channels, observed.len());
        let span = get(model, "observed").map_or(at, |e| e.span);
        reader.faults.tell("limit", "model.observed", span, message, "one for each channel is what there is");
        return None;
    }
    let likelihood = likelihood?;
    let is_channel = |node: &NodeId| matches!(reader.graph.node(*node), Node::Channel(_));
    if likelihood.saturated != Saturated::Dropped && !observed.iter().all(is_channel) {
        let span = get(model, "saturated").map_or(at, |e| e.span);
        let message =
            "a mixture of channels has no limit of its own: at its limit a channel says too little of the mixture";
        let help = "fit the channels as they are: `observed = \"[r, g, b]\"`, with the mixing in `intensity`";
        reader.faults.tell("bad-formula", "model.saturated", span, message, help);
        return None;
    }
    let mut graph = reader.graph;
    // Nodes without a formula of their own, such as the residual, get the intensity's span.
    graph.set_span(graph.span(intensity[0]));
    let mut list = Vec::new();
    for ((shown, observed), noise) in intensity.into_iter().zip(observed).zip(noise) {
        let mean = averaged(&mut graph, shown, likelihood.quadrature.points(), coordinates);
        let noise = noise.map(|noise| match mean == shown {
            true => noise,
            false => {
                graph.set_opaque(mean);
                graph.replaced(noise, shown, mean)
            }
        });
        list.push(Observation { observed, intensity: mean, shown, noise });
    }
    let Likelihood { loss, saturated, quadrature, deviation } = likelihood;
    let domain = domain.flatten();
    Some(Formulas {
        graph: Arc::new(graph),
        entries: list,
        domain,
        constraints,
        loss,
        saturated,
        defects,
        quadrature,
        deviation,
    })
}

fn entries(count: usize) -> String {
    if count == 1 { "one entry".into() } else { format!("{count} entries") }
}

/// The mean of a value over a pixel, by a tensor product of Gauss rules.
pub(crate) fn averaged(graph: &mut Graph, value: NodeId, points: usize, coordinates: usize) -> NodeId {
    if points < 2 {
        return value;
    }
    let rule = Quadrature::rule(points);
    let mut terms = Vec::new();
    for index in 0..points.pow(coordinates as u32) {
        let place = |axis: usize| rule[index / points.pow(axis as u32) % points];
        let weight: f64 = (0..coordinates).map(|axis| place(axis).1).product();
        let mut shifted = |graph: &mut Graph, node: &Node| match node {
            Node::Coordinate(CoordinateId(c)) => {
                let coordinate = graph.coordinate(CoordinateId(*c));
                Some(graph.sum(place(*c as usize).0, [(coordinate, 1.0)]))
            }
            _ => None,
        };
        terms.push((graph.substitute(value, &mut shifted), weight));
    }
    graph.sum(0.0, terms)
}

#[cfg(test)]
#[path = "formulas_of_model_tests.rs"]
mod tests;
