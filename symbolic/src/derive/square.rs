//! Completes the square: s = A d² + B d + C over a row, with d the column's offset, becomes A (u² + c), u = x − x₀,
//! where x₀ is the vertex of the row. That saves two flops a pixel, and nothing cancels: s is least where u is 0.
//!
//! The sums over dᵏ · n are rewritten over u; a shift makes row totals of dᵏ · n from those of uʲ · n once a row,
//! dᵏ = (u + e)ᵏ.

use std::collections::BTreeSet;

use rustc_hash::FxHashMap;

use crate::derive::monomial::Splitter;
use crate::graph::{Graph, Node, NodeId};
use crate::program::{CoordinateId, Level};
use crate::schedule::domain::parabola;
use crate::schedule::sums::{FactoredSums, Shift};

/// Maximum number of sums tried.
const SUMS: usize = 16;

/// The sums with their first parabola over the column completed; `None` when there is none.
pub(crate) fn completed(graph: &mut Graph, sums: &FactoredSums) -> Option<FactoredSums> {
    let pixels = sums.pixels();
    let reachable = graph.reachable(&pixels);
    let is_sum = |n: &NodeId| graph.level(*n) == Level::Pixel && matches!(graph.node(*n), Node::Sum(..));
    let candidates: Vec<NodeId> = reachable.iter().copied().filter(is_sum).take(SUMS).collect();
    let (s, parabola) = candidates.iter().find_map(|s| Some((*s, parabola(graph, *s)?)))?;
    let vertex = graph.product(-1.0, [(parabola.slope_at_zero, 1), (parabola.curvature, -1)]);
    let at_vertex = |graph: &mut Graph, node: NodeId| {
        graph.substitute(node, &mut |_, leaf| matches!(leaf, Node::Coordinate(CoordinateId(0))).then_some(vertex))
    };
    // s = A (u² + c)
    let least = at_vertex(graph, s);
    let least = graph.product(2.0, [(least, 1), (parabola.curvature, -1)]);
    let x = graph.coordinate(CoordinateId(0));
    let centred = graph.sum(0.0, [(x, 1.0), (vertex, -1.0)]);
    graph.set_opaque(centred);
    let square = graph.product(1.0, [(centred, 2)]);
    let square = graph.sum(0.0, [(square, 1.0), (least, 1.0)]);
    graph.set_opaque(square);
    let whole = graph.product(0.5, [(parabola.curvature, 1), (square, 1)]);
    let is_offset = |n: &NodeId| match graph.node(*n) {
        Node::Sum(_, terms) => {
            terms.contains(&(x, crate::graph::Bits::new(1.0)))
                && terms.iter().all(|(n, _)| *n == x || graph.level(*n) < Level::Pixel)
        }
        _ => false,
    };
    let offset = pixels.iter().find_map(|pixel| match graph.node(*pixel) {
        Node::Product(factors) => factors.iter().map(|(n, _)| *n).find(is_offset),
        _ => Some(*pixel).filter(is_offset),
    })?;
    if offset == centred {
        return None;
    }
    let mut map = FxHashMap::from_iter([(s, whole)]);
    for id in reachable.into_iter().filter(|id| *id > s) {
        let new = graph.rebuild(id, &map);
        map.insert(id, new);
    }
    let nothing = BTreeSet::new();
    let splitter = Splitter::new(&nothing);
    let mut outputs = sums.outputs.clone();
    for term in outputs.iter_mut().flat_map(|o| &mut o.terms) {
        // The factor A is known per pass and leaves the product.
        if let Some(new) = term.pixel.and_then(|pixel| map.get(&pixel).copied()).filter(|new| Some(*new) != term.pixel)
        {
            let [whole] = &splitter.whole(graph, new).into_terms(graph)[..] else { return None };
            let row: Vec<_> = [term.row, whole.row].into_iter().flatten().map(|n| (n, 1)).collect();
            term.row = (!row.is_empty()).then(|| graph.product(1.0, row));
            term.coefficient = graph.mul(term.coefficient, whole.coefficient);
            term.pixel = whole.pixel;
        }
    }
    let distance = at_vertex(graph, offset);
    Some(FactoredSums { outputs, shift: Some(Shift { offset, centred, distance }) })
}
