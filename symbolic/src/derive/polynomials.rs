//! Collects polynomials in one shared value before differentiating: however they are written, they become Σ cᵢ sⁱ with
//! coefficients known per pass, so that Horner's rule and shared powers apply.

use rustc_hash::FxHashMap;

use crate::derive::absorb::shared_factor;
use crate::graph::{Graph, Node, NodeId};
use crate::program::Level;

/// The highest power collected.
const DEGREE: usize = 12;

/// `root` with every maximal part that is a polynomial in `variable` collected.
pub(crate) fn collected(graph: &mut Graph, root: NodeId, variable: NodeId) -> NodeId {
    let mut coefficients: FxHashMap<NodeId, Vec<NodeId>> = FxHashMap::default();
    let mut map: FxHashMap<NodeId, NodeId> = FxHashMap::default();
    let (zero, one) = (graph.number(0.0), graph.number(1.0));
    for id in graph.reachable(&[root]) {
        let found = match id {
            _ if id == variable => Some(vec![zero, one]),
            _ if graph.level(id) == Level::Pass => Some(vec![id]),
            _ => polynomial(graph, id, &coefficients),
        };
        match found {
            Some(list) => {
                coefficients.insert(id, list);
            }
            None => {
                // Writes the maximal polynomials below this node.
                let below: Vec<NodeId> = crate::graph::operands(graph.node(id)).collect();
                for operand in below {
                    if let (Some(list), false) = (coefficients.get(&operand), map.contains_key(&operand)) {
                        let node = written(graph, operand, variable, &list.clone());
                        map.insert(operand, node);
                    }
                }
                let new = graph.rebuild(id, &map);
                map.insert(id, new);
            }
        }
    }
    match coefficients.get(&root).cloned() {
        Some(list) => written(graph, root, variable, &list),
        None => map[&root],
    }
}

/// The coefficients of a sum or product of polynomials.
fn polynomial(graph: &mut Graph, id: NodeId, known: &FxHashMap<NodeId, Vec<NodeId>>) -> Option<Vec<NodeId>> {
    match graph.node(id).clone() {
        Node::Sum(constant, terms) => {
            let width = terms.iter().map(|(n, _)| known.get(n).map(Vec::len)).try_fold(1, |w, l| Some(w.max(l?)))?;
            let mut columns: Vec<Vec<(NodeId, f64)>> = vec![Vec::new(); width];
            for (n, c) in terms.iter() {
                known[n].iter().zip(&mut columns).for_each(|(entry, column)| column.push((*entry, c.get())));
            }
            let constants = std::iter::once(constant.get()).chain(std::iter::repeat(0.0));
            Some(columns.into_iter().zip(constants).map(|(column, constant)| graph.sum(constant, column)).collect())
        }
        Node::Product(factors) => {
            let mut product = vec![graph.number(1.0)];
            for (n, e) in factors.iter() {
                let factor = known.get(n)?;
                if factor.len() == 1 {
                    let power = graph.product(1.0, [(factor[0], *e)]);
                    product.iter_mut().for_each(|c| *c = graph.mul(*c, power));
                    continue;
                }
                for _ in 0..u32::try_from(*e).ok()? {
                    product = multiplied(graph, &product, factor)?;
                }
            }
            Some(product)
        }
        _ => None,
    }
}

fn multiplied(graph: &mut Graph, a: &[NodeId], b: &[NodeId]) -> Option<Vec<NodeId>> {
    if a.len() + b.len() > DEGREE + 2 {
        return None;
    }
    let mut columns: Vec<Vec<(NodeId, f64)>> = vec![Vec::new(); a.len() + b.len() - 1];
    for (i, x) in a.iter().enumerate() {
        for (j, y) in b.iter().enumerate() {
            columns[i + j].push((graph.mul(*x, *y), 1.0));
        }
    }
    Some(columns.into_iter().map(|column| graph.sum(0.0, column)).collect())
}

/// Σ cᵢ sⁱ with the common factors of each coefficient's terms factored out; the node itself below degree 2.
fn written(graph: &mut Graph, node: NodeId, variable: NodeId, coefficients: &[NodeId]) -> NodeId {
    if coefficients.len() < 3 {
        return node;
    }
    let terms: Vec<(NodeId, f64)> = coefficients
        .iter()
        .enumerate()
        .map(|(i, c)| {
            let c = if i == 0 { *c } else { factored(graph, *c) };
            (graph.product(1.0, [(c, 1), (variable, i as i32)]), 1.0)
        })
        .collect();
    graph.sum(0.0, terms)
}

/// A sum of products as a product, as far as all terms share factors.
fn factored(graph: &mut Graph, node: NodeId) -> NodeId {
    let Node::Sum(constant, terms) = graph.node(node).clone() else { return node };
    let Some((factor, times)) = shared_factor(graph, &terms, Level::Pass) else { return node };
    if constant.get() != 0.0 || times < terms.len() {
        return node;
    }
    let inside: Vec<(NodeId, f64)> =
        terms.iter().map(|(n, c)| (graph.product(1.0, [(*n, 1), (factor, -1)]), c.get())).collect();
    let inside = graph.sum(0.0, inside);
    let inside = factored(graph, inside);
    graph.set_opaque(inside);
    graph.mul(factor, inside)
}
