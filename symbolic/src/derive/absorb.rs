//! Rewrites before the sums are formed: moves invariant factors into sums that nothing else uses.

use std::collections::BTreeSet;

use rustc_hash::{FxBuildHasher, FxHashMap};

use crate::graph::jet::Jet;
use crate::graph::{Bits, Graph, Node, NodeId, Powers, content};
use crate::program::Level;

/// Computation of a sum n that occurs both alone and with invariant factors c known to be positive.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Default)]
pub(crate) enum Scaling {
    #[default]
    AsWritten,
    /// As N = c n only: n becomes N / c, whose 1 / c leaves the loop.
    Unified,
}

/// The rewritten arguments of [`absorb`].
pub(crate) struct Absorbed {
    pub tops: Vec<NodeId>,
    pub jets: Vec<Jet>,
    pub others: Vec<NodeId>,
    /// Some factor could change sides, whether or not `scaling` allows it.
    pub is_unifiable: bool,
}

/// Moves invariant factors into sums that nothing else uses (v1 · (k1 + 2 k2 s) with both coefficients known per pass),
/// so that the factor costs nothing per pixel; flattens such sums into sums likewise.
pub(crate) fn absorb(
    graph: &mut Graph,
    tops: &[NodeId],
    jets: &[Jet],
    others: &[NodeId],
    scaling: Scaling,
) -> Absorbed {
    let mut roots = tops.to_vec();
    roots.extend(others);
    roots.extend(jets.iter().flat_map(|j| j.first.values().chain(j.second.values()).copied()));
    let counts = graph.use_counts(&roots);
    let held: BTreeSet<NodeId> = roots.iter().copied().collect();
    let lone = |n: NodeId| counts.get(n.index()) == Some(&1) && !held.contains(&n);
    let mut scales = scales(graph, &roots, &lone);
    let is_unifiable = !scales.is_empty();
    if scaling == Scaling::AsWritten {
        scales.clear();
    }
    let mut kept = BTreeSet::new();
    let reachable = graph.reachable(&roots);
    let mut map = FxHashMap::with_capacity_and_hasher(reachable.len(), FxBuildHasher);
    for id in reachable {
        let span = graph.span(id);
        graph.set_span(span);
        let new = match graph.node(id).clone() {
            Node::Sum(constant, terms) if graph.level(id) == Level::Pixel => {
                let mut list = Vec::new();
                let mut constant = constant.get();
                for (n, coefficient) in terms.iter().copied() {
                    let inner = map.get(&n).copied().unwrap_or(n);
                    match graph.node(inner).clone() {
                        Node::Sum(c, inside)
                            if lone(n)
                                && !kept.contains(&inner)
                                && free_to_scale(graph, &inside, coefficient.get() == 1.0) =>
                        {
                            constant += coefficient.get() * c.get();
                            list.extend(inside.iter().map(|(m, k)| (*m, coefficient.get() * k.get())));
                        }
                        _ => list.push((inner, coefficient.get())),
                    }
                }
                let sum = graph.sum(constant, list);
                if graph.is_opaque(id) {
                    graph.set_opaque(sum);
                }
                match (scales.get(&id), graph.node(sum).clone()) {
                    (Some(scale), Node::Sum(constant, terms)) => {
                        let scaled = distributed(graph, scale, constant, &terms);
                        graph.set_opaque(scaled);
                        kept.insert(scaled);
                        graph.product(1.0, scale.iter().map(|(n, e)| (*n, -e)).chain([(scaled, 1)]))
                    }
                    _ => sum,
                }
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
    let jets = jets.iter().map(mapped).collect();
    Absorbed { tops: new_tops, jets, others: others.iter().map(at).collect(), is_unifiable }
}

/// 1/(a or b) as 1/a or 1/b, where all alternatives are known earlier: the divisions leave the loop.
pub(crate) fn reciprocals(graph: &mut Graph, root: NodeId) -> NodeId {
    let (mut map, mut inverse) = (FxHashMap::default(), FxHashMap::default());
    for id in graph.reachable(&[root]) {
        let span = graph.span(id);
        graph.set_span(span);
        let new = match graph.node(id).clone() {
            Node::Product(factors) if factors.iter().any(|(n, e)| *e < 0 && inverse.contains_key(n)) => {
                let factor = |(n, e): &(NodeId, i32)| match inverse.get(n) {
                    Some(inverse) if *e < 0 => (*inverse, -e),
                    _ => (map.get(n).copied().unwrap_or(*n), *e),
                };
                let factors: Powers = factors.iter().map(factor).collect();
                let product = graph.product(1.0, factors);
                if graph.is_opaque(id) {
                    graph.set_opaque(product);
                }
                product
            }
            _ => graph.rebuild(id, &map),
        };
        if let Node::Select(condition, a, b) = *graph.node(new)
            && graph.level(new) == Level::Pixel
        {
            let mut of = |n: NodeId| match graph.level(n) {
                Level::Pixel => inverse.get(&n).copied(),
                _ => Some(graph.product(1.0, [(n, -1)])),
            };
            if let (Some(a), Some(b)) = (of(a), of(b)) {
                let select = graph.select(condition, a, b);
                inverse.insert(new, select);
                inverse.insert(id, select);
            }
        }
        map.insert(id, new);
    }
    map[&root]
}

/// Factors out invariants that several terms of a sum share (v1 + v1 k1 s is v1 (1 + k1 s)), so that the derivative
/// with respect to the factor is a part of the sum itself.
pub(crate) fn gather(graph: &mut Graph, root: NodeId) -> NodeId {
    let mut map = FxHashMap::default();
    for id in graph.reachable(&[root]) {
        let mut new = graph.rebuild(id, &map);
        if graph.level(new) == Level::Pixel
            && let Node::Sum(constant, terms) = graph.node(new).clone()
            && let Some((factor, _)) = shared_factor(graph, &terms, Level::Pixel)
        {
            let (mut inside, mut outside) = (Vec::new(), Vec::new());
            for (n, c) in terms.iter() {
                match graph.node(*n).clone() {
                    _ if *n == factor => inside.push((graph.number(1.0), c.get())),
                    Node::Product(f) if f.contains(&(factor, 1)) => {
                        let rest = graph.product(1.0, f.iter().copied().chain([(factor, -1)]));
                        inside.push((rest, c.get()));
                    }
                    _ => outside.push((*n, c.get())),
                }
            }
            // The sign stays outside, so that the inner sum is the node of its definition.
            let sign = inside.iter().map(|(_, c)| c.signum()).sum::<f64>().signum();
            let inside = graph.sum(0.0, inside.into_iter().map(|(n, c)| (n, sign * c)).collect::<Vec<_>>());
            graph.set_opaque(inside);
            outside.push((graph.mul(factor, inside), sign));
            let gathered = graph.sum(constant.get(), outside);
            if graph.is_opaque(new) {
                graph.set_opaque(gathered);
            }
            new = gathered;
        }
        map.insert(id, new);
    }
    map[&root]
}

/// The input that most terms have as a plain factor, and their number: at least two, at least one of them at `level`.
pub(crate) fn shared_factor(graph: &Graph, terms: &[(NodeId, Bits)], level: Level) -> Option<(NodeId, usize)> {
    let mut counts: FxHashMap<NodeId, (usize, bool)> = FxHashMap::default();
    let mut count = |factor: NodeId, there: bool| {
        if matches!(graph.node(factor), Node::Input(_)) {
            let entry = counts.entry(factor).or_default();
            *entry = (entry.0 + 1, entry.1 || there);
        }
    };
    for (n, _) in terms {
        match graph.node(*n) {
            Node::Product(f) => {
                f.iter().filter(|(_, e)| *e == 1).for_each(|(m, _)| count(*m, graph.level(*n) == level))
            }
            _ => count(*n, graph.level(*n) == level),
        }
    }
    let shared = counts.into_iter().filter(|(_, (times, there))| *times > 1 && *there);
    let most = shared.max_by_key(|(factor, (times, _))| (*times, *factor));
    most.map(|(factor, (times, _))| (factor, times))
}

/// Moves numeric factors of products into sums that only they use (2 r (k2 − 3 k3 s)), which costs nothing there.
pub(crate) fn absorb_numbers(graph: &mut Graph, roots: &mut [NodeId]) {
    let counts = graph.use_counts(roots);
    let lone = |n: NodeId| counts.get(n.index()) == Some(&1);
    let reachable = graph.reachable(roots);
    let mut map = FxHashMap::with_capacity_and_hasher(reachable.len(), FxBuildHasher);
    for id in reachable {
        let span = graph.span(id);
        graph.set_span(span);
        let new = match graph.node(id).clone() {
            Node::Sum(constant, terms) if graph.level(id) == Level::Pixel && terms.len() > 1 => {
                let mut list = Vec::with_capacity(terms.len());
                let content = content(constant, &terms).abs();
                for (n, coefficient) in terms.iter() {
                    let inner = map.get(n).copied().unwrap_or(*n);
                    let number = coefficient.get().abs() / content;
                    match (number != 1.0 && lone(*n)).then(|| scaled_factor(graph, inner, number, &lone)).flatten() {
                        Some(product) => list.push((product, coefficient.get().signum() * content)),
                        None => list.push((inner, coefficient.get())),
                    }
                }
                let sum = graph.sum(constant.get(), list);
                if graph.is_opaque(id) {
                    graph.set_opaque(sum);
                }
                sum
            }
            _ => graph.rebuild(id, &map),
        };
        map.insert(id, new);
    }
    roots.iter_mut().for_each(|root| *root = map[root]);
}

/// number · product with the number moved into the product's first sum that has a coefficient on every pixel term.
fn scaled_factor(graph: &mut Graph, product: NodeId, number: f64, lone: &dyn Fn(NodeId) -> bool) -> Option<NodeId> {
    let Node::Product(factors) = graph.node(product).clone() else { return None };
    let fits = |(n, e): &&(NodeId, i32)| {
        *e == 1
            && lone(*n)
            && graph.level(*n) == Level::Pixel
            && matches!(graph.node(*n), Node::Sum(_, terms) if terms.len() > 1 && paying(graph, terms) == 0)
    };
    let (sum, _) = *factors.iter().find(fits)?;
    let Node::Sum(constant, terms) = graph.node(sum).clone() else { return None };
    let scaled = graph.sum(number * constant.get(), terms.iter().map(|(n, c)| (*n, number * c.get())));
    // Opaque, or the number would be factored out again as the content of the sum.
    graph.set_opaque(scaled);
    let rest: Vec<_> = factors.iter().copied().filter(|(n, _)| *n != sum).chain([(scaled, 1)]).collect();
    Some(graph.product(1.0, rest))
}

/// True when scaling costs at most one more multiplication.
fn free_to_scale(graph: &Graph, terms: &[(NodeId, Bits)], unit: bool) -> bool {
    unit || paying(graph, terms) <= 1
}

/// Number of terms to which a factor adds a multiplication.
fn paying(graph: &Graph, terms: &[(NodeId, Bits)]) -> usize {
    let pays = |(n, coefficient): &&(NodeId, Bits)| {
        let invariant =
            matches!(graph.node(*n), Node::Product(f) if f.iter().any(|(m, _)| graph.level(*m) < Level::Pixel));
        graph.level(*n) == Level::Pixel && !invariant && coefficient.get().abs() == 1.0
    };
    terms.iter().filter(pays).count()
}

/// invariants · (a sum that only this product uses) as one sum.
fn absorbed(
    graph: &mut Graph,
    factors: &[(NodeId, i32)],
    map: &FxHashMap<NodeId, NodeId>,
    lone: &dyn Fn(NodeId) -> bool,
) -> Option<NodeId> {
    let (pixel, invariant): (Powers, Powers) =
        factors.iter().copied().partition(|(n, _)| graph.level(*n) == Level::Pixel);
    let [(sum, 1)] = pixel[..] else { return None };
    let inner = map.get(&sum).copied().unwrap_or(sum);
    let Node::Sum(constant, terms) = graph.node(inner).clone() else { return None };
    if invariant.is_empty() || !lone(sum) || !free_to_scale(graph, &terms, false) {
        return None;
    }
    let scale: Powers = invariant.iter().map(|(n, e)| (map.get(n).copied().unwrap_or(*n), *e)).collect();
    Some(distributed(graph, &scale, constant, &terms))
}

/// scale · (constant + Σ terms), term by term.
fn distributed(graph: &mut Graph, scale: &[(NodeId, i32)], constant: Bits, terms: &[(NodeId, Bits)]) -> NodeId {
    let mut list = Vec::with_capacity(terms.len() + 1);
    for (n, c) in terms {
        // Each term keeps its span.
        let span = graph.span(*n);
        graph.set_span(span);
        list.push((graph.product(c.get(), scale.iter().copied().chain([(*n, 1)])), 1.0));
    }
    if constant.get() != 0.0 {
        list.push((graph.product(constant.get(), scale.iter().copied()), 1.0));
    }
    graph.sum(0.0, list)
}

/// For sums that are also used unscaled: the positive invariant factors of some product with them.
fn scales(graph: &Graph, roots: &[NodeId], lone: &dyn Fn(NodeId) -> bool) -> FxHashMap<NodeId, Powers> {
    let mut scales = FxHashMap::default();
    for id in graph.reachable(roots) {
        let Node::Product(factors) = graph.node(id) else { continue };
        let (pixel, scale): (Powers, Powers) =
            factors.iter().copied().partition(|(n, _)| graph.level(*n) == Level::Pixel);
        let ([(sum, 1)], false) = (&pixel[..], scale.is_empty()) else { continue };
        let Node::Sum(_, terms) = graph.node(*sum) else { continue };
        let positive = scale.iter().all(|(n, _)| graph.is_declared_positive(*n));
        if positive && !lone(*sum) && paying(graph, terms) == 0 {
            scales.entry(*sum).or_insert(scale);
        }
    }
    scales
}
