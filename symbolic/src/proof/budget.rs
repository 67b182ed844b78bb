//! Counts the cost of checking a document's programs in advance: the operations of forward differentiation, and the
//! number of points that a document's budget ([`LIMITS`]) allows. All stages and summands of a document share the
//! budget equally, so that the result does not depend on the order of derivation.

use std::collections::BTreeSet;

use crate::graph::{Graph, Node, NodeId, operands};
use crate::likelihood::claim::Claim;
use crate::model::{Method, Summand};
use crate::program::{Input, ParameterId};
use crate::proof::{ANYWHERE, CONDITIONAL_POINTS};
use isophote_syntax::limits::LIMITS;

/// Pixels evaluated once: in exact arithmetic, in f64, and over the window.
const ONCE: usize = 18;
/// Further pixels per point of a condition: in exact arithmetic, far off, and about a threshold.
const FURTHER: usize = 12;

/// The number of points at which a document is checked.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Room {
    /// Points for a condition's branches, for each program: eight, or as many, down to one, as the budget allows.
    pub points: u64,
    /// Single pixels tried where the formulas have no value about a target; their cost is at most the whole budget
    /// again.
    pub elsewhere: u64,
}

/// The points that the document's budget allows; `None` if not even one.
pub(crate) fn room(summand: &Summand, subset: &[ParameterId], claim: Claim) -> Option<Room> {
    let model = summand.model();
    let summed = summand.summed();
    let roots: Vec<NodeId> =
        summed.iter().flat_map(|entry| [Some(entry.observed), Some(entry.intensity), entry.noise]).flatten().collect();
    let graph = &model.formulas.graph;
    let reachable = graph.reachable(&roots);
    let is_conditional = summand.shape().is_conditional()
        || reachable.iter().any(|n| matches!(graph.node(*n), Node::Select(..) | Node::Abs(_)));
    let stages = model.stages.iter().map(|stage| (stage.parameters.to_vec(), stage.method == Method::Newton));
    let sets: BTreeSet<_> = stages.chain([(subset.to_vec(), claim.is_newton())]).collect();
    let mut pixel = 0_usize;
    for (parameters, newton) in sets {
        pixel = pixel.saturating_add(at_a_pixel(graph, &reachable, &parameters, newton));
    }
    let pixel = pixel.saturating_mul(model.summand_count().div_ceil(summed.len())).max(1);
    let pixels = |points: u64| if is_conditional { ONCE + FURTHER * points as usize } else { ONCE };
    let is_affordable = |points: &u64| pixel.saturating_mul(pixels(*points)) <= LIMITS.proof;
    let points = (1..=CONDITIONAL_POINTS).rev().find(is_affordable)?;
    let elsewhere = ANYWHERE.min((LIMITS.proof / pixel) as u64);
    Some(Room { points, elsewhere })
}

/// Operations of forward differentiation at one pixel: each operand of a node has one derivative per parameter below
/// it.
fn at_a_pixel(graph: &Graph, reachable: &[NodeId], parameters: &[ParameterId], newton: bool) -> usize {
    let of = |active: usize| match newton {
        true => 2 + 2 * active + 3 * active * (active + 1) / 2,
        false => 2 + 2 * active,
    };
    // Parameters beyond the last bit count as one: no document has as many.
    let mut below = vec![0_u128; graph.len()];
    let mut operations = 0_usize;
    for id in reachable {
        let node = graph.node(*id);
        let own = match node {
            Node::Input(Input::Parameter(p)) => parameters.iter().position(|q| q == p),
            _ => None,
        };
        let mut mask = own.map_or(0, |i| 1_u128 << i.min(127));
        let mut count = 1;
        for operand in operands(node) {
            mask |= below[operand.index()];
            count += 1;
        }
        below[id.index()] = mask;
        operations = operations.saturating_add(count * of(mask.count_ones() as usize));
    }
    operations.saturating_add(of(parameters.len()) + parameters.len() * parameters.len())
}
