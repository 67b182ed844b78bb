//! A rewrite before the sums are formed: invariant factors go into sums that nothing else uses.

use std::collections::{BTreeSet, HashMap};

use crate::formulas::use_counts;
use crate::graph::{Bits, Graph, Node, NodeId};
use crate::jet::Jet;
use crate::program::Level;

/// Takes invariant factors into sums that nothing else uses (v1 · (k1 + 2 k2 s) with both coefficients known per pass), so
/// that the factor costs nothing per pixel, and sums into sums likewise.
pub(crate) fn absorb(
    graph: &mut Graph,
    tops: &[NodeId],
    jets: &[Jet],
    variance: Option<NodeId>,
) -> (Vec<NodeId>, Vec<Jet>, Option<NodeId>) {
    let mut roots = tops.to_vec();
    roots.extend(variance);
    roots.extend(jets.iter().flat_map(|j| j.first.values().chain(j.second.values()).copied()));
    let counts = use_counts(graph, &roots);
    let held: BTreeSet<NodeId> = roots.iter().copied().collect();
    let lone = |n: NodeId| counts.get(&n) == Some(&1) && !held.contains(&n);
    let mut map = HashMap::new();
    for id in graph.reachable(&roots) {
        let new = match graph.node(id).clone() {
            Node::Sum(constant, terms) if graph.level(id) == Level::Pixel => {
                let mut list = Vec::new();
                let mut constant = constant.get();
                for (n, coefficient) in terms {
                    let inner = map.get(&n).copied().unwrap_or(n);
                    match graph.node(inner).clone() {
                        Node::Sum(c, inside) if lone(n) && free_to_scale(graph, &inside, coefficient.get() == 1.0) => {
                            constant += coefficient.get() * c.get();
                            list.extend(inside.into_iter().map(|(m, k)| (m, coefficient.get() * k.get())));
                        }
                        _ => list.push((inner, coefficient.get())),
                    }
                }
                let span = graph.span(id);
                graph.set_span(span);
                let sum = graph.sum(constant, list);
                if graph.is_opaque(id) {
                    graph.set_opaque(sum);
                }
                sum
            }
            Node::Product(factors) => match absorbed(graph, &factors, &map, &lone) {
                Some(sum) => sum,
                None => graph.rebuild(id, &map),
            },
            _ => graph.rebuild(id, &map),
        };
        map.insert(id, new);
    }
    let at = |n: &NodeId| map[n];
    let mapped = |jet: &Jet| Jet {
        first: jet.first.iter().map(|(l, n)| (*l, at(n))).collect(),
        second: jet.second.iter().map(|(k, n)| (*k, at(n))).collect(),
    };
    let new_tops: Vec<NodeId> = tops.iter().map(at).collect();
    new_tops.iter().for_each(|t| graph.set_opaque(*t));
    (new_tops, jets.iter().map(mapped).collect(), variance.map(|v| at(&v)))
}

/// At most one term would pay for a coefficient that it did not have.
fn free_to_scale(graph: &Graph, terms: &[(NodeId, Bits)], unit: bool) -> bool {
    let pays = |(n, coefficient): &&(NodeId, Bits)| {
        let invariant =
            matches!(graph.node(*n), Node::Product(f) if f.iter().any(|(m, _)| graph.level(*m) < Level::Pixel));
        graph.level(*n) == Level::Pixel && !invariant && coefficient.get().abs() == 1.0
    };
    unit || terms.iter().filter(pays).count() <= 1
}

/// invariants · (a sum that only this product uses) as one sum.
fn absorbed(
    graph: &mut Graph,
    factors: &[(NodeId, i32)],
    map: &HashMap<NodeId, NodeId>,
    lone: &dyn Fn(NodeId) -> bool,
) -> Option<NodeId> {
    let (pixel, invariant): (Vec<_>, Vec<_>) =
        factors.iter().copied().partition(|(n, _)| graph.level(*n) == Level::Pixel);
    let [(sum, 1)] = pixel[..] else { return None };
    let inner = map.get(&sum).copied().unwrap_or(sum);
    let Node::Sum(constant, terms) = graph.node(inner).clone() else { return None };
    if invariant.is_empty() || !lone(sum) || !free_to_scale(graph, &terms, false) {
        return None;
    }
    let scale: Vec<_> = invariant.iter().map(|(n, e)| (map.get(n).copied().unwrap_or(*n), *e)).collect();
    let mut times = |node: Option<NodeId>, c: f64| graph.product(c, scale.iter().copied().chain(node.map(|n| (n, 1))));
    let mut list: Vec<_> = terms.into_iter().map(|(n, c)| (times(Some(n), c.get()), 1.0)).collect();
    if constant.get() != 0.0 {
        list.push((times(None, constant.get()), 1.0));
    }
    Some(graph.sum(0.0, list))
}
