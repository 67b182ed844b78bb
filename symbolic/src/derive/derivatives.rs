//! The derivatives of F as differentiation writes them, not factored, expanded or split: expressions to show, count and
//! compare with; [`Model::objective`] is the fast form.

use std::collections::BTreeSet;

use crate::graph::expressions::Expressions;
use crate::graph::hyper::Order;
use crate::graph::jet::{jet, pair};
use crate::graph::{Graph, NodeId};
use crate::likelihood::claim::{Claim, Part};
use crate::likelihood::terms::PixelValue;
use crate::likelihood::terms::values;
use crate::model::{Method, Model, Summand};
use crate::program::{Input, ParameterId};
use isophote_syntax::diagnostic::Diagnostics;

/// Derivatives of one pixel's F, F itself left out.
#[derive(Clone, Debug)]
pub struct Derivatives {
    graph: Graph,
    entries: Vec<(String, NodeId)>,
}

impl Derivatives {
    /// The graph of the entries.
    pub fn expressions(&self) -> Expressions<'_> {
        Expressions::of(&self.graph)
    }
    /// `dF/dbx`, …, then the upper Hessian row by row.
    pub fn entries(&self) -> &[(String, NodeId)] {
        &self.entries
    }
}

impl Model {
    /// Gradient, Hessian or both as they are written down; ignores the domain.
    ///
    /// # Errors
    /// Derivatives that grow past a limit.
    pub fn derivatives(&self, subset: &[ParameterId], method: Method, part: Part) -> Result<Derivatives, Diagnostics> {
        let summand = self.first_summand();
        let mut graph = self.formulas.graph.drawing_on(summand.budget());
        let entries = entries(&mut graph, &summand, subset, method, part);
        match graph.overflowed() {
            true => Err(summand.growth(subset.len())),
            false => Ok(Derivatives { graph, entries }),
        }
    }
}

/// The named derivatives of F, as differentiation writes them.
fn entries(
    graph: &mut Graph,
    summand: &Summand,
    subset: &[ParameterId],
    method: Method,
    part: Part,
) -> Vec<(String, NodeId)> {
    let newton = method == Method::Newton;
    let order = if newton { Order::Second } else { Order::First };
    let PixelValue { residual, variance, .. } = values(graph, summand, Claim::Derivatives { newton, part })[0];
    let parameters: Vec<NodeId> = subset.iter().map(|p| graph.input(Input::Parameter(*p))).collect();
    let variables: BTreeSet<NodeId> = parameters.iter().copied().collect();
    let name = |i: usize| &summand.model().parameters[subset[i].index()].name;
    let zero = graph.number(0.0);
    // Newton: F itself; else L r_u and Q r_u r_v.
    let (total, own) = summand.shape().jet(graph, order, &[residual], variance);
    let entry = |node: Option<&NodeId>| node.copied().unwrap_or(zero);
    let (l, q) = (entry(own.first.get(&residual)), entry(own.second.get(&(residual, residual))));
    let root = if newton { total } else { residual };
    let jet = jet(graph, root, &variables, if part.has_hessian() { order } else { Order::First });
    let first: Vec<NodeId> = parameters.iter().map(|u| jet.first.get(u).copied().unwrap_or(zero)).collect();
    let mut list = Vec::new();
    for i in (0..parameters.len()).filter(|_| part.has_gradient()) {
        let node = match newton {
            true => first[i],
            false => graph.product(1.0, [(l, 1), (first[i], 1)]),
        };
        list.push((format!("dF/d{}", name(i)), node));
    }
    for i in (0..parameters.len()).filter(|_| part.has_hessian()) {
        for j in (i..parameters.len()).filter(|j| part.has_entry(i, *j)) {
            let node = match newton {
                true => jet.second.get(&pair(parameters[i], parameters[j])).copied().unwrap_or(zero),
                false => graph.product(1.0, [(q, 1), (first[i], 1), (first[j], 1)]),
            };
            list.push((format!("d2F/d{}d{}", name(i), name(j)), node));
        }
    }
    list
}
