//! Which shared nodes the chain rule may treat as variables.

use std::collections::{BTreeMap, BTreeSet};
use std::hash::BuildHasher;
use std::mem::discriminant;

use rustc_hash::{FxBuildHasher, FxHashMap};

use crate::language::graph::{Graph, Node, NodeId, operands};
use crate::program::Level;

/// The candidates, those together that are made alike but for numbers and for which parameters, coordinates and channels are
/// read (one target in several channels, or at several points of a pixel): what pays for one of them pays for all.
pub(crate) fn cut_classes(graph: &Graph, residual: NodeId, parameters: &[NodeId]) -> Vec<BTreeSet<NodeId>> {
    let counts = graph.use_counts(&[residual]);
    let mut likeness: FxHashMap<NodeId, u64> = FxHashMap::default();
    for id in graph.reachable(&[residual]) {
        let node = graph.node(id);
        let mut below: Vec<u64> = operands(node).map(|n| likeness[&n]).collect();
        if let Node::Product(factors) = node {
            below.iter_mut().zip(factors.iter()).for_each(|(n, (_, e))| *n = FxBuildHasher.hash_one((*n, e)));
        }
        if matches!(node, Node::Sum(..) | Node::Product(_)) {
            below.sort_unstable();
        }
        let function = match node {
            Node::Call1(function, _) => FxBuildHasher.hash_one(function),
            Node::Call2(function, ..) => FxBuildHasher.hash_one(function),
            Node::Compare(comparison, ..) => FxBuildHasher.hash_one(comparison),
            _ => 0,
        };
        let own = (discriminant(node), function, graph.level(id), parameters.contains(&id), below);
        likeness.insert(id, FxBuildHasher.hash_one(own));
    }
    let mut classes: BTreeMap<(u64, u32), BTreeSet<NodeId>> = BTreeMap::new();
    for cut in cut_candidates(graph, residual, parameters) {
        classes.entry((likeness[&cut], counts[cut.index()])).or_default().insert(cut);
    }
    let mut classes: Vec<_> = classes.into_values().collect();
    classes.sort_unstable();
    classes
}

/// Shared pixel nodes that the chain rule may treat as variables: used more than once or nonlinearly, not mere offsets,
/// and finite wherever their operands are when a condition might choose another branch.
fn cut_candidates(graph: &Graph, residual: NodeId, parameters: &[NodeId]) -> BTreeSet<NodeId> {
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
