//! What checking a document's programs costs, counted before it is done.
//!
//! What comes in: the formulas, and which derivatives are to be checked. What goes out: operations on numbers, as forward
//! differentiation does them, and how many points a document's budget ([`LIMITS`]) has room for. All stages and all summands
//! of a document share it alike, so that the answer does not depend on which is derived first.

use std::collections::BTreeSet;

use crate::language::graph::{Graph, Node, NodeId, operands};
use crate::language::limits::LIMITS;
use crate::language::model::{Method, Model};
use crate::program::{Input, ParameterId};
use crate::proof::CONDITIONAL_POINTS;
use crate::proof::hyper::Order;
use crate::proof::referee::Subject;

/// Pixels at which all is worked out once: in exact arithmetic, in f64, and over the window.
const ONCE: usize = 18;
/// Pixels that each further point of a condition adds: in exact arithmetic, far off, and about a threshold.
const FURTHER: usize = 12;

/// Operations of a document's checks with so many points for conditions.
struct Plan {
    /// At one pixel, by set of parameters.
    pixel: usize,
    is_conditional: bool,
}

impl Plan {
    fn operations(&self, points: u64) -> usize {
        let further = if self.is_conditional { FURTHER.saturating_mul(points as usize) } else { 0 };
        self.pixel.saturating_mul(ONCE + further)
    }
}

/// How many points of a condition's branches each program is checked at: eight, or as many, down to one, as the document's
/// budget has room for. `None` when there is no room for one.
pub(crate) fn points(model: &Model, subset: &[ParameterId], method: Method) -> Option<u64> {
    let formulas = &model.formulas;
    let mut roots: Vec<NodeId> = vec![formulas.observed, formulas.intensity];
    roots.extend(formulas.noise);
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
    let plan = Plan { pixel: pixel.saturating_mul(model.siblings()), is_conditional };
    (1..=CONDITIONAL_POINTS).rev().find(|points| plan.operations(*points) <= LIMITS.proof)
}

/// Operations of the check of one set of sums.
pub(crate) fn of_sums(subject: &Subject, is_conditional: bool, points: u64) -> usize {
    let graph = &subject.graph;
    let parameter = |n: &NodeId| match graph.node(*n) {
        Node::Input(Input::Parameter(p)) => Some(*p),
        _ => None,
    };
    let parameters: Vec<ParameterId> = subject.parameters.iter().filter_map(parameter).collect();
    let reachable = graph.reachable(&subject.roots());
    let pixel = at_a_pixel(graph, &reachable, &parameters, subject.order() == Order::Second);
    Plan { pixel, is_conditional }.operations(points)
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
