//! Selects the shared nodes that the chain rule may treat as variables.

use std::collections::{BTreeMap, BTreeSet};
use std::hash::BuildHasher;
use std::mem::discriminant;

use isophote_elementary::Function1;
use rustc_hash::{FxBuildHasher, FxHashMap};

use crate::graph::hyper::Order;
use crate::graph::signs::signs;
use crate::graph::{Graph, Node, NodeId, operands};
use crate::program::{Input, Level};

/// The cut candidates, grouped by structure up to numbers and to the parameters, coordinates and channels read (one
/// target in several channels, or at several points of a pixel): a cut that pays for one of them pays for all.
pub(crate) fn cut_classes(
    graph: &Graph,
    residuals: &[NodeId],
    parameters: &[NodeId],
    order: Order,
) -> Vec<BTreeSet<NodeId>> {
    let counts = graph.use_counts(residuals);
    let mut likeness: FxHashMap<NodeId, u64> = FxHashMap::default();
    for id in graph.reachable(residuals) {
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
            Node::Gather(lookup, ..) => FxBuildHasher.hash_one(lookup),
            Node::Compare(comparison, ..) => FxBuildHasher.hash_one(comparison),
            _ => 0,
        };
        let own = (discriminant(node), function, graph.level(id), parameters.contains(&id), below);
        likeness.insert(id, FxBuildHasher.hash_one(own));
    }
    let mut classes: BTreeMap<(u64, u32), BTreeSet<NodeId>> = BTreeMap::new();
    for cut in cut_candidates(graph, residuals, parameters, order) {
        classes.entry((likeness[&cut], counts[cut.index()])).or_default().insert(cut);
    }
    let mut classes: Vec<_> = classes.into_values().collect();
    classes.sort_unstable();
    classes
}

/// Shared pixel nodes that the chain rule may treat as variables: used more than once or nonlinearly, not mere offsets,
/// and finite wherever their operands are when a condition might choose another branch; to first order also those read
/// only in branches outside of which nothing depends on them.
fn cut_candidates(graph: &Graph, residuals: &[NodeId], parameters: &[NodeId], order: Order) -> BTreeSet<NodeId> {
    let reachable = graph.reachable(residuals);
    let counts = graph.use_counts(residuals);
    let Finite { depends, finite, .. } = Finite::below(graph, residuals, parameters);
    let exposed = match order {
        Order::First => exposed(graph, residuals, &reachable, &depends),
        Order::Second => reachable.iter().copied().collect(),
    };
    let differentiated = match order {
        Order::First => differentiated(graph, residuals, &reachable, &depends),
        Order::Second => reachable.iter().copied().collect(),
    };
    let mut powered = BTreeSet::new();
    for id in &reachable {
        match graph.node(*id) {
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
            && !residuals.contains(id)
            && !graph.is_truth(*id)
            && depends.contains(id)
            && differentiated.contains(id)
            && graph.level(*id) == Level::Pixel
            && (counts[id.index()] > 1 || powered.contains(id))
            && (finite.contains(id) || !exposed.contains(id))
    };
    let mut found: Vec<NodeId> = reachable.into_iter().filter(wanted).collect();
    found.sort_by_key(|n| std::cmp::Reverse(counts[n.index()]));
    found.truncate(if order == Order::First { 24 } else { 16 });
    found.into_iter().collect()
}

/// The values through which derivatives may be taken.
pub(crate) struct Finite {
    /// Those that depend on the parameters.
    pub depends: BTreeSet<NodeId>,
    /// Those that are finite, with their derivatives, wherever their operands are; all where nothing is conditional.
    pub finite: BTreeSet<NodeId>,
    /// Those whose reciprocal is finite, too.
    divisors: BTreeSet<NodeId>,
}

impl Finite {
    pub fn below(graph: &Graph, roots: &[NodeId], parameters: &[NodeId]) -> Finite {
        let reachable = graph.reachable(roots);
        let is_conditional = reachable.iter().any(|n| matches!(graph.node(*n), Node::Select(..)));
        let (at_least_zero, positive) = signs(graph, &reachable);
        let looked_at = looked_at(graph, &reachable);
        let is_divisor = |n: &NodeId| {
            positive.contains(n) || matches!(graph.node(*n), Node::Input(Input::Constant(_))) && !looked_at.contains(n)
        };
        let divisors: BTreeSet<NodeId> = reachable.iter().copied().filter(is_divisor).collect();
        let (mut depends, mut finite) = (BTreeSet::new(), BTreeSet::new());
        for id in reachable {
            let node = graph.node(id);
            if parameters.contains(&id) || operands(node).any(|n| depends.contains(&n)) {
                depends.insert(id);
            }
            let is_finite = match node {
                Node::Product(factors) => factors.iter().all(|(n, e)| *e > 0 || divisors.contains(n)),
                Node::Sqrt(a) => positive.contains(a) || at_least_zero.contains(a) && !depends.contains(a),
                Node::Call1(Function1::Fraction, _) => true,
                Node::Call1(..) | Node::Call2(..) => false,
                _ => true,
            };
            if !is_conditional || is_finite && operands(node).all(|n| finite.contains(&n)) {
                finite.insert(id);
            }
        }
        Finite { depends, finite, divisors }
    }

    /// True for a finite power of a finite value, and for any number.
    pub fn has_power(&self, graph: &Graph, node: NodeId, exponent: i32) -> bool {
        graph.value_of(node).is_some() || self.finite.contains(&node) && (exponent > 0 || self.divisors.contains(&node))
    }
}

/// The nodes on which the roots depend other than in a branch beside one that depends on no parameter.
fn exposed(graph: &Graph, roots: &[NodeId], reachable: &[NodeId], depends: &BTreeSet<NodeId>) -> BTreeSet<NodeId> {
    let mut exposed: BTreeSet<NodeId> = roots.iter().copied().collect();
    for id in reachable.iter().rev() {
        if !exposed.contains(id) {
            continue;
        }
        match graph.node(*id) {
            Node::Select(_, a, b) if depends.contains(a) && depends.contains(b) => exposed.extend([*a, *b]),
            Node::Select(..) => {}
            node => exposed.extend(operands(node)),
        }
    }
    exposed
}

/// The nodes through which derivatives are taken; those that only conditions read are left out.
fn differentiated(
    graph: &Graph,
    roots: &[NodeId],
    reachable: &[NodeId],
    depends: &BTreeSet<NodeId>,
) -> BTreeSet<NodeId> {
    let mut found: BTreeSet<NodeId> = roots.iter().copied().collect();
    for id in reachable.iter().rev().filter(|id| depends.contains(id)) {
        if found.contains(id) {
            let condition = match graph.node(*id) {
                Node::Select(condition, ..) => Some(*condition),
                _ => None,
            };
            found.extend(operands(graph.node(*id)).filter(|n| Some(*n) != condition));
        }
    }
    found
}

/// Values known per pass that pixel values depend on: sums and functions of parameters.
pub(crate) fn frontier(graph: &Graph, roots: &[NodeId], parameters: &[NodeId], below: &Finite) -> BTreeSet<NodeId> {
    let Finite { depends, finite, .. } = below;
    let is_earlier = |n: &NodeId| graph.level(*n) < Level::Pixel && depends.contains(n);
    let pixels = graph.reachable(roots).into_iter().filter(|n| graph.level(*n) == Level::Pixel);
    let mut stack: Vec<NodeId> =
        pixels.flat_map(|n| operands(graph.node(n)).filter(is_earlier).collect::<Vec<_>>()).collect();
    let (mut seen, mut found) = (BTreeSet::new(), BTreeSet::new());
    while let Some(id) = stack.pop() {
        if parameters.contains(&id) || !seen.insert(id) {
            continue;
        }
        let is_whole = graph.level(id) == Level::Pass && !matches!(graph.node(id), Node::Product(_));
        if is_whole && finite.contains(&id) && !graph.is_truth(id) {
            found.insert(id);
        } else {
            stack.extend(operands(graph.node(id)).filter(is_earlier));
        }
    }
    found
}

/// Nodes that conditions read other than as a divisor: such a condition may guard a division by zero.
fn looked_at(graph: &Graph, reachable: &[NodeId]) -> BTreeSet<NodeId> {
    let mut seen = BTreeSet::new();
    let mut stack: Vec<NodeId> = reachable.iter().copied().filter(|n| graph.is_truth(*n)).collect();
    while let Some(id) = stack.pop() {
        match graph.node(id) {
            Node::Product(factors) => {
                let read = factors.iter().filter(|(n, e)| *e > 0 || !matches!(graph.node(*n), Node::Input(_)));
                stack.extend(read.map(|(n, _)| *n).filter(|n| seen.insert(*n)));
            }
            node => stack.extend(operands(node).filter(|n| seen.insert(*n))),
        }
    }
    seen
}
