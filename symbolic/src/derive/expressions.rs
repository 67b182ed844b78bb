//! The expressions of a derivation, to read: for whoever shows or counts them.
//!
//! What comes in: a derivation. What goes out: for each id the operation, its operands'
//! ids and the span of its formula. Nothing can be added to them from outside.

use isophote_elementary::Tables;

use crate::language::graph::{Graph, Node, NodeId};
use crate::program::Level;
use isophote_syntax::diagnostic::Span;

/// Expressions that share what they have in common; an operand's id is smaller than its user's.
#[derive(Clone, Copy, Debug)]
pub struct Expressions<'a>(&'a Graph);

impl<'a> Expressions<'a> {
    pub(crate) fn of(graph: &'a Graph) -> Expressions<'a> {
        Expressions(graph)
    }
    /// The operation.
    pub fn node(&self, id: NodeId) -> &'a Node {
        self.0.node(id)
    }
    /// What it looks up.
    pub fn tables(&self) -> &'a Tables {
        &self.0.tables
    }
    /// The formula that it came from.
    pub fn span(&self, id: NodeId) -> Option<Span> {
        self.0.span(id)
    }
    /// Where in the loop nest it is known: pass, row or pixel.
    pub fn level(&self, id: NodeId) -> Level {
        self.0.level(id)
    }
    /// A truth value, not a number.
    pub fn is_truth(&self, id: NodeId) -> bool {
        self.0.is_truth(id)
    }
    /// All that `roots` are made of, roots included, operands first.
    pub fn reachable(&self, roots: &[NodeId]) -> Vec<NodeId> {
        self.0.reachable(roots)
    }
    /// How often each expression is an operand of another below `roots`, by id.
    pub fn use_counts(&self, roots: &[NodeId]) -> Vec<u32> {
        self.0.use_counts(roots)
    }
}
