//! `Objective`: F, its gradient and its Hessian for a subset of the parameters, as sums of pixel values with coefficients
//! that leave the pixel loop.
//!
//! Per pixel F = r²/σ² (σ² = 1 without `noise`), r = observed − intensity. With forms over cuts l, m (shared nodes such as
//! s, treated as variables): F_u = Σ L_l l_u and F_uv = Σ Q_lm l_u l_v + Σ L_l l_uv. L and Q are the costly pixel values;
//! l_u and l_uv are expanded into pixel and row monomials, so that a few accumulators, each L or Q times a monomial, serve
//! every entry. Gauss–Newton keeps Σ Q_lm l_u l_v with Q from ∂²F/∂r² alone.

use std::collections::{BTreeMap, BTreeSet};

use crate::absorb::absorb;
use crate::cuts::cut_candidates;
use crate::diagnostic::{Diagnostic, Diagnostics, Span};
use crate::graph::{Graph, Node, NodeId};
use crate::jet::{Jet, jet, pair, totals};
use crate::limits::LIMITS;
use crate::model::{Lowering, Method, Model};
use crate::monomial::{Polynomial, Splitter};
use crate::program::{Cost, Input, ParameterId, Program};
use crate::schedule::{self, Output, Sums};

/// What a value objective sums.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum ValueKind {
    /// Σ r²/σ², σ² held at the entry parameters: what a pass' steps are compared by. One output, F.
    Entry,
    /// Σ r²/σ² + ln σ² at the parameters themselves, for the report. Two outputs: F, and Σ r²/σ².
    Full,
}

/// What is to be summed; see the module's text.
#[derive(Clone, Debug)]
pub struct Objective {
    graph: Graph,
    sums: Sums,
    /// Outputs that are F itself: left out of the cost.
    values: usize,
    subset: Vec<ParameterId>,
    names: crate::program::Names,
    domain: Option<NodeId>,
    origin: Origin,
    pub(crate) forms: Vec<(String, NodeId)>,
}

/// Removal trials of the search over cuts and splits; each derives and schedules once.
const TRIALS: usize = 24;

impl Objective {
    /// The free parameters.
    pub fn subset(&self) -> &[ParameterId] {
        &self.subset
    }

    /// The loop nest.
    pub fn program(&self, lowering: Lowering) -> Result<Program, Diagnostics> {
        let mut graph = self.graph.clone();
        let program = schedule::sums(&mut graph, &self.sums, self.domain, lowering, self.names.clone());
        self.origin.checked(&graph, program)
    }

    /// What the loop nest costs, F itself left out (the convention of the flops table).
    pub fn cost(&self, lowering: Lowering) -> Result<Cost, Diagnostics> {
        let mut graph = self.graph.clone();
        let mut sums = self.sums.clone();
        if sums.outputs.len() > self.values {
            sums.outputs.drain(..self.values);
        }
        let program = schedule::sums(&mut graph, &sums, self.domain, lowering, self.names.clone());
        Ok(self.origin.checked(&graph, program)?.cost())
    }

    /// Lines `name = formula`: the forms over cuts, and what each output is made of.
    pub(crate) fn graph(&self) -> &Graph {
        &self.graph
    }
    pub(crate) fn sums(&self) -> &Sums {
        &self.sums
    }
    pub(crate) fn names(&self) -> &crate::program::Names {
        &self.names
    }

    pub(crate) fn value(model: &Model, kind: ValueKind) -> Result<Objective, Diagnostics> {
        let mut graph = model.formulas.graph.clone();
        let residual = graph.sub(model.formulas.observed, model.formulas.intensity);
        let square = graph.product(1.0, [(residual, 2)]);
        let variance = variance(&mut graph, model, kind == ValueKind::Entry);
        let chi = variance.map_or(square, |v| graph.product(1.0, [(square, 1), (v, -1)]));
        let one = |graph: &mut Graph, name: &str, node: NodeId| Output {
            name: name.to_string(),
            terms: Splitter::new(&BTreeSet::new()).whole(graph, node).into_terms(graph),
        };
        let chi_square = one(&mut graph, "chi2", chi);
        let outputs = match (kind, variance) {
            (ValueKind::Entry, _) => vec![chi_square],
            (ValueKind::Full, None) => vec![Output { name: "F".into(), ..chi_square.clone() }, chi_square],
            (ValueKind::Full, Some(v)) => {
                let log = graph.call1(crate::function::Function1::Log, v);
                let total = graph.add2(chi, log);
                vec![one(&mut graph, "F", total), chi_square]
            }
        };
        let names = model.names(outputs.iter().map(|o| o.name.clone()).collect());
        let domain = entry_domain(&mut graph, model);
        let sums = Sums { outputs };
        Ok(Objective {
            graph,
            sums,
            values: 0,
            subset: Vec::new(),
            names,
            domain,
            origin: Origin::of(model),
            forms: Vec::new(),
        })
    }

    pub(crate) fn derive(model: &Model, subset: &[ParameterId], method: Method) -> Result<Objective, Diagnostics> {
        let mut base = model.formulas.graph.clone();
        let residual = base.sub(model.formulas.observed, model.formulas.intensity);
        base.set_opaque(residual);
        let held = method != Method::Newton;
        let variance = variance(&mut base, model, held);
        let parameters: Vec<NodeId> = subset.iter().map(|p| base.input(Input::Parameter(*p))).collect();
        let candidates = cut_candidates(&base, residual, &parameters);
        let lowering = Lowering { fma: true, drop_saturated: false };
        let attempt = |cuts: &BTreeSet<NodeId>, split: &BTreeSet<usize>, expand: bool| -> Option<(u32, Objective)> {
            let plan = Plan { model, subset, method, parameters: &parameters, residual, variance, cuts, split, expand };
            let objective = plan.build(base.clone())?;
            let cost = objective.cost(lowering).ok()?;
            let calls: u32 = cost.calls.values().sum();
            Some((cost.flops_per_pixel + 20 * calls, objective))
        };
        let (mut cuts, mut split) = (candidates.clone(), BTreeSet::new());
        let mut best = attempt(&cuts, &split, true);
        if let Some(plain) = attempt(&cuts, &split, false)
            && best.as_ref().is_none_or(|(cost, _)| plain.0 < *cost)
        {
            best = Some(plain);
        }
        let mut trials = TRIALS;
        for cut in candidates.iter().rev() {
            let mut fewer = cuts.clone();
            fewer.remove(cut);
            trials -= usize::from(trials > 0);
            if let (Some((cost, _)), true) = (&best, trials > 0)
                && let Some(trial) = attempt(&fewer, &split, true)
                && trial.0 < *cost
            {
                (best, cuts) = (Some(trial), fewer);
            }
        }
        let forms = best.as_ref().map_or(0, |(_, o)| o.forms.len());
        for form in 0..forms {
            let mut more = split.clone();
            more.insert(form);
            trials -= usize::from(trials > 0);
            if let (Some((cost, _)), true) = (&best, trials > 0)
                && let Some(trial) = attempt(&cuts, &more, true)
                && trial.0 < *cost
            {
                (best, split) = (Some(trial), more);
            }
        }
        let limit = || {
            let message = format!(
                "the derivatives for {} parameters grow past {} distinct operations or {} instructions",
                subset.len(),
                LIMITS.nodes,
                LIMITS.instructions
            );
            Origin::of(model).fault(message)
        };
        best.map(|(_, objective)| objective).ok_or_else(limit)
    }
}

/// Where the model's intensity stands, for faults that concern the model as a whole.
#[derive(Clone, Debug)]
struct Origin {
    text: std::sync::Arc<str>,
    span: Span,
}

impl Origin {
    fn of(model: &Model) -> Origin {
        let span = model.formulas.graph.span(model.formulas.intensity).unwrap_or_default();
        Origin { text: model.text.clone(), span }
    }

    fn fault(&self, message: String) -> Diagnostics {
        let help = "free fewer parameters per stage, or give shared parts a definition";
        vec![Diagnostic::error(&self.text, "limit", "model.intensity", self.span, message).help(help)]
    }

    fn checked(&self, graph: &Graph, program: Program) -> Result<Program, Diagnostics> {
        let count = program.instructions().len();
        if graph.overflowed() || count > LIMITS.instructions {
            let most = LIMITS.instructions;
            return Err(self.fault(format!("the loop takes {count} instructions; at most {most} are compiled")));
        }
        Ok(program)
    }
}

/// The program that adds the intensity, at shifted coordinates, to a plane.
pub(crate) fn rendering(model: &Model, lowering: Lowering) -> Result<Program, Diagnostics> {
    let mut graph = model.formulas.graph.clone();
    let mut shifted = |graph: &mut Graph, node: &Node| match node {
        Node::Coordinate(c) => {
            let shift = graph.input(Input::Shift(*c));
            let coordinate = graph.coordinate(*c);
            Some(graph.add2(coordinate, shift))
        }
        _ => None,
    };
    let intensity = graph.substitute(model.formulas.intensity, &mut shifted);
    let program = schedule::plane(&mut graph, intensity, lowering, model.names(vec!["intensity".into()]));
    Origin::of(model).checked(&graph, program)
}

/// The pixel's variance; `held` reads it at the entry parameters.
fn variance(graph: &mut Graph, model: &Model, held: bool) -> Option<NodeId> {
    let node = model.formulas.noise?;
    let node = if held { at_entry(graph, node) } else { node };
    graph.set_opaque(node);
    Some(node)
}

fn at_entry(graph: &mut Graph, node: NodeId) -> NodeId {
    let mut entry = |graph: &mut Graph, node: &Node| match node {
        Node::Input(Input::Parameter(p)) => Some(graph.input(Input::Entry(*p))),
        _ => None,
    };
    graph.substitute(node, &mut entry)
}

fn entry_domain(graph: &mut Graph, model: &Model) -> Option<NodeId> {
    model.formulas.domain.map(|d| at_entry(graph, d))
}

/// One way to write the sums down.
struct Plan<'a> {
    model: &'a Model,
    subset: &'a [ParameterId],
    method: Method,
    parameters: &'a [NodeId],
    residual: NodeId,
    variance: Option<NodeId>,
    cuts: &'a BTreeSet<NodeId>,
    split: &'a BTreeSet<usize>,
    expand: bool,
}

impl Plan<'_> {
    fn build(&self, mut graph: Graph) -> Option<Objective> {
        let second = self.method == Method::Newton;
        let variables: BTreeSet<NodeId> = self.cuts.iter().chain(self.parameters).copied().collect();
        // The top variables: r, and σ² where it is differentiated.
        let mut tops = vec![self.residual];
        tops.extend(self.variance.filter(|_| second));
        let jets: Vec<Jet> = tops.iter().map(|top| jet(&mut graph, *top, &variables, second)).collect();
        let (tops, jets, variance) = absorb(&mut graph, &tops, &jets, self.variance);
        let (value, form) = self.top_form(&mut graph, &tops, &jets, variance)?;
        let cuts: Vec<NodeId> = self.cuts.iter().copied().collect();
        let totals = totals(&mut graph, &cuts, self.parameters, second);
        if graph.overflowed() {
            return None;
        }
        let mut forms: Vec<(String, NodeId)> = Vec::new();
        let mut atoms = BTreeSet::new();
        let mut place = |node: NodeId, name: String| {
            forms.push((name, node));
            forms.len() - 1
        };
        let first: Vec<_> = form.first.iter().map(|(l, n)| (*l, place(*n, "L".into()))).collect();
        let quadratic: Vec<_> = form.second.iter().map(|(k, n)| (*k, place(*n, "Q".into()))).collect();
        let parts: Vec<Polynomial> = forms
            .iter()
            .enumerate()
            .map(|(i, (_, node))| Splitter::form(&mut graph, *node, self.split.contains(&i), &mut atoms))
            .collect();
        let splitter = Splitter::new(&atoms);
        let n = self.parameters.len();
        let mut outputs =
            vec![Output { name: "F".into(), terms: splitter.whole(&mut graph, value).into_terms(&mut graph) }];
        let names: Vec<&str> = self.subset.iter().map(|p| self.model.parameters[p.index()].name.as_str()).collect();
        let expand = |graph: &mut Graph, node: NodeId| {
            if self.expand { splitter.expand(graph, node) } else { splitter.whole(graph, node) }
        };
        let mut entries: Vec<(String, Polynomial)> = Vec::with_capacity(n + n * (n + 1) / 2);
        for (i, u) in self.parameters.iter().enumerate() {
            let mut total = Polynomial::default();
            for (l, part) in &first {
                if let Some(l_u) = totals[l].first.get(u) {
                    let l_u = expand(&mut graph, *l_u);
                    let part = parts[*part].times(&mut graph, &l_u)?;
                    total.add(&mut graph, &part);
                }
            }
            entries.push((format!("dF/d{}", names[i]), total));
        }
        for (i, u) in self.parameters.iter().enumerate() {
            for (j, v) in self.parameters.iter().enumerate().skip(i) {
                let mut total = Polynomial::default();
                for ((l, m), part) in &quadratic {
                    let factor = cross(&mut graph, &totals[l], &totals[m], *u, *v, l == m);
                    if graph.value_of(factor) != Some(0.0) {
                        let factor = expand(&mut graph, factor);
                        let part = parts[*part].times(&mut graph, &factor)?;
                        total.add(&mut graph, &part);
                    }
                }
                for (l, part) in first.iter().filter(|_| second) {
                    if let Some(l_uv) = totals[l].second.get(&pair(*u, *v)) {
                        let l_uv = expand(&mut graph, *l_uv);
                        let part = parts[*part].times(&mut graph, &l_uv)?;
                        total.add(&mut graph, &part);
                    }
                }
                entries.push((format!("d2F/d{}d{}", names[i], names[j]), total));
            }
        }
        for (name, polynomial) in entries {
            outputs.push(Output { name, terms: polynomial.into_terms(&mut graph) });
        }
        let domain = entry_domain(&mut graph, self.model);
        if graph.overflowed() {
            return None;
        }
        Some(Objective {
            names: self.model.names(outputs.iter().map(|o| o.name.clone()).collect()),
            sums: Sums { outputs },
            values: 1,
            subset: self.subset.to_vec(),
            domain,
            origin: Origin::of(self.model),
            forms,
            graph,
        })
    }

    /// F and its form over cuts and parameters: the top variables eliminated.
    fn top_form(
        &self,
        graph: &mut Graph,
        tops: &[NodeId],
        jets: &[Jet],
        variance: Option<NodeId>,
    ) -> Option<(NodeId, Jet)> {
        let newton = self.method == Method::Newton;
        let mut factors = vec![(tops[0], 2)];
        factors.extend(variance.map(|v| (v, -1)));
        let square = graph.product(1.0, factors);
        let value = match (variance, newton) {
            (Some(v), true) => {
                let log = graph.call1(crate::function::Function1::Log, v);
                graph.add2(square, log)
            }
            _ => square,
        };
        let top = jet(graph, value, &tops.iter().copied().collect(), true);
        let index = |n: &NodeId| tops.iter().position(|t| t == n);
        let mut first: BTreeMap<NodeId, Vec<(NodeId, f64)>> = BTreeMap::new();
        let mut second: BTreeMap<(NodeId, NodeId), Vec<(NodeId, f64)>> = BTreeMap::new();
        for (t, outer) in &top.first {
            for (l, inner) in &jets[index(t)?].first {
                first.entry(*l).or_default().push((graph.mul(*outer, *inner), 1.0));
            }
            for (key, inner) in jets[index(t)?].second.iter().filter(|_| newton) {
                second.entry(*key).or_default().push((graph.mul(*outer, *inner), 1.0));
            }
        }
        for ((s, t), outer) in &top.second {
            let (a, b) = (&jets[index(s)?], &jets[index(t)?]);
            for (l, la) in &a.first {
                for (m, mb) in &b.first {
                    if s == t && l > m {
                        continue;
                    }
                    let weight = if s != t && l == m { 2.0 } else { 1.0 };
                    let node = graph.product(1.0, [(*outer, 1), (*la, 1), (*mb, 1)]);
                    second.entry(pair(*l, *m)).or_default().push((node, weight));
                }
            }
        }
        let mut form = Jet::default();
        for (l, terms) in first {
            form.first.insert(l, graph.sum(0.0, terms));
        }
        for (key, terms) in second {
            form.second.insert(key, graph.sum(0.0, terms));
        }
        (!graph.overflowed()).then_some((value, form))
    }
}

/// l_u m_v + m_u l_v, or l_u l_v when l is m.
fn cross(graph: &mut Graph, l: &Jet, m: &Jet, u: NodeId, v: NodeId, same: bool) -> NodeId {
    let mut terms = Vec::new();
    let mut add = |graph: &mut Graph, a: Option<&NodeId>, b: Option<&NodeId>| {
        if let (Some(a), Some(b)) = (a, b) {
            terms.push((graph.mul(*a, *b), 1.0));
        }
    };
    add(graph, l.first.get(&u), m.first.get(&v));
    if !same {
        add(graph, m.first.get(&u), l.first.get(&v));
    }
    graph.sum(0.0, terms)
}
