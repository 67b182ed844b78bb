//! Reduces the summed pixel values to a basis: finds those that are combinations of others with constant coefficients.
//!
//! Residues of all values at random points modulo 2⁶¹ − 1 are the rows of a matrix; its rank, exact except with
//! probability degree / 2⁶¹, is the number of sums needed, and its reduced rows hold the coefficients. (Coefficients
//! that depend on the row lower the rank further, but such sums cancel: polynomials in a column's number. So do sums
//! over the branches of a condition, where one branch is the whole value at some points; these are left alone.)

use isophote_elementary::Modular;

use crate::graph::hyper::Values;
use crate::graph::random::Random;
use crate::graph::{Graph, Node, NodeId};

/// Maximum number of values searched together.
const VALUES: usize = 128;

/// The largest coefficient of a combination: larger ones cancel.
const COEFFICIENT: f64 = 16.0;

/// Σ coefficient · value; `None` stands for the count of pixels.
pub(crate) type Combination = Vec<(Option<NodeId>, f64)>;

/// Those of `values` that are combinations of earlier ones, or of the constant 1.
pub(crate) fn dependent(graph: &Graph, values: &[NodeId]) -> Vec<(NodeId, Combination)> {
    let reachable = graph.reachable(values);
    let is_conditional = reachable.iter().any(|n| matches!(graph.node(*n), Node::Select(..) | Node::Abs(_)));
    if values.is_empty() || values.len() > VALUES || is_conditional {
        return Vec::new();
    }
    let width = values.len() + 1;
    let mut random = Random(1);
    let mut reduced: Vec<(usize, Vec<Modular>)> = Vec::new();
    let leaves: Vec<NodeId> = reachable.into_iter().filter(|n| is_leaf(graph.node(*n))).collect();
    let mut evaluator = Values::of(graph, values, &|_| Modular::of_bits(0));
    for _ in 0..width + 8 {
        let residues: Vec<Modular> = leaves.iter().map(|_| Modular::of_bits(random.bits())).collect();
        let leaf = |node: &Node| {
            let place = leaves.iter().position(|n| graph.node(*n) == node);
            place.map_or(Modular::of_bits(0), |i| residues[i])
        };
        evaluator.enter(&leaf);
        let at = evaluator.at(&leaf);
        insert(&mut reduced, std::iter::once(Modular::of_bits(1)).chain(at.iter().map(|x| x.value)).collect());
        if reduced.len() == width {
            return Vec::new();
        }
    }
    let is_pivot = |column: usize| reduced.iter().any(|(pivot, _)| *pivot == column);
    let combination = |column: usize| -> Option<Combination> {
        let part = |(pivot, row): &(usize, Vec<Modular>)| {
            let coefficient = row[column].small_fraction().filter(|c| c.abs() <= COEFFICIENT)?;
            Some((pivot.checked_sub(1).map(|i| values[i]), coefficient))
        };
        reduced.iter().filter(|(_, row)| row[column] != Modular::of_bits(0)).map(part).collect()
    };
    (1..width).filter(|column| !is_pivot(*column)).filter_map(|i| Some((values[i - 1], combination(i)?))).collect()
}

fn is_leaf(node: &Node) -> bool {
    matches!(node, Node::Input(_) | Node::Coordinate(_) | Node::Channel(_))
}

/// Adds a row to a reduced echelon form; its pivot is the first column left nonzero.
fn insert(reduced: &mut Vec<(usize, Vec<Modular>)>, mut row: Vec<Modular>) {
    let zero = Modular::of_bits(0);
    let subtract = |from: &mut [Modular], factor: Modular, what: &[Modular]| {
        from.iter_mut().zip(what).for_each(|(a, b)| *a = *a - factor * *b);
    };
    for (pivot, other) in reduced.iter() {
        let factor = row[*pivot];
        if factor != zero {
            subtract(&mut row, factor, other);
        }
    }
    let Some(pivot) = row.iter().position(|x| *x != zero) else { return };
    let scale = Modular::of_bits(1) / row[pivot];
    row.iter_mut().for_each(|x| *x = *x * scale);
    for (_, other) in reduced.iter_mut() {
        let factor = other[pivot];
        if factor != zero {
            subtract(other, factor, &row);
        }
    }
    reduced.push((pivot, row));
}

#[cfg(test)]
#[path = "rank_tests.rs"]
mod tests;
