//! Turns the domain into row bounds where it is a quadratic inequality in the inner coordinate with a leading
//! coefficient known to be positive, and into a mask otherwise.

use std::collections::BTreeSet;

use rustc_hash::FxHashSet;

use crate::graph::hyper::Order;
use crate::graph::jet::jet;
use crate::graph::signs::signs;
use crate::graph::{Graph, Node, NodeId};
use crate::program::{Comparison, CoordinateId, Level};

/// The pixels of a domain: bounds and mask must both hold where present.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PixelRegion {
    /// Row values: lo ≤ x ≤ hi.
    pub bounds: Option<(NodeId, NodeId)>,
    /// A pixel truth value.
    pub mask: Option<NodeId>,
}

/// Splits a condition into bounds and a mask.
pub(crate) fn region(graph: &mut Graph, condition: NodeId) -> PixelRegion {
    let (mut parts, mut seen) = (Vec::new(), FxHashSet::default());
    let mut stack = vec![condition];
    while let Some(id) = stack.pop() {
        graph.charge(1);
        match *graph.node(id) {
            _ if !seen.insert(id) => {}
            Node::And(a, b) => stack.extend([b, a]),
            _ => parts.push(id),
        }
    }
    let mut region = PixelRegion::default();
    for part in parts {
        match bounds(graph, part) {
            Some((lo, hi)) => {
                region.bounds = Some(match region.bounds {
                    None => (lo, hi),
                    Some((old_lo, old_hi)) => {
                        let tighter = graph.compare(Comparison::Lt, lo, old_lo);
                        let below = graph.compare(Comparison::Lt, old_hi, hi);
                        let lo = graph.select(tighter, old_lo, lo);
                        // A NaN on either side empties the row: `lo < old_lo` keeps that of `lo`, this that of `old_lo`.
                        let known = graph.compare(Comparison::Eq, old_lo, old_lo);
                        (graph.select(known, lo, old_lo), graph.select(below, old_hi, hi))
                    }
                });
            }
            None => region.mask = Some(region.mask.map_or(part, |mask| graph.and(mask, part))),
        }
    }
    region
}

fn bounds(graph: &mut Graph, part: NodeId) -> Option<(NodeId, NodeId)> {
    if graph.level(part) < Level::Pixel {
        // The whole row or nothing.
        let (all, nothing) = (graph.number(f64::NEG_INFINITY), graph.number(f64::NAN));
        let (lo, hi) = (graph.select(part, all, nothing), graph.number(f64::INFINITY));
        return Some((lo, hi));
    }
    let Node::Compare(Comparison::Le, left, right) = *graph.node(part) else { return None };
    let difference = graph.sub(left, right);
    let Parabola { curvature, slope_at_zero: b } = parabola(graph, difference)?;
    let c = graph.substitute(difference, &mut |graph, leaf| {
        matches!(leaf, Node::Coordinate(CoordinateId(0))).then(|| graph.number(0.0))
    });
    // e(x) = A x² + B x + C ≤ 0 with 2A = curvature: x = (−B ± √(B² − 2 (2A) C)) / (2A).
    let square = graph.product(1.0, [(b, 2)]);
    let product = graph.product(2.0, [(curvature, 1), (c, 1)]);
    let discriminant = graph.sub(square, product);
    let root = graph.sqrt(discriminant);
    let (low, high) = (graph.sum(0.0, [(b, -1.0), (root, -1.0)]), graph.sum(0.0, [(b, -1.0), (root, 1.0)]));
    Some((graph.div(low, curvature), graph.div(high, curvature)))
}

/// The value A x² + B x + C over a row, A known to be positive.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Parabola {
    /// 2 A.
    pub curvature: NodeId,
    /// B.
    pub slope_at_zero: NodeId,
}

/// The parabola of a value, found by its derivatives; `None` for a piecewise value.
pub(crate) fn parabola(graph: &mut Graph, value: NodeId) -> Option<Parabola> {
    let reachable = graph.walked(&[value]);
    let piecewise = |n: &NodeId| match graph.node(*n) {
        Node::Select(condition, ..) => graph.level(*condition) == Level::Pixel,
        Node::Abs(a) => graph.level(*a) == Level::Pixel,
        _ => false,
    };
    if reachable.iter().any(piecewise) {
        return None;
    }
    let x = graph.coordinate(CoordinateId(0));
    let slopes = jet(graph, value, &BTreeSet::from([x]), Order::Second);
    let curvature = *slopes.second.get(&(x, x))?;
    if graph.level(curvature) == Level::Pixel || !is_positive(graph, curvature) {
        return None;
    }
    let slope = *slopes.first.get(&x)?;
    let slope_at_zero = graph.substitute(slope, &mut |graph, leaf| {
        matches!(leaf, Node::Coordinate(CoordinateId(0))).then(|| graph.number(0.0))
    });
    Some(Parabola { curvature, slope_at_zero })
}

/// True when the value is positive for all inputs, as far as declared bounds show.
fn is_positive(graph: &mut Graph, node: NodeId) -> bool {
    let reachable = graph.walked(&[node]);
    signs(graph, &reachable).1.contains(&node)
}
