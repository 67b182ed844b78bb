//! Comparisons and logical connectives; folds those known at reading time.

use std::collections::BTreeSet;
use std::mem::discriminant;

use super::{Elaborator, Matrix, Poison, Worked};
use crate::graph::{Node, NodeId, operands};
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

    /// Compares after cancellation. Where q is NaN, q − q is NaN and no comparison with it holds: a condition that kept
    /// it would change once a later rewrite removes it.
    pub fn comparison(&mut self, comparison: Comparison, a: NodeId, b: NodeId) -> NodeId {
        let [a, b] = [a, b].map(|side| self.cancelled(side));
        self.graph.compare(comparison, a, b)
    }

    /// `side` with flattened sums if that cancels something; else unchanged, since others may share its parts. Visits
    /// each node of a document once, except in sides with a cancellation.
    fn cancelled(&mut self, side: NodeId) -> NodeId {
        let (mut unknown, mut stack) = (BTreeSet::new(), vec![side]);
        while let Some(id) = stack.pop() {
            if !self.workings.apart.contains_key(&id) && unknown.insert(id) {
                stack.extend(operands(self.graph.node(id)));
                self.graph.charge(1 + self.graph.operand_count(id));
            }
        }
        // Operands come first: their ids are smaller.
        for id in unknown {
            let apart = &self.workings.apart;
            let new = match self.graph.node(id).clone() {
                Node::Sum(constant, terms) => {
                    let terms = terms.iter().map(|(n, c)| (apart.get(n).copied().unwrap_or(*n), c.get()));
                    self.graph.sum(constant.get(), terms)
                }
                _ => self.graph.rebuild(id, apart),
            };
            let is_less =
                operands(self.graph.node(id)).any(|n| self.workings.lessened.contains(&n)) || self.leaves_out(id, new);
            self.workings.lessened.extend(is_less.then_some(id));
            self.workings.apart.insert(id, if self.graph.has_finite_numbers(new) { new } else { id });
        }
        if !self.workings.lessened.contains(&side) {
            return side;
        }
        let apart = self.workings.apart[&side];
        let [before, after] = [side, apart].map(|root| {
            let all = self.graph.walked(&[root]);
            all.into_iter().filter(|n| self.may_have_no_value(*n)).count()
        });
        if after < before { apart } else { side }
    }

    fn may_have_no_value(&self, node: NodeId) -> bool {
        match self.graph.node(node) {
            Node::Product(factors) => factors.iter().any(|(_, exponent)| *exponent < 0),
            node => matches!(node, Node::Sqrt(_) | Node::Call1(..) | Node::Call2(..)),
        }
    }

    /// True when `new`, made of a node's flattened operands, may lack a part that may be NaN.
    fn leaves_out(&self, id: NodeId, new: NodeId) -> bool {
        let whole = |n: NodeId| match self.graph.node(n) {
            Node::Sum(constant, terms) if terms.len() == 1 && constant.get() == 0.0 => terms[0].0,
            _ => n,
        };
        let parts = |n: NodeId| match self.graph.node(whole(n)) {
            Node::Product(factors) if !self.graph.is_opaque(whole(n)) => {
                factors.iter().fold(0_u64, |sum, (_, e)| sum + u64::from(e.unsigned_abs()))
            }
            _ => 1,
        };
        let of = |n: &NodeId| self.workings.apart.get(n).copied().unwrap_or(*n);
        match self.graph.node(id) {
            _ if new == id || !self.graph.may_lack_value(id) => false,
            Node::Sum(_, terms) => {
                let left = self.graph.terms(new);
                let all = terms.iter().flat_map(|(n, _)| self.graph.terms(of(n)));
                all.filter(|n| self.graph.may_lack_value(*n)).any(|n| left.binary_search(&n).is_err())
            }
            Node::Product(factors) => {
                let all = factors.iter().map(|(n, e)| u64::from(e.unsigned_abs()) * parts(of(n)));
                parts(new) < all.sum::<u64>()
            }
            node => discriminant(node) != discriminant(self.graph.node(new)),
        }
    }

    /// Leaves out parts known at reading time.
    pub(super) fn joined(&mut self, junction: Junction, parts: &[Expr], at: &Expr) -> Worked {
        let parts: Vec<_> = parts.iter().map(|part| self.truth(part)).collect();
        let parts = parts.into_iter().collect::<Result<Vec<_>, _>>().map_err(|_| Poison::Truth)?;
        self.graph.set_span(self.span(at));
        // The neutral element.
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
