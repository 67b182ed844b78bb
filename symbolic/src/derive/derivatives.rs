//! The derivatives of F as differentiation writes them: nothing is factored, multiplied out or taken apart.
//!
//! What comes in: a model, a subset of its parameters, and which [`Part`] is wanted. What goes out: an expression for each,
//! to be shown, counted and compared with; [`Model::objective`] is what is fast.

use std::collections::BTreeSet;

use crate::derive::expressions::Expressions;
use crate::derive::jet::{jet, pair};
use crate::derive::terms::values;
use crate::derive::whole_model::WholeModel;
use crate::language::graph::{Graph, NodeId};
use crate::language::model::{Method, Model};
use crate::program::{Input, ParameterId};
use crate::proof::claim::{Claim, Part};
use crate::proof::hyper::Order;
use crate::proof::subject::PixelValue;
use isophote_syntax::diagnostic::Diagnostics;

/// Derivatives of one pixel's F, F itself left out.
#[derive(Clone, Debug)]
pub struct Derivatives {
    graph: Graph,
    entries: Vec<(String, NodeId)>,
}

impl Derivatives {
    /// What they are made of.
    pub fn expressions(&self) -> Expressions<'_> {
        Expressions::of(&self.graph)
    }
    /// `dF/dbx`, …, then the upper Hessian row by row.
    pub fn entries(&self) -> &[(String, NodeId)] {
        &self.entries
    }
}

impl Model {
    /// Gradient, Hessian or both as they are written down; the domain is not looked at.
    ///
    /// # Errors
    /// Derivatives that grow past a limit.
    pub fn derivatives(&self, subset: &[ParameterId], method: Method, part: Part) -> Result<Derivatives, Diagnostics> {
        let mut graph = self.formulas.graph.drawing_on(self.budget());
        let entries = entries(&mut graph, self, subset, method, part);
        match graph.overflowed() {
            true => Err(WholeModel::of(self).growth(subset.len())),
            false => Ok(Derivatives { graph, entries }),
        }
    }
}

/// The derivatives of F, named, as differentiation writes them.
fn entries(
    graph: &mut Graph,
    model: &Model,
    subset: &[ParameterId],
    method: Method,
    part: Part,
) -> Vec<(String, NodeId)> {
    let newton = method == Method::Newton;
    let order = if newton { Order::Second } else { Order::First };
    let PixelValue { residual, variance, .. } = values(graph, model, Claim::Derivatives { newton, part })[0];
    let parameters: Vec<NodeId> = subset.iter().map(|p| graph.input(Input::Parameter(*p))).collect();
    let variables: BTreeSet<NodeId> = parameters.iter().copied().collect();
    let name = |i: usize| &model.parameters[subset[i].index()].name;
    let zero = graph.number(0.0);
    // Newton: F itself; else L r_u and Q r_u r_v.
    let (total, own) = model.formulas.shape().jet(graph, order, &[residual], variance);
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
