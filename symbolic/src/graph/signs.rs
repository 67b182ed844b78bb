//! Signs of values, as far as their form shows.

use std::collections::BTreeSet;

use isophote_elementary::Function1;

use crate::graph::{Graph, Node, NodeId};

/// The values that are never negative, and those of them that are never zero, as far as their form shows.
pub(crate) fn signs(graph: &Graph, reachable: &[NodeId]) -> (BTreeSet<NodeId>, BTreeSet<NodeId>) {
    let (mut at_least_zero, mut positive) = (BTreeSet::new(), BTreeSet::new());
    for id in reachable {
        let (is_at_least_zero, is_positive) = match graph.node(*id) {
            Node::Number(bits) => (bits.get() >= 0.0, bits.get() > 0.0),
            Node::Input(_) => (graph.is_declared_positive(*id), graph.is_declared_positive(*id)),
            Node::Product(factors) => (
                factors.iter().all(|(n, e)| e % 2 == 0 || at_least_zero.contains(n)),
                factors.iter().all(|(n, _)| positive.contains(n)),
            ),
            Node::Sum(constant, terms) => {
                let is_sum =
                    constant.get() >= 0.0 && terms.iter().all(|(n, c)| c.get() > 0.0 && at_least_zero.contains(n));
                (is_sum, is_sum && (constant.get() > 0.0 || terms.iter().any(|(n, _)| positive.contains(n))))
            }
            Node::Sqrt(a) => (true, positive.contains(a)),
            Node::Call1(Function1::Exp, _) => (true, true),
            _ => (false, false),
        };
        at_least_zero.extend(is_at_least_zero.then_some(*id));
        positive.extend(is_positive.then_some(*id));
    }
    (at_least_zero, positive)
}
