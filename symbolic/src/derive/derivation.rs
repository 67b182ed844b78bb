//! Writes the sums of an objective down for one choice of cuts (shared nodes such as s, treated as variables): forms
//! (the costly pixel values L_l and Q_lm) and, for every output, the factors l_u, l_u m_v, l_uv of the forms. A layout
//! then decides how the forms are split into [`FactoredSums`], and what their loop costs.

use std::collections::{BTreeMap, BTreeSet};

use rustc_hash::{FxHashMap, FxHashSet};
use smallvec::{SmallVec, smallvec};

use crate::derive::absorb::{Absorbed, Scaling, absorb, absorb_numbers};
use crate::derive::cuts::{Finite, frontier};
use crate::derive::features::{Chain, Features, features};
use crate::derive::joint::{self, Direction, Weights, counted, directions, full};
use crate::derive::monomial::{Polynomial, Splitter, terms, whole_output};
use crate::derive::rank::{Combination, dependent};
use crate::graph::hyper::Order;
use crate::graph::jet::{Jet, compose, jet, pair, totals};
use crate::graph::{Graph, Mark, Node, NodeId, Powers};
use crate::likelihood::claim::Part;
use crate::likelihood::shape::Shape;
use crate::likelihood::terms::PixelValue;
use crate::program::Weight;
use crate::schedule;
use crate::schedule::Lowering;
use crate::schedule::sums::{FactoredSums, Output, Term};
use isophote_syntax::limits::LIMITS;

/// The function to differentiate, shared by all choices.
#[derive(Clone)]
pub(crate) struct Differentiand<'a> {
    /// The nodes of the free parameters, and their names.
    pub parameters: &'a [NodeId],
    pub names: &'a [String],
    /// The pixel values in F.
    pub values: Vec<PixelValue>,
    /// The variance is taken at the parameters themselves.
    pub is_opening: bool,
    /// A pixel mask reads the entry parameters, as the variance does.
    pub is_masked: bool,
    /// F as a function of the values.
    pub shape: Shape,
    /// Order of the derivatives of r and σ²: second for the full Hessian, first for JᵀWJ.
    pub order: Order,
    /// The derivatives to sum.
    pub part: Part,
}

impl Differentiand<'_> {
    pub fn residuals(&self) -> Vec<NodeId> {
        self.values.iter().map(|value| value.residual).collect()
    }
}

/// A choice of variables for the chain rule.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Debug, Default)]
pub(crate) struct Cuts {
    pub nodes: BTreeSet<NodeId>,
    pub scaling: Scaling,
    /// Polynomials in this value are collected first.
    pub collect: Option<NodeId>,
}

/// A choice of how forms become accumulators.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Layout {
    /// Factors are multiplied out into monomials of pixel and row values.
    pub expand: bool,
    /// Forms that are split term by term.
    pub split: BTreeSet<usize>,
}

/// An output: Σ form · factor.
#[derive(Clone, Debug)]
struct Entry {
    /// The parameters that F is differentiated by.
    by: SmallVec<[usize; 2]>,
    uses: Vec<(usize, NodeId)>,
}

/// Names of F with ln σ², and of r²/σ², beside F.
const FULL: [&str; 2] = ["full", "chi2"];

/// Name of a derivative.
fn name_of(names: &[String], by: &[usize]) -> String {
    match by {
        [i, j] => format!("d2F/d{}d{}", names[*i], names[*j]),
        _ => by.iter().map(|i| format!("dF/d{}", names[*i])).collect(),
    }
}

/// The derivatives over cuts; see the module's text.
#[derive(Clone, Debug)]
pub(crate) struct Derivation {
    pub graph: Graph,
    pub forms: Vec<(String, NodeId)>,
    /// Some factor could change sides, see [`absorb`].
    pub is_unifiable: bool,
    value: NodeId,
    /// F with ln σ², and r²/σ², with the variance at the parameters themselves.
    own: Option<[NodeId; 2]>,
    counted: Vec<Output>,
    /// Names of the parameters.
    names: Vec<String>,
    entries: Vec<Entry>,
    /// Factors as polynomials, expanded (`true`) or whole.
    factors: FxHashMap<(NodeId, bool), Polynomial>,
}

/// The basis of first derivatives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum By {
    /// Few pixel values that all parameters share.
    Features,
    /// The chain rule's own terms.
    Variables,
}

impl Derivation {
    /// `None` when the graph overflows.
    pub fn new(mut graph: Graph, differentiand: &Differentiand<'_>, cuts: &Cuts, by: By) -> Option<Derivation> {
        let mut variables: BTreeSet<NodeId> = cuts.nodes.iter().chain(differentiand.parameters).copied().collect();
        let parameters = differentiand.parameters;
        let mut tops = differentiand.residuals();
        let finite = (differentiand.order == Order::First && by == By::Features)
            .then(|| Finite::below(&graph, &tops, parameters));
        if let Some(finite) = &finite {
            variables.extend(frontier(&graph, &tops, parameters, finite));
        }
        // The top variables: r, and σ² where it is differentiated.
        let variances = differentiand.values.iter().filter_map(|value| value.variance);
        tops.extend(variances.filter(|_| differentiand.order == Order::Second));
        let mut jets: Vec<Jet> =
            tops.iter().map(|top| jet(&mut graph, *top, &variables, differentiand.order)).collect();
        let mut directions = finite.iter().flat_map(|_| directions(&mut graph, &jets)).collect::<Vec<Direction>>();
        if finite.is_some() {
            jets = directions.iter().map(|direction| direction.gradient.clone()).collect();
        }
        let mut slopes: BTreeMap<NodeId, Jet> = BTreeMap::new();
        if let Some(finite) = &finite {
            slopes.extend(cuts.nodes.iter().map(|cut| (*cut, jet(&mut graph, *cut, &variables, Order::First))));
            // Slopes that are not expanded are absorbed as the residual is, so that both share values.
            jets.extend(slopes.iter().map(|(cut, slopes)| {
                let is_kept = |l: &NodeId| cuts.nodes.contains(l) || !finite.finite.contains(cut);
                let kept = slopes.first.iter().filter(|(l, _)| is_kept(l)).map(|(l, slope)| (*l, *slope));
                Jet { first: kept.collect(), ..Jet::default() }
            }));
        }
        // A variance stays as it is where a mask shares its values.
        let others = |value: &PixelValue| [value.variance.filter(|_| !differentiand.is_masked), value.own_variance];
        let rewritten: Vec<NodeId> = differentiand.values.iter().flat_map(others).flatten().collect();
        let parts = directions.iter().flat_map(|direction| &direction.parts).map(|(_, part)| *part);
        let all: Vec<NodeId> = rewritten.iter().copied().chain(parts).collect();
        let Absorbed { tops, mut jets, others: all, is_unifiable } =
            absorb(&mut graph, &tops, &jets, &all, cuts.scaling);
        let mut all = all.into_iter();
        let mut values = differentiand.values.clone();
        for (value, top) in values.iter_mut().zip(&tops) {
            value.residual = *top;
            let variance = value.variance.as_mut().filter(|_| !differentiand.is_masked);
            variance.into_iter().chain(value.own_variance.as_mut()).zip(&mut all).for_each(|(old, new)| *old = new);
        }
        directions
            .iter_mut()
            .flat_map(|direction| &mut direction.parts)
            .zip(all)
            .for_each(|((_, old), new)| *old = new);
        let shape = differentiand.shape;
        let own = values[0].own_variance.map(|_| full(&mut graph, shape, &values, |value| value.own_variance));
        let (value, top) = joint::top(&mut graph, shape, differentiand.order, &values);
        let mut derivation = Derivation {
            forms: Vec::new(),
            is_unifiable,
            value,
            own,
            counted: counted(&mut graph, &values),
            names: differentiand.names.to_vec(),
            entries: Vec::new(),
            factors: FxHashMap::default(),
            graph,
        };
        if let Some(finite) = &finite {
            slopes
                .values_mut()
                .zip(jets.split_off(directions.len()))
                .for_each(|(all, kept)| all.first.extend(kept.first));
            directions.iter_mut().zip(jets).for_each(|(direction, jet)| direction.gradient = jet);
            let residuals = &tops[..values.len()];
            let weights = Weights::of(&mut derivation.graph, &top, residuals, &directions)?;
            let slopes = &slopes;
            let of = |direction: &Direction| {
                let chain = Chain { gradient: &direction.gradient, slopes, variables: &variables, finite };
                features(&mut derivation.graph, &chain, differentiand.parameters)
            };
            let features = directions.iter().map(of).collect::<Option<Vec<Features>>>()?;
            return derivation.over_features(differentiand, &weights, features);
        }
        derivation.over_variables(differentiand, cuts, (&top, &tops, &jets))
    }

    /// Completes the derivation by the chain rule's terms: derivatives of F by `tops`, and of these by the variables.
    fn over_variables(
        mut self,
        differentiand: &Differentiand<'_>,
        cuts: &Cuts,
        (top, tops, jets): (&Jet, &[NodeId], &[Jet]),
    ) -> Option<Derivation> {
        let graph = &mut self.graph;
        let of: FxHashMap<NodeId, &Jet> = tops.iter().copied().zip(jets).collect();
        let mut form = compose(graph, top, &|t| of[&t]);
        if graph.overflowed() {
            return None;
        }
        if !differentiand.part.has_hessian() {
            form.second.clear();
        }
        let ascending: Vec<NodeId> = cuts.nodes.iter().copied().collect();
        let totals = totals(graph, &ascending, differentiand.parameters, differentiand.order);
        if graph.overflowed() {
            return None;
        }
        let mut roots: Vec<NodeId> = form.first.values().chain(form.second.values()).copied().collect();
        absorb_numbers(graph, &mut roots);
        form.first.values_mut().chain(form.second.values_mut()).zip(&roots).for_each(|(old, new)| *old = *new);
        let mut forms: Vec<(String, NodeId)> = Vec::new();
        let mut place = |node: NodeId, name: &str| {
            forms.push((name.into(), node));
            forms.len() - 1
        };
        let first: Vec<_> = form.first.iter().map(|(l, n)| (*l, place(*n, "L"))).collect();
        let quadratic: FxHashMap<_, _> = form.second.iter().map(|(k, n)| (*k, place(*n, "Q"))).collect();
        let mut entries = Vec::new();
        for (i, u) in differentiand.parameters.iter().enumerate().filter(|_| differentiand.part.has_gradient()) {
            let uses = first.iter().filter_map(|(l, form)| Some((*form, *totals[l].first.get(u)?))).collect();
            entries.push(Entry { by: smallvec![i], uses });
        }
        // Per parameter the variables that depend on it, with l_u.
        let mut variables: Vec<(NodeId, &Jet)> = totals.iter().map(|(l, jet)| (*l, jet)).collect();
        variables.sort_unstable_by_key(|(l, _)| *l);
        let slopes = |u: &NodeId| -> Vec<(NodeId, NodeId)> {
            variables.iter().filter_map(|(l, jet)| Some((*l, *jet.first.get(u)?))).collect()
        };
        let slopes: Vec<_> = differentiand.parameters.iter().map(slopes).collect();
        for (i, u) in differentiand.parameters.iter().enumerate().filter(|_| differentiand.part.has_hessian()) {
            let row = differentiand.parameters.iter().enumerate().skip(i);
            for (j, v) in row.filter(|(j, _)| differentiand.part.has_entry(i, *j)) {
                graph.charge(slopes[i].len() * slopes[j].len());
                let mut products: BTreeMap<usize, SmallVec<[(NodeId, f64); 4]>> = BTreeMap::new();
                for (l, l_u) in &slopes[i] {
                    for (m, m_v) in &slopes[j] {
                        if let Some(form) = quadratic.get(&pair(*l, *m)) {
                            products.entry(*form).or_default().push((graph.mul(*l_u, *m_v), 1.0));
                        }
                    }
                }
                let mut uses = Vec::new();
                for (form, products) in products {
                    let factor = graph.sum(0.0, products);
                    if graph.value_of(factor) != Some(0.0) {
                        uses.push((form, factor));
                    }
                }
                for (l, form) in first.iter().filter(|_| differentiand.order == Order::Second) {
                    uses.extend(totals[l].second.get(&pair(*u, *v)).map(|l_uv| (*form, *l_uv)));
                }
                entries.push(Entry { by: smallvec![i, j], uses });
                if graph.overflowed() {
                    return None;
                }
            }
        }
        Some(Derivation { forms, entries, ..self })
    }

    /// Completes the derivation from first derivatives alone: F_u = Σ L φ_u and F_uv = Σ Q φ_u φ_v, with the features
    /// of each direction.
    fn over_features(
        mut self,
        differentiand: &Differentiand<'_>,
        weights: &Weights,
        features: Vec<Features>,
    ) -> Option<Derivation> {
        let graph = &mut self.graph;
        // Features with their directions, and the parameters' slopes over them.
        let (mut values, mut slopes) = (Vec::new(), vec![Vec::new(); differentiand.parameters.len()]);
        for (direction, own) in features.into_iter().enumerate() {
            let first = values.len();
            values.extend(own.values.into_iter().map(|value| (direction, value)));
            for (all, own) in slopes.iter_mut().zip(own.slopes) {
                all.extend(own.into_iter().map(|(value, factor)| (first + value, factor)));
            }
        }
        let mut forms: Vec<(String, NodeId)> = Vec::new();
        let mut entries = Vec::new();
        if differentiand.part.has_gradient() {
            let form = |(direction, value): &(usize, NodeId)| graph.mul(weights.slopes[*direction], *value);
            forms.extend(values.iter().map(form).map(|form| ("L".into(), form)));
            entries.extend(slopes.iter().enumerate().map(|(i, uses)| Entry { by: smallvec![i], uses: uses.clone() }));
        }
        let mut products: FxHashMap<(usize, usize), usize> = FxHashMap::default();
        for (i, own) in slopes.iter().enumerate().filter(|_| differentiand.part.has_hessian()) {
            for (j, other) in slopes.iter().enumerate().skip(i).filter(|(j, _)| differentiand.part.has_entry(i, *j)) {
                let mut uses = Vec::new();
                for (s, c) in own {
                    for (t, d) in other {
                        let (first, last) = ((*s).min(*t), (*s).max(*t));
                        let [(a, first_value), (b, last_value)] = [values[first], values[last]];
                        let Some(weight) = weights.curvatures.get(&(a, b)) else { continue };
                        let form = *products.entry((first, last)).or_insert_with(|| {
                            let factors = [(*weight, 1), (first_value, 1), (last_value, 1)];
                            forms.push(("Q".into(), graph.product(1.0, factors)));
                            forms.len() - 1
                        });
                        uses.push((form, graph.mul(*c, *d)));
                    }
                }
                entries.push(Entry { by: smallvec![i, j], uses });
                if graph.overflowed() {
                    return None;
                }
            }
        }
        Some(Derivation { forms, entries, ..self })
    }

    /// The outputs after the derivatives, unsplit.
    pub fn closing(&mut self) -> Vec<Output> {
        let named = self.own.into_iter().flat_map(|own| FULL.into_iter().zip(own));
        named.map(|(name, node)| whole_output(&mut self.graph, name, node)).chain(self.counted.drain(..)).collect()
    }

    /// Undoes a trial back to `mark`, and keeps the factors that `layout` needs.
    pub fn roll_back(&mut self, mark: Mark, layout: &Layout) {
        self.graph.roll_back(mark);
        self.factors.retain(|(_, is_expanded), _| *is_expanded == layout.expand);
    }

    /// True when a form is a sum, so that it can be taken apart.
    pub fn has_terms(&self, form: usize) -> bool {
        matches!(self.graph.node(self.forms[form].1), Node::Sum(_, terms) if terms.len() > 1)
    }

    /// The forms as polynomials in atoms, which are pixel values computed unchanged; converts each distinct factor as
    /// well.
    fn parts(&mut self, layout: &Layout) -> Vec<Polynomial> {
        let mut atoms = BTreeSet::new();
        let mut parts = Vec::with_capacity(self.forms.len());
        for (i, (_, node)) in self.forms.iter().enumerate() {
            let pieces = match layout.split.contains(&i) {
                true => terms(&mut self.graph, *node),
                // The content and the factors that all terms share are taken out of the sum.
                false => vec![self.graph.product(1.0, [(*node, 1)])],
            };
            parts.push(Splitter::form(&mut self.graph, &pieces, &mut atoms));
        }
        let mut splitter = Splitter::new(&atoms);
        for (_, factor) in self.entries.iter().flat_map(|e| &e.uses) {
            let key = (*factor, layout.expand);
            if !self.factors.contains_key(&key) {
                let polynomial = match layout.expand {
                    true => splitter.expand(&mut self.graph, *factor),
                    false => splitter.whole(&mut self.graph, *factor),
                };
                self.factors.insert(key, polynomial);
            }
        }
        parts
    }

    /// Estimated cost of a layout's pixel loop without F, if it is below `below`; counts terms that cancel between
    /// forms.
    pub fn pixel_weight(&mut self, layout: &Layout, lowering: Lowering, below: Weight) -> Option<Weight> {
        let parts = self.parts(layout);
        let (mut seen, mut distinct) = (FxHashSet::default(), FxHashSet::default());
        let (mut pixels, mut nodes) = (Vec::new(), Vec::new());
        let graph = &mut self.graph;
        for (form, factor) in self.entries.iter().flat_map(|e| &e.uses) {
            if graph.overflowed() {
                return None;
            }
            if seen.insert((*form, *factor)) {
                parts[*form].pixels_with(&self.factors[&(*factor, layout.expand)], &mut pixels)?;
                graph.charge(4 * pixels.len());
                let found = pixels.drain(..).filter(|monomial: &Powers| !monomial.is_empty());
                let found = found.map(|monomial| graph.product(1.0, monomial));
                nodes.extend(found.filter(|node| distinct.insert(*node)));
            }
        }
        schedule::pixel_weight(graph, &nodes, lowering, below).filter(|_| !graph.overflowed())
    }

    /// One sum per output, nothing split; the first is F.
    pub fn unfactored(&mut self) -> Option<FactoredSums> {
        let graph = &mut self.graph;
        let mut outputs = vec![whole_output(graph, "F", self.value)];
        for Entry { by, uses } in &self.entries {
            let terms: Vec<_> =
                uses.iter().map(|(form, factor)| (graph.mul(self.forms[*form].1, *factor), 1.0)).collect();
            let node = graph.sum(0.0, terms);
            outputs.push(whole_output(graph, &name_of(&self.names, by), node));
        }
        (!graph.overflowed()).then_some(FactoredSums { outputs, shift: None })
    }

    /// The sums of a layout; the first output is F.
    pub fn sums(&mut self, layout: &Layout) -> Option<FactoredSums> {
        let parts = self.parts(layout);
        let mut outputs = vec![whole_output(&mut self.graph, "F", self.value)];
        for Entry { by, uses } in &self.entries {
            let mut total = Polynomial::default();
            for (form, factor) in uses {
                let part = parts[*form].times(&mut self.graph, &self.factors[&(*factor, layout.expand)])?;
                total.add(&mut self.graph, &part);
            }
            outputs.push(Output { name: name_of(&self.names, by), terms: total.into_terms(&mut self.graph) });
        }
        (!self.graph.overflowed()).then_some(FactoredSums { outputs, shift: None })
    }
}

/// Maximum number of values evaluated in the search for combinations; larger sums are not searched.
const RANK: usize = LIMITS.work / 16;

/// The sums without those that are combinations of others; F's own stay.
pub(crate) fn reduced(graph: &mut Graph, sums: FactoredSums) -> FactoredSums {
    let own =
        sums.outputs.first().map(|f| f.terms.iter().filter_map(|t| t.pixel).collect::<Vec<_>>()).unwrap_or_default();
    let mut pixels: Vec<NodeId> = sums.pixels().into_iter().filter(|pixel| !own.contains(pixel)).collect();
    pixels.sort_by_key(|pixel| (schedule::degree(graph, *pixel), *pixel));
    let looked_at = graph.reachable(&pixels).len() * pixels.len();
    if looked_at > RANK {
        return sums;
    }
    graph.charge(looked_at);
    let combinations: FxHashMap<NodeId, Combination> = dependent(graph, &pixels).into_iter().collect();
    if combinations.is_empty() {
        return sums;
    }
    let mut replaced = |term: Term| match term.pixel.and_then(|pixel| combinations.get(&pixel)) {
        None => vec![term],
        Some(combination) => combination
            .iter()
            .map(|(pixel, c)| Term { coefficient: graph.scale(*c, term.coefficient), pixel: *pixel, ..term.clone() })
            .collect(),
    };
    let outputs = sums.outputs.into_iter();
    let outputs = outputs.map(|o| Output { terms: o.terms.into_iter().flat_map(&mut replaced).collect(), ..o });
    FactoredSums { outputs: outputs.collect(), shift: None }
}
