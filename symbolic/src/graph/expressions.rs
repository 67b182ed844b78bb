//! Read-only view of a derivation's expressions, to show or count them: per id the operation, its operands' ids and the
//! span of its formula.

use isophote_elementary::Tables;

use crate::graph::{Graph, Node, NodeId};
use crate::program::Level;
use isophote_syntax::diagnostic::Span;

/// A graph of expressions with shared parts; an operand's id is smaller than its user's.
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
    /// The lookup tables.
    pub fn tables(&self) -> &'a Tables {
        &self.0.tables
    }
    /// The formula it comes from.
    pub fn span(&self, id: NodeId) -> Option<Span> {
        self.0.span(id)
    }
    /// The level of the loop nest that computes it: pass, row or pixel.
    pub fn level(&self, id: NodeId) -> Level {
        self.0.level(id)
    }
    /// True for a truth value, false for a number.
    pub fn is_truth(&self, id: NodeId) -> bool {
        self.0.is_truth(id)
    }
    /// All nodes below `roots`, roots included, operands first.
    pub fn reachable(&self, roots: &[NodeId]) -> Vec<NodeId> {
        self.0.reachable(roots)
    }
    /// Number of uses of each expression as an operand below `roots`, by id.
    pub fn use_counts(&self, roots: &[NodeId]) -> Vec<u32> {
        self.0.use_counts(roots)
    }
}
