//! What a sum over pixels is made of, as the document says it: the residual, its variances, and which pixels count.
//!
//! What comes in: a model, and what is claimed of the sums. What goes out: nodes of a graph, and who holds the sums against them.
//! It never knows how anything is derived.

use std::sync::Arc;

use crate::derive::whole_model::WholeModel;
use crate::language::graph::{Graph, Node, NodeId};
use crate::language::model::{Method, Model, Observation, Saturated};
use crate::program::{Comparison, Input, ParameterId};
use crate::proof::budget;
use crate::proof::claim::{Claim, ValueKind};
use crate::proof::referee::Referee;
use crate::proof::subject::{PixelValue, Subject};
use isophote_syntax::diagnostic::Diagnostics;

/// Predicted to be within so many standard deviations of the limit is near it.
const NEAR_LIMIT: f64 = 3.0;

/// What the sums are of, as the document says it.
fn subject(model: &Model, subset: &[ParameterId], claim: Claim) -> Result<Subject, Diagnostics> {
    let mut graph = model.formulas.graph.drawing_on(model.budget());
    let values = values(&mut graph, model, claim);
    let parameters = subset.iter().map(|p| graph.input(Input::Parameter(*p))).collect();
    let counts = counts(&mut graph, &values);
    let (domain, shape) = (entry_domain(&mut graph, model, claim), model.formulas.shape());
    if graph.overflowed() {
        return Err(WholeModel::of(model).outgrown(&graph, subset.len()));
    }
    Ok(Subject { model: model.clone(), graph, values, counts, shape, domain, parameters, claim })
}

/// The values of a pixel whose F is summed.
pub(crate) fn values(graph: &mut Graph, model: &Model, claim: Claim) -> Vec<PixelValue> {
    rewritten_values(graph, model, claim, &|_, node, _| node)
}

/// The same, each node rewritten as soon as it is there; of the variance that is held that is said.
pub(crate) fn rewritten_values(
    graph: &mut Graph,
    model: &Model,
    claim: Claim,
    rewritten: &dyn Fn(&mut Graph, NodeId, bool) -> NodeId,
) -> Vec<PixelValue> {
    let mut of = |entry: &Observation| {
        let residual = residual(graph, model, entry);
        let residual = rewritten(graph, residual, false);
        let variance = variance(graph, entry, claim).map(|node| rewritten(graph, node, true));
        let own_variance = own_variance(graph, entry, claim).map(|node| rewritten(graph, node, false));
        PixelValue { residual, variance, own_variance, below: below(graph, model, entry) }
    };
    model.formulas.summed().iter().map(&mut of).collect()
}

/// Of a value that is summed beside others: that it is below its limit, and at it. What is no number is neither.
fn below(graph: &mut Graph, model: &Model, entry: &Observation) -> Option<[NodeId; 2]> {
    let Node::Channel(channel) = *graph.node(entry.observed) else { return None };
    model.formulas.is_joint.then(|| {
        let limit = graph.input(Input::Saturation(channel));
        [(Comparison::Lt, entry.observed, limit), (Comparison::Le, limit, entry.observed)]
            .map(|(comparison, a, b)| graph.compare(comparison, a, b))
    })
}

/// Of each value in turn 1 where it is below its limit, else 0, and 1 where it is at it; nothing where all values are summed.
pub(crate) fn counts(graph: &mut Graph, values: &[PixelValue]) -> Vec<NodeId> {
    let truths: Vec<NodeId> = values.iter().filter_map(|value| value.below).flatten().collect();
    let mut count = |truth: NodeId| {
        let [zero, one] = [0.0, 1.0].map(|number| graph.number(number));
        graph.select(truth, one, zero)
    };
    truths.into_iter().map(&mut count).collect()
}

/// Who judges derivatives, when the document's budget has room for it.
pub(crate) fn referee(
    model: &Model,
    subset: &[ParameterId],
    method: Method,
    claim: Claim,
) -> Result<Arc<Referee>, Diagnostics> {
    let room = budget::room(model, subset, method).ok_or_else(|| WholeModel::of(model).costly())?;
    Ok(Arc::new(Referee::new(subject(model, subset, claim)?, room)))
}

/// The pixel's variance, at the entry parameters where a claim holds it there.
fn variance(graph: &mut Graph, entry: &Observation, claim: Claim) -> Option<NodeId> {
    let node = entry.noise?;
    let is_own = claim.is_newton() || claim.is_at_entry() || claim == Claim::Value(ValueKind::Full);
    let node = if is_own { node } else { at_entry(graph, node) };
    graph.set_opaque(node);
    Some(node)
}

/// The pixel's variance at the parameters themselves, where a claim has it beside the one at entry.
fn own_variance(graph: &mut Graph, entry: &Observation, claim: Claim) -> Option<NodeId> {
    let node = entry.noise.filter(|_| claim == Claim::Closing)?;
    graph.set_opaque(node);
    Some(node)
}

fn at_entry(graph: &mut Graph, node: NodeId) -> NodeId {
    let mut entry = |graph: &mut Graph, node: &Node| match node {
        Node::Input(Input::Parameter(p)) => Some(graph.input(Input::Entry(*p))),
        _ => None,
    };
    graph.substitute(node, &mut entry)
}

/// observed − intensity; of a pixel at its limit that limit − intensity.
fn residual(graph: &mut Graph, model: &Model, entry: &Observation) -> NodeId {
    let observed = match model.formulas.clipped {
        Some(channel) => graph.input(Input::Saturation(channel)),
        None => entry.observed,
    };
    graph.sub(observed, entry.intensity)
}

/// Where the model holds, at the entry parameters; of pixels at their limit those.
pub(crate) fn entry_domain(graph: &mut Graph, model: &Model, claim: Claim) -> Option<NodeId> {
    let at_entry = |graph: &mut Graph, node| if claim.is_at_entry() { node } else { at_entry(graph, node) };
    let mut domain = model.formulas.domain.map(|d| at_entry(graph, d));
    if let (Saturated::Predicted, Node::Channel(channel)) =
        (model.formulas.saturated, graph.node(model.formulas.observed).clone())
    {
        let limit = graph.input(Input::Saturation(channel));
        let intensity = at_entry(graph, model.formulas.intensity);
        let deviation = match model.formulas.noise {
            Some(noise) => {
                let noise = at_entry(graph, noise);
                graph.sqrt(noise)
            }
            None => graph.number(0.0),
        };
        let most = graph.sum(0.0, [(limit, 1.0), (deviation, -NEAR_LIMIT)]);
        let below = graph.compare(Comparison::Lt, intensity, most);
        domain = Some(domain.map_or(below, |domain| graph.and(domain, below)));
    }
    let Some(channel) = model.formulas.clipped else { return domain };
    let (limit, pixel) = (graph.input(Input::Saturation(channel)), graph.channel(channel));
    let clipped = graph.compare(Comparison::Le, limit, pixel);
    Some(domain.map_or(clipped, |domain| graph.and(domain, clipped)))
}
