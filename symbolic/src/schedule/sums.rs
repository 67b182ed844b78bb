//! The result of a derivation as plain data: outputs made of sums over pixels and rows of graph nodes, which the
//! schedule writes as a loop nest.

use rustc_hash::FxHashSet;

use crate::graph::{Graph, Node, NodeId};

/// coefficient · Σ_rows (row · Σ_pixels pixel); an absent row factor is 1, an absent pixel value counts pixels.
#[derive(Clone, Debug)]
pub struct Term {
    /// Known per pass.
    pub coefficient: NodeId,
    /// Known per row.
    pub row: Option<NodeId>,
    /// Summed.
    pub pixel: Option<NodeId>,
}

/// One result of a pass: a sum of terms.
#[derive(Clone, Debug)]
pub struct Output {
    /// Name, such as `F` or `dF/dbx`.
    pub name: String,
    /// The summands.
    pub terms: Vec<Term>,
}

#[derive(Clone, Debug)]
pub(crate) struct FactoredSums {
    pub outputs: Vec<Output>,
    /// Makes totals over one offset of the column from those over another, once a row.
    pub shift: Option<Shift>,
}

impl FactoredSums {
    /// The pixel values summed in the loop, after the shift.
    pub fn summed(&self, graph: &mut Graph) -> Vec<NodeId> {
        let Some(shift) = &self.shift else { return self.pixels() };
        let mut seen = FxHashSet::default();
        let parts: Vec<NodeId> = self.pixels().into_iter().flat_map(|p| shift.parts(graph, p)).flatten().collect();
        parts.into_iter().filter(|part| seen.insert(*part)).collect()
    }

    /// The distinct pixel values that are summed, in order of first use.
    pub fn pixels(&self) -> Vec<NodeId> {
        let mut seen = FxHashSet::default();
        self.outputs.iter().flat_map(|o| &o.terms).filter_map(|t| t.pixel).filter(|p| seen.insert(*p)).collect()
    }
}

/// Row totals over d from totals over u = d − e.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct Shift {
    /// d, a pixel value that is the column plus a row value.
    pub offset: NodeId,
    /// u, the column plus another row value.
    pub centred: NodeId,
    /// e, a row value.
    pub distance: NodeId,
}

impl Shift {
    /// The pixel values whose totals yield that of dᵏ · n: uʲ · n for j = 0 … k; `None` stands for the value 1.
    pub fn parts(&self, graph: &mut Graph, pixel: NodeId) -> Vec<Option<NodeId>> {
        let factors = match graph.node(pixel) {
            _ if pixel == self.offset => vec![(pixel, 1)],
            Node::Product(factors) => factors.to_vec(),
            _ => return vec![Some(pixel)],
        };
        let power = factors.iter().find(|(n, e)| *n == self.offset && *e > 0).map_or(0, |(_, e)| *e);
        let rest: Vec<_> = factors.into_iter().filter(|(n, e)| *n != self.offset || *e < 0).collect();
        (0..=power)
            .map(|j| {
                let value = graph.product(1.0, rest.iter().copied().chain([(self.centred, j)]));
                graph.value_of(value).is_none().then_some(value)
            })
            .collect()
    }
}
