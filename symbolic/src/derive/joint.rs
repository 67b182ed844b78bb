//! Sums several values of a pixel in one loop, for channels that mix the same lights.
//!
//! Residuals change together in *directions*. Where r_c,l = a_c g_l with the same a for several variables l (the
//! contribution of a light to each of three channels), F_l = (Σ L_c a_c) g_l and F_lm = (Σ Q_c a_c b_c) g_l g_m: the
//! factors of the lights' own derivatives are summed over the channels first. A single value has one direction, a = 1.

use std::collections::BTreeMap;

use rustc_hash::FxHashMap;

use crate::derive::monomial::{factors, whole_output};
use crate::graph::hyper::Order;
use crate::graph::jet::Jet;
use crate::graph::{Graph, NodeId, Powers};
use crate::likelihood::shape::Shape;
use crate::likelihood::terms::PixelValue;
use crate::likelihood::terms::counts;
use crate::schedule::sums::Output;

/// Names of the two counts.
const COUNTED: [&str; 2] = ["seen", "saturated"];

/// See the module's text.
#[derive(Clone, Debug)]
pub(crate) struct Direction {
    /// a: residual indices and slopes; empty for a single residual, whose slope is 1.
    pub parts: Vec<(usize, NodeId)>,
    /// g.
    pub gradient: Jet,
}

/// The directions of residuals with these first derivatives.
pub(crate) fn directions(graph: &mut Graph, jets: &[Jet]) -> Vec<Direction> {
    if let [alone] = jets {
        return vec![Direction { parts: Vec::new(), gradient: alone.clone() }];
    }
    let mut of: BTreeMap<NodeId, Vec<(usize, NodeId)>> = BTreeMap::new();
    for (number, jet) in jets.iter().enumerate() {
        jet.first.iter().for_each(|(l, slope)| of.entry(*l).or_default().push((number, *slope)));
    }
    let mut found: Vec<Direction> = Vec::new();
    for (l, slopes) in of {
        let (shared, parts) = apart(graph, &slopes);
        match found.iter_mut().find(|direction| direction.parts == parts) {
            Some(direction) => _ = direction.gradient.first.insert(l, shared),
            None => found.push(Direction { parts, gradient: Jet { first: [(l, shared)].into(), ..Jet::default() } }),
        }
    }
    found
}

/// The factors that all slopes share, and the rest of each.
fn apart(graph: &mut Graph, slopes: &[(usize, NodeId)]) -> (NodeId, Vec<(usize, NodeId)>) {
    let factors: Vec<(f64, Powers)> = slopes.iter().map(|(_, slope)| factors(graph, *slope)).collect();
    let mut shared = factors[0].1.clone();
    for (_, others) in &factors[1..] {
        let least = |(node, exponent): &(NodeId, i32)| {
            let other =
                others.iter().find(|(n, e)| n == node && e.signum() == exponent.signum()).map_or(0, |(_, e)| *e);
            (*node, if exponent.abs() < other.abs() { *exponent } else { other })
        };
        shared = shared.iter().map(least).filter(|(_, exponent)| *exponent != 0).collect();
    }
    let number = factors[0].0;
    let left = slopes.iter().zip(&factors).map(|((which, _), (own, powers))| {
        let rest = powers.iter().copied().chain(shared.iter().map(|(n, e)| (*n, -e)));
        (*which, graph.product(own / number, rest))
    });
    let left = left.collect();
    (graph.product(number, shared), left)
}

/// F's Gauss–Newton derivatives by the directions.
pub(crate) struct Weights {
    /// F_a of each direction.
    pub slopes: Vec<NodeId>,
    /// F_ab of each pair of directions that has one, first index ≤ second.
    pub curvatures: FxHashMap<(usize, usize), NodeId>,
}

impl Weights {
    /// `top`: F's derivatives by the residuals.
    pub fn of(graph: &mut Graph, top: &Jet, residuals: &[NodeId], directions: &[Direction]) -> Option<Weights> {
        let each = residuals.iter().map(|r| Some((*top.first.get(r)?, *top.second.get(&(*r, *r))?)));
        let each: Vec<(NodeId, NodeId)> = each.collect::<Option<_>>()?;
        if let [(slope, curvature)] = each[..] {
            return Some(Weights { slopes: vec![slope], curvatures: [((0, 0), curvature)].into_iter().collect() });
        }
        let mut sum = |terms: Vec<Powers>| {
            let products = terms.into_iter().map(|factors| (graph.product(1.0, factors), 1.0)).collect::<Vec<_>>();
            let is_sum = products.len() > 1;
            let node = graph.sum(0.0, products);
            if is_sum {
                graph.set_opaque(node);
            }
            node
        };
        let slope = |(which, a): &(usize, NodeId)| Powers::from_slice(&[(each[*which].0, 1), (*a, 1)]);
        let slopes = directions.iter().map(|direction| sum(direction.parts.iter().map(slope).collect())).collect();
        let mut curvatures = FxHashMap::default();
        for (i, first) in directions.iter().enumerate() {
            for (j, second) in directions.iter().enumerate().skip(i) {
                let both = first.parts.iter().flat_map(|a| second.parts.iter().map(move |b| (a, b)));
                let both = both.filter(|((c, _), (d, _))| c == d);
                let terms: Vec<_> = both
                    .map(|((which, a), (_, b))| Powers::from_slice(&[(each[*which].1, 1), (*a, 1), (*b, 1)]))
                    .collect();
                if !terms.is_empty() {
                    curvatures.insert((i, j), sum(terms));
                }
            }
        }
        Some(Weights { slopes, curvatures })
    }
}

/// F, and its derivatives by residuals (and by variances at second order), over all values below their limit.
pub(crate) fn top(graph: &mut Graph, shape: Shape, order: Order, values: &[PixelValue]) -> (NodeId, Jet) {
    let (mut all, mut terms) = (Jet::default(), Vec::new());
    for value in values {
        let tops: Vec<NodeId> =
            [Some(value.residual), value.variance.filter(|_| order == Order::Second)].into_iter().flatten().collect();
        let (whole, Jet { first, second }) = shape.jet(graph, order, &tops, value.variance);
        terms.push((masked(graph, value, whole), 1.0));
        all.first.extend(first.into_iter().map(|(l, slope)| (l, masked(graph, value, slope))));
        all.second.extend(second.into_iter().map(|(pair, slope)| (pair, masked(graph, value, slope))));
    }
    (graph.sum(0.0, terms), all)
}

/// F with ln σ², and F without it, over all values below their limit.
pub(crate) fn full(
    graph: &mut Graph,
    shape: Shape,
    values: &[PixelValue],
    variance: impl Fn(&PixelValue) -> Option<NodeId>,
) -> [NodeId; 2] {
    let mut each = [Vec::new(), Vec::new()];
    for value in values {
        let parts = shape.full(graph, value.residual, variance(value));
        each.iter_mut().zip(parts).for_each(|(list, part)| list.push((masked(graph, value, part), 1.0)));
    }
    each.map(|terms| graph.sum(0.0, terms))
}

/// Zero unless the value is below its limit.
fn masked(graph: &mut Graph, value: &PixelValue, node: NodeId) -> NodeId {
    let Some([below, _]) = value.below else { return node };
    let zero = graph.number(0.0);
    graph.select(below, node, zero)
}

/// The number of values below their limits, and of those at them; empty unless values are masked one by one.
pub(crate) fn counted(graph: &mut Graph, values: &[PixelValue]) -> Vec<Output> {
    let counts = counts(graph, values);
    if counts.is_empty() {
        return Vec::new();
    }
    let sum = |graph: &mut Graph, which: usize| {
        let node = graph.sum(0.0, counts.iter().skip(which).step_by(2).map(|count| (*count, 1.0)));
        whole_output(graph, COUNTED[which], node)
    };
    vec![sum(graph, 0), sum(graph, 1)]
}
