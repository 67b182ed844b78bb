//! Which shared nodes the chain rule may treat as variables.

use std::collections::BTreeSet;

use crate::language::graph::{Graph, Node, NodeId, operands};
use crate::program::Level;

/// Shared pixel nodes that the chain rule may treat as variables: used more than once or nonlinearly, not mere offsets,
/// and finite wherever their operands are when a condition might choose another branch.
pub(crate) fn cut_candidates(graph: &Graph, residual: NodeId, parameters: &[NodeId]) -> BTreeSet<NodeId> {
    let reachable = graph.reachable(&[residual]);
    let conditional = reachable.iter().any(|n| matches!(graph.node(*n), Node::Select(..)));
    let counts = graph.use_counts(&[residual]);
    let (mut depends, mut total) = (BTreeSet::new(), BTreeSet::new());
    let mut powered = BTreeSet::new();
    for id in &reachable {
        let node = graph.node(*id);
        if parameters.contains(id) || operands(node).any(|n| depends.contains(&n)) {
            depends.insert(*id);
        }
        let finite = match node {
            Node::Product(factors) => factors.iter().all(|(_, e)| *e > 0),
            Node::Sqrt(_) | Node::Call1(..) | Node::Call2(..) => false,
            _ => true,
        };
        if finite && operands(node).all(|n| total.contains(&n)) {
            total.insert(*id);
        }
        match node {
            Node::Product(factors) => powered.extend(factors.iter().filter(|(_, e)| *e != 1).map(|(n, _)| *n)),
            Node::Sqrt(a) | Node::Call1(_, a) => powered.extend([*a]),
            Node::Call2(_, a, b) => powered.extend([*a, *b]),
            _ => {}
        }
    }
    let leaf = |n: &NodeId| matches!(graph.node(*n), Node::Input(_) | Node::Coordinate(_) | Node::Channel(_));
    let wanted = |id: &NodeId| {
        let shape = match graph.node(*id) {
            Node::Sum(_, terms) => !terms.iter().all(|(n, _)| leaf(n) || graph.level(*n) < Level::Pixel),
            node => !leaf(id) && !matches!(node, Node::Number(_)),
        };
        shape
            && *id != residual
            && !graph.is_truth(*id)
            && depends.contains(id)
            && graph.level(*id) == Level::Pixel
            && (counts[id.index()] > 1 || powered.contains(id))
            && (!conditional || total.contains(id))
    };
    let mut found: Vec<NodeId> = reachable.into_iter().filter(wanted).collect();
    found.sort_by_key(|n| std::cmp::Reverse(counts[n.index()]));
    found.truncate(16);
    found.into_iter().collect()
}
