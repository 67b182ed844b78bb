//! Searches the cuts and the layout of the forms that make the cheapest pixel loop. The number of choices is
//! exponential; the search is greedy from several seeds, and bounded by a count of derivations and their work.

use std::collections::BTreeSet;

use crate::derive::absorb::{Scaling, gather};
use crate::derive::cuts::cut_classes;
use crate::derive::derivation::{By, Cuts, Derivation, Differentiand, Layout, reduced};
use crate::derive::polynomials::collected;
use crate::derive::square::completed;
use crate::graph::hyper::Order;
use crate::graph::{Graph, Node, NodeId};
use crate::likelihood::terms::PixelValue;
use crate::program::Weight;
use crate::schedule::Lowering;
use crate::schedule::pixel_weight;
use crate::schedule::sums::FactoredSums;
use isophote_syntax::limits::LIMITS;

/// Maximum number of derivations.
const DERIVATIONS: usize = 32;
/// Work (see [`Graph::work`]) after which the search stops: that of all derivations, and that of all layouts.
const WORK: usize = LIMITS.work / 8;

struct Found {
    cuts: Cuts,
    layout: Layout,
    derivation: Derivation,
    weight: Weight,
}

struct Search<'a> {
    graph: &'a Graph,
    differentiand: &'a Differentiand<'a>,
    best: Option<Found>,
    tried: BTreeSet<Cuts>,
    /// Those tried whose derivation leaves a factor that could change sides.
    unifiable: BTreeSet<Cuts>,
    derivations: usize,
    work: usize,
}

/// The cheapest derivation found; `None` when none stays within the limits. `most` bounds how far sums are rewritten.
pub(crate) fn fewest_flops(
    graph: &Graph,
    differentiand: &Differentiand<'_>,
    most: Scaling,
) -> Option<(Derivation, FactoredSums)> {
    let classes = cut_classes(graph, &differentiand.residuals(), differentiand.parameters, differentiand.order);
    let mut search = Search {
        graph,
        differentiand,
        best: None,
        tried: BTreeSet::new(),
        unifiable: BTreeSet::new(),
        derivations: 0,
        work: 0,
    };
    // Seeds: all candidates, none if there is a choice, and each class alone.
    search.attempt(Cuts { nodes: classes.iter().flatten().copied().collect(), ..Cuts::default() });
    if classes.len() > 1 {
        search.attempt(Cuts::default());
    }
    for class in &classes {
        search.attempt(Cuts { nodes: class.clone(), ..Cuts::default() });
    }
    // Adds or removes one class while that pays. Without any, every pair of parameters has a form of its own.
    let pairs = differentiand.parameters.len() * (differentiand.parameters.len() + 3) / 2;
    while classes.len() > 1 || search.best.as_ref()?.derivation.forms.len() >= pairs {
        let before = search.best.as_ref()?.cuts.nodes.clone();
        for class in classes.iter().rev() {
            let nodes = &search.best.as_ref()?.cuts.nodes;
            let nodes = if class.is_subset(nodes) { nodes - class } else { nodes | class };
            search.attempt(Cuts { nodes, ..Cuts::default() });
        }
        if search.best.as_ref()?.cuts.nodes == before || classes.len() < 2 {
            break;
        }
    }
    // Only values alone in their class are collected: the others of a class would remain.
    let best = &search.best.as_ref()?.cuts.nodes;
    let alone = classes.into_iter().filter(|class| class.len() == 1 && class.is_subset(best));
    let collected: Vec<Cuts> =
        alone.map(|nodes| Cuts { collect: nodes.first().copied(), nodes, ..Cuts::default() }).collect();
    collected.iter().for_each(|cuts| search.attempt(cuts.clone()));
    search.layouts();
    let plain = search.best.take()?;
    if most == Scaling::Unified {
        let tried = [plain.cuts.clone()].into_iter().chain(collected);
        let unifiable: Vec<Cuts> = tried.filter(|cuts| search.unifiable.contains(cuts)).collect();
        unifiable.into_iter().for_each(|cuts| search.attempt(Cuts { scaling: most, ..cuts }));
        search.layouts();
    }
    let mut best = match search.best {
        Some(unified) if unified.weight < plain.weight => unified,
        _ => plain,
    };
    let sums = best.derivation.sums(&best.layout)?;
    let sums = reduced(&mut best.derivation.graph, sums);
    // Tried on a copy: a rejected rewrite leaves nothing behind, not even a full graph.
    let mut trial = best.derivation.graph.copied();
    let squared = completed(&mut trial, &sums);
    let mut of = |sums: &FactoredSums| {
        let pixels = sums.summed(&mut trial);
        pixel_weight(&mut trial, &pixels, LOWERING, Weight::MOST)
    };
    let squared = squared.filter(|squared| of(squared) < of(&sums));
    match squared {
        Some(squared) if !trial.overflowed() => {
            best.derivation.graph = trial;
            Some((best.derivation, squared))
        }
        _ => Some((best.derivation, sums)),
    }
}

impl Search<'_> {
    /// Derives with these cuts within the budget, and keeps the result when it is better.
    fn attempt(&mut self, cuts: Cuts) {
        // To first order the first attempt, all cuts, is mostly the best.
        let most = if self.differentiand.order == Order::First { WORK / 4 } else { WORK };
        let is_spent = self.work >= most || self.graph.budget().is_spent();
        if self.derivations >= DERIVATIONS || is_spent || !self.tried.insert(cuts.clone()) {
            return;
        }
        let mut graph = self.graph.copied();
        let mut differentiand = self.differentiand.clone();
        if let Some(variable) = cuts.collect {
            let Differentiand { values, is_opening, .. } = &mut differentiand;
            let mut is_new = false;
            for PixelValue { residual, variance, own_variance, .. } in values {
                let before = *residual;
                let alike = own_variance.iter_mut().chain(variance.iter_mut().filter(|_| *is_opening));
                for node in std::iter::once(&mut *residual).chain(alike) {
                    *node = collected(&mut graph, *node, variable);
                    *node = gather(&mut graph, *node);
                    graph.set_opaque(*node);
                }
                is_new |= *residual != levelled(&mut graph, before);
            }
            if !is_new {
                return;
            }
        }
        self.derivations += 1;
        let layout = Layout { expand: true, split: BTreeSet::new() };
        let Some(mut derivation) = Derivation::new(graph, &differentiand, &cuts, By::Features) else {
            self.work = WORK;
            return;
        };
        let below = self.best.as_ref().map_or(Weight::MOST, |best| best.weight);
        let weight = derivation.pixel_weight(&layout, LOWERING, below);
        self.work += derivation.graph.work() - self.graph.work();
        if derivation.is_unifiable {
            self.unifiable.insert(cuts.clone());
        }
        if let Some(weight) = weight {
            self.best = Some(Found { cuts, layout, derivation, weight });
        }
    }

    /// Improves the layout of the best: factors whole, forms split one by one.
    fn layouts(&mut self) {
        let Some(mut best) = self.best.take() else { return };
        let mut work = 0;
        if best.cuts.scaling == Scaling::AsWritten {
            let whole = Layout { expand: false, ..best.layout.clone() };
            work += try_layout(&mut best, whole);
        }
        for form in 0..best.derivation.forms.len() {
            if work >= WORK || best.derivation.graph.budget().is_spent() {
                break;
            }
            if !best.derivation.has_terms(form) {
                continue;
            }
            let mut layout = best.layout.clone();
            layout.split.insert(form);
            work += try_layout(&mut best, layout);
        }
        self.best = Some(best);
    }
}

/// Flattens the sums in a sum's terms into it.
fn levelled(graph: &mut Graph, node: NodeId) -> NodeId {
    let Node::Sum(constant, terms) = graph.node(node).clone() else { return node };
    let (mut constant, mut list) = (constant.get(), Vec::new());
    for (n, c) in terms.iter() {
        match graph.node(*n) {
            Node::Sum(inner, inside) => {
                constant += c.get() * inner.get();
                list.extend(inside.iter().map(|(m, k)| (*m, c.get() * k.get())));
            }
            _ => list.push((*n, c.get())),
        }
    }
    graph.sum(constant, list)
}

/// Takes the layout if it is better; returns the work of the attempt.
fn try_layout(best: &mut Found, layout: Layout) -> usize {
    let (before, mark) = (best.derivation.graph.work(), best.derivation.graph.mark());
    match best.derivation.pixel_weight(&layout, LOWERING, best.weight) {
        Some(weight) => (best.layout, best.weight) = (layout, weight),
        None => best.derivation.roll_back(mark, &best.layout),
    }
    best.derivation.graph.work() - before
}

const LOWERING: Lowering = Lowering { fma: true, drop_saturated: false };
