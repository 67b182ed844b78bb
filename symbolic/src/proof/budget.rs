//! What checking a document's programs costs, counted before it is done.
//!
//! What comes in: the formulas, and which derivatives are to be checked. What goes out: operations on numbers, as forward
//! differentiation does them, and at how many points a document's budget ([`LIMITS`]) has room to check. All stages and all summands
//! of a document share it alike, so that the answer does not depend on which is derived first.

use std::collections::BTreeSet;

use crate::language::graph::{Graph, Node, NodeId, operands};
use crate::language::model::{Method, Model};
use crate::program::{Input, ParameterId};
use crate::proof::{ANYWHERE, CONDITIONAL_POINTS};
use isophote_syntax::limits::LIMITS;

/// Pixels at which all is worked out once: in exact arithmetic, in f64, and over the window.
const ONCE: usize = 18;
/// Pixels that each further point of a condition adds: in exact arithmetic, far off, and about a threshold.
const FURTHER: usize = 12;

/// At how many points a document is checked.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Room {
    /// Of a condition's branches, for each program: eight, or as many, down to one, as there is room for.
    pub points: u64,
    /// Single pixels tried where the formulas have no value about a target; once more what all else may cost.
    pub elsewhere: u64,
}

/// What the document's budget has room for. `None` when that is not one point.
pub(crate) fn room(model: &Model, subset: &[ParameterId], method: Method) -> Option<Room> {
    let formulas = &model.formulas;
    let summed = formulas.summed();
    let roots: Vec<NodeId> =
        summed.iter().flat_map(|entry| [Some(entry.observed), Some(entry.intensity), entry.noise]).flatten().collect();
    let graph = &formulas.graph;
    let reachable = graph.reachable(&roots);
    let is_conditional = formulas.shape().is_conditional()
        || reachable.iter().any(|n| matches!(graph.node(*n), Node::Select(..) | Node::Abs(_)));
    let key = |parameters: &[ParameterId], method: Method| (parameters.to_vec(), method == Method::Newton);
    let stages = model.stages.iter().map(|stage| key(&stage.parameters, stage.method));
    let sets: BTreeSet<_> = stages.chain([key(subset, method)]).collect();
    let mut pixel = 0_usize;
    for (parameters, newton) in sets {
        pixel = pixel.saturating_add(at_a_pixel(graph, &reachable, &parameters, newton));
    }
    let pixel = pixel.saturating_mul(model.siblings().div_ceil(summed.len())).max(1);
    let pixels = |points: u64| if is_conditional { ONCE + FURTHER * points as usize } else { ONCE };
    let is_affordable = |points: &u64| pixel.saturating_mul(pixels(*points)) <= LIMITS.proof;
    let points = (1..=CONDITIONAL_POINTS).rev().find(is_affordable)?;
    let elsewhere = ANYWHERE.min((LIMITS.proof / pixel) as u64);
    Some(Room { points, elsewhere })
}

/// Operations of forward differentiation at one pixel: each operand of a node has as many derivatives as it has parameters
/// below it.
fn at_a_pixel(graph: &Graph, reachable: &[NodeId], parameters: &[ParameterId], newton: bool) -> usize {
    let of = |active: usize| match newton {
        true => 2 + 2 * active + 3 * active * (active + 1) / 2,
        false => 2 + 2 * active,
    };
    // Parameters beyond the last bit are taken for one: there are not as many in a document.
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
