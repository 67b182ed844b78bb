//! The terms of a sum over pixels as the document states them, before any derivation: residual, variances and pixel
//! conditions, as graph nodes.

use crate::graph::{Graph, Node, NodeId};
use crate::likelihood::claim::{Claim, ValueKind};
use crate::model::{Observation, Saturated, Summand};
use crate::program::{Comparison, Input};

/// A prediction within this many standard deviations of the limit counts as near it.
const NEAR_LIMIT: f64 = 3.0;

/// A value of a pixel in F.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PixelValue {
    pub residual: NodeId,
    pub variance: Option<NodeId>,
    /// The variance at the parameters themselves, if it is summed beside the one at entry.
    pub own_variance: Option<NodeId>,
    /// In a joint loop: conditions that the value is below its limit, and at it.
    pub below: Option<[NodeId; 2]>,
}

impl PixelValue {
    /// All numeric nodes.
    pub fn nodes(&self) -> impl Iterator<Item = NodeId> {
        [Some(self.residual), self.variance, self.own_variance].into_iter().flatten()
    }
}

/// The values of a pixel whose F is summed.
pub(crate) fn values(graph: &mut Graph, summand: &Summand, claim: Claim) -> Vec<PixelValue> {
    rewritten_values(graph, summand, claim, &|_, node, _| node)
}

/// The same with each node rewritten as soon as it exists; the flag marks the variance, which may be held at entry.
pub(crate) fn rewritten_values(
    graph: &mut Graph,
    summand: &Summand,
    claim: Claim,
    rewritten: &dyn Fn(&mut Graph, NodeId, bool) -> NodeId,
) -> Vec<PixelValue> {
    let mut of = |entry: &Observation| {
        let residual = residual(graph, summand, entry);
        let residual = rewritten(graph, residual, false);
        let variance = variance(graph, entry, claim).map(|node| rewritten(graph, node, true));
        let own_variance = own_variance(graph, entry, claim).map(|node| rewritten(graph, node, false));
        PixelValue { residual, variance, own_variance, below: below(graph, summand, entry) }
    };
    summand.summed().iter().map(&mut of).collect()
}

/// For a joint loop: conditions that the value is below its limit, and at it; NaN meets neither.
fn below(graph: &mut Graph, summand: &Summand, entry: &Observation) -> Option<[NodeId; 2]> {
    let Node::Channel(channel) = *graph.node(entry.observed) else { return None };
    summand.is_joint().then(|| {
        let limit = graph.input(Input::Saturation(channel));
        [(Comparison::Lt, entry.observed, limit), (Comparison::Le, limit, entry.observed)]
            .map(|(comparison, a, b)| graph.compare(comparison, a, b))
    })
}

/// Two indicators a value, 1 where it is below its limit and 1 where it is at it, else 0; empty unless values are
/// masked one by one.
pub(crate) fn counts(graph: &mut Graph, values: &[PixelValue]) -> Vec<NodeId> {
    let truths: Vec<NodeId> = values.iter().filter_map(|value| value.below).flatten().collect();
    let mut count = |truth: NodeId| {
        let [zero, one] = [0.0, 1.0].map(|number| graph.number(number));
        graph.select(truth, one, zero)
    };
    truths.into_iter().map(&mut count).collect()
}

/// The pixel's variance, at the entry parameters where the claim holds it there.
fn variance(graph: &mut Graph, entry: &Observation, claim: Claim) -> Option<NodeId> {
    let node = entry.noise?;
    let is_own = claim.is_newton() || claim.is_at_entry() || claim == Claim::Value(ValueKind::Full);
    let node = if is_own { node } else { at_entry(graph, node) };
    graph.set_opaque(node);
    Some(node)
}

/// The pixel's variance at the parameters themselves, for a claim that sums it beside the one at entry.
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

/// observed − intensity; limit − intensity for pixels at their limit.
fn residual(graph: &mut Graph, summand: &Summand, entry: &Observation) -> NodeId {
    let observed = match summand.clipped() {
        Some(channel) => graph.input(Input::Saturation(channel)),
        None => entry.observed,
    };
    graph.sub(observed, entry.intensity)
}

/// The domain at the entry parameters, without pixels predicted near the limit where the model leaves those out; only
/// pixels at their limit where it is of those.
pub(crate) fn entry_domain(graph: &mut Graph, summand: &Summand, claim: Claim) -> Option<NodeId> {
    let at_entry = |graph: &mut Graph, node| if claim.is_at_entry() { node } else { at_entry(graph, node) };
    let formulas = &summand.model().formulas;
    let mut domain = formulas.domain.map(|d| at_entry(graph, d));
    if let (Saturated::Predicted, Node::Channel(channel)) =
        (formulas.saturated, graph.node(summand.first().observed).clone())
    {
        let limit = graph.input(Input::Saturation(channel));
        let intensity = at_entry(graph, summand.first().intensity);
        let deviation = match summand.first().noise {
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
    let Some(channel) = summand.clipped() else { return domain };
    let (limit, pixel) = (graph.input(Input::Saturation(channel)), graph.channel(channel));
    let clipped = graph.compare(Comparison::Le, limit, pixel);
    Some(domain.map_or(clipped, |domain| graph.and(domain, clipped)))
}
