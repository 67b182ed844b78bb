//! Comparisons and what joins them; what is known when the model is read is decided here.

use rustc_hash::FxHashMap;

use super::{Elaborator, Matrix, Poison, Worked};
use crate::language::graph::{Node, NodeId};
use crate::program::{Comparison, holds};
use isophote_syntax::parser::{Expr, Junction, Relation};

impl Elaborator<'_> {
    pub(super) fn compare(&mut self, relation: Relation, left: &Expr, right: &Expr, at: &Expr) -> Worked {
        let (a, b) = (self.scalar(left), self.scalar(right));
        let (Ok(a), Ok(b)) = (a, b) else { return Err(Poison::Truth) };
        self.graph.set_span(self.span(at));
        let (comparison, a, b) = match relation {
            Relation::Lt => (Comparison::Lt, a, b),
            Relation::Le => (Comparison::Le, a, b),
            Relation::Gt => (Comparison::Lt, b, a),
            Relation::Ge => (Comparison::Le, b, a),
            Relation::Eq => (Comparison::Eq, a, b),
            Relation::Ne => (Comparison::Ne, a, b),
        };
        Ok(Matrix::scalar(self.comparison(comparison, a, b)))
    }

    /// Compares what is left when all that cancels has cancelled. Where q has no value, q − q has none either and no
    /// comparison with it holds: a condition that kept it would be another once a later rewrite takes it out.
    pub fn comparison(&mut self, comparison: Comparison, a: NodeId, b: NodeId) -> NodeId {
        let [a, b] = [a, b].map(|side| self.cancelled(side));
        self.graph.compare(comparison, a, b)
    }

    /// `side` with its sums taken apart where that leaves something out; else as it is, for others may share its parts.
    fn cancelled(&mut self, side: NodeId) -> NodeId {
        let nodes = self.graph.reachable(&[side]);
        self.graph.charge(nodes.len());
        let mut map = FxHashMap::default();
        for id in &nodes {
            let new = match self.graph.node(*id).clone() {
                Node::Sum(constant, terms) => {
                    let terms: Vec<_> = terms.iter().map(|(n, c)| (map[n], c.get())).collect();
                    self.graph.sum(constant.get(), terms)
                }
                _ => self.graph.rebuild(*id, &map),
            };
            map.insert(*id, new);
        }
        let may_have_no_value = |n: &&NodeId| match self.graph.node(**n) {
            Node::Product(factors) => factors.iter().any(|(_, exponent)| *exponent < 0),
            node => matches!(node, Node::Sqrt(_) | Node::Call1(..) | Node::Call2(..)),
        };
        let parts = |nodes: &[NodeId]| nodes.iter().filter(may_have_no_value).count();
        if parts(&self.graph.reachable(&[map[&side]])) < parts(&nodes) { map[&side] } else { side }
    }

    /// What is known now is left out.
    pub(super) fn joined(&mut self, junction: Junction, parts: &[Expr], at: &Expr) -> Worked {
        let parts: Vec<_> = parts.iter().map(|part| self.truth(part)).collect();
        let parts = parts.into_iter().collect::<Result<Vec<_>, _>>().map_err(|_| Poison::Truth)?;
        self.graph.set_span(self.span(at));
        // What may be left out.
        let neutral = matches!(junction, Junction::And);
        let mut total = parts[0];
        for next in &parts[1..] {
            total = match (self.known_truth(total), self.known_truth(*next)) {
                (Some(known), _) if known == neutral => *next,
                (None, Some(known)) if known != neutral => *next,
                (None, None) => match junction {
                    Junction::And => self.graph.and(total, *next),
                    Junction::Or => self.graph.or(total, *next),
                },
                _ => total,
            };
        }
        Ok(Matrix::scalar(total))
    }

    pub(super) fn not(&mut self, inner: &Expr, at: &Expr) -> Worked {
        let inner = self.truth(inner).map_err(|_| Poison::Truth)?;
        self.graph.set_span(self.span(at));
        Ok(Matrix::scalar(match self.known_truth(inner) {
            Some(known) => {
                let zero = self.graph.number(0.0);
                self.graph.compare(if known { Comparison::Lt } else { Comparison::Le }, zero, zero)
            }
            None => self.graph.not(inner),
        }))
    }

    /// The value of a comparison between numbers.
    pub fn known_truth(&self, node: NodeId) -> Option<bool> {
        let Node::Compare(comparison, a, b) = self.graph.node(node) else { return None };
        let (a, b) = (self.graph.value_of(*a)?, self.graph.value_of(*b)?);
        Some(holds(*comparison, a, b))
    }
}
