//! Comparisons and what joins them; what is known when the model is read is decided here.

use super::{Elaborator, Matrix, Poison, Worked};
use crate::language::graph::{Node, NodeId};
use crate::language::parser::{Expr, Junction, Relation};
use crate::program::{Comparison, holds};

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
        Ok(Matrix::scalar(self.graph.compare(comparison, a, b)))
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
