//! First and second partial derivatives of an expression with respect to chosen nodes.
//!
//! A jet is the truncated Taylor form n ≈ Σ first[l] dl + ½ Σ second[l, m] dl dm over *variables*: parameters, and
//! shared nodes ("cuts") that are treated as independent. [`totals`] applies the chain rule over cuts; nothing is
//! expanded through a shared nonlinear node. A branch not taken contributes an exact zero, never 0 · NaN.

use std::collections::{BTreeMap, BTreeSet};

use isophote_elementary::{Function1, Function2};
use rustc_hash::{FxBuildHasher, FxHashMap};
use smallvec::SmallVec;

use crate::graph::hyper::Order;
use crate::graph::{Graph, Node, NodeId, operands};
use crate::program::Comparison;

/// First and second partial derivatives; absent entries are zero. Keys of `second` are ordered pairs.
#[derive(Clone, Debug, Default)]
pub(crate) struct Jet {
    pub first: BTreeMap<NodeId, NodeId>,
    pub second: BTreeMap<(NodeId, NodeId), NodeId>,
}

pub(crate) fn pair(a: NodeId, b: NodeId) -> (NodeId, NodeId) {
    if a <= b { (a, b) } else { (b, a) }
}

/// Units of work of an entry besides its node.
const ENTRY: usize = 2;

/// Weighted entries, mostly few.
type Terms = SmallVec<[(NodeId, f64); 3]>;

/// Sums of weighted entries, collected before they become nodes.
struct Form {
    order: Order,
    first: BTreeMap<NodeId, Terms>,
    second: BTreeMap<(NodeId, NodeId), Terms>,
}

impl Form {
    fn to(order: Order) -> Form {
        Form { order, first: BTreeMap::new(), second: BTreeMap::new() }
    }

    /// Adds derivative · jet.
    fn add(&mut self, graph: &mut Graph, derivative: NodeId, jet: &Jet) {
        graph.charge(ENTRY * (jet.first.len() + jet.second.len()));
        for (variable, entry) in &jet.first {
            let node = graph.mul(derivative, *entry);
            self.first.entry(*variable).or_default().push((node, 1.0));
        }
        for (key, entry) in &jet.second {
            let node = graph.mul(derivative, *entry);
            self.second.entry(*key).or_default().push((node, 1.0));
        }
    }

    /// Adds ∂²n/∂a∂b · da db for the two jets' first derivatives; `square` when a and b are the same operand.
    fn add_product(&mut self, graph: &mut Graph, derivative: NodeId, a: &Jet, b: &Jet, square: bool) {
        if self.order == Order::First {
            return;
        }
        for (l, la) in &a.first {
            if graph.overflowed() {
                return;
            }
            graph.charge(ENTRY * b.first.len());
            for (m, mb) in &b.first {
                // second[l, m] of a product of first orders: a_l b_m + a_m b_l; for a square each ordered pair once.
                if square && l > m {
                    continue;
                }
                let node = graph.product(1.0, [(derivative, 1), (*la, 1), (*mb, 1)]);
                let weight = if !square && l == m { 2.0 } else { 1.0 };
                self.second.entry(pair(*l, *m)).or_default().push((node, weight));
            }
        }
    }

    fn finish(self, graph: &mut Graph) -> Jet {
        let mut jet = Jet::default();
        for (variable, terms) in self.first {
            let node = graph.sum(0.0, terms);
            if graph.value_of(node) != Some(0.0) {
                jet.first.insert(variable, node);
            }
        }
        for (key, terms) in self.second {
            let node = graph.sum(0.0, terms);
            if graph.value_of(node) != Some(0.0) {
                jet.second.insert(key, node);
            }
        }
        jet
    }
}

/// The jet of `root` over `variables`; it stops at the first variable on each path. `root` itself may be a variable.
pub(crate) fn jet(graph: &mut Graph, root: NodeId, variables: &BTreeSet<NodeId>, order: Order) -> Jet {
    let segment = segment(graph, root, variables);
    let mut jets: FxHashMap<NodeId, Jet> = FxHashMap::with_capacity_and_hasher(segment.len(), FxBuildHasher);
    graph.charge(ENTRY * segment.len());
    for id in segment {
        let jet = if id != root && variables.contains(&id) {
            let one = graph.number(1.0);
            Jet { first: BTreeMap::from([(id, one)]), second: BTreeMap::new() }
        } else {
            let span = graph.span(id);
            graph.set_span(span);
            step(graph, id, &jets, order)
        };
        if graph.overflowed() {
            return Jet::default();
        }
        jets.insert(id, jet);
    }
    jets.remove(&root).unwrap_or_default()
}

/// Nodes from `root` down to the variables, operands first.
fn segment(graph: &Graph, root: NodeId, variables: &BTreeSet<NodeId>) -> BTreeSet<NodeId> {
    let mut seen = BTreeSet::from([root]);
    let mut stack = vec![root];
    while let Some(id) = stack.pop() {
        if id != root && variables.contains(&id) {
            continue;
        }
        stack.extend(operands(graph.node(id)).filter(|n| seen.insert(*n)));
    }
    seen
}

fn step(graph: &mut Graph, id: NodeId, jets: &FxHashMap<NodeId, Jet>, order: Order) -> Jet {
    if operands(graph.node(id)).all(|n| jets[&n].first.is_empty()) {
        return Jet::default();
    }
    let node = graph.node(id).clone();
    let mut form = Form::to(order);
    match &node {
        Node::Sum(_, terms) => {
            for (n, coefficient) in terms.iter() {
                let coefficient = graph.number(coefficient.get());
                form.add(graph, coefficient, &jets[n]);
            }
        }
        Node::Product(factors) => product(graph, factors, jets, &mut form),
        Node::Select(condition, a, b) => return select(graph, *condition, &jets[a], &jets[b]),
        Node::Abs(a) => {
            let zero = graph.number(0.0);
            let negative = graph.compare(Comparison::Lt, *a, zero);
            let (minus, plus) = (graph.number(-1.0), graph.number(1.0));
            let sign = graph.select(negative, minus, plus);
            form.add(graph, sign, &jets[a]);
        }
        Node::Sqrt(a) => {
            let d1 = graph.product(0.5, [(id, -1)]);
            let d2 = graph.product(-0.25, [(*a, -1), (id, -1)]);
            unary(graph, &jets[a], d1, d2, &mut form);
        }
        Node::Call1(function, a) => {
            let (d1, d2) = derivatives(graph, *function, *a, id);
            unary(graph, &jets[a], d1, d2, &mut form);
        }
        Node::Call2(function, a, b) => binary(graph, *function, *a, *b, id, jets, &mut form),
        _ => {}
    }
    form.finish(graph)
}

fn unary(graph: &mut Graph, jet: &Jet, d1: NodeId, d2: NodeId, form: &mut Form) {
    form.add(graph, d1, jet);
    form.add_product(graph, d2, jet, jet, true);
}

fn product(graph: &mut Graph, factors: &[(NodeId, i32)], jets: &FxHashMap<NodeId, Jet>, form: &mut Form) {
    // ∂P/∂f = e f^(e−1) · rest, and the same once more for the second order.
    let lowered = |graph: &mut Graph, i: usize, j: usize| {
        let mut list = factors.to_vec();
        let mut coefficient = f64::from(list[i].1);
        list[i].1 -= 1;
        if j < list.len() {
            coefficient *= f64::from(list[j].1);
            list[j].1 -= 1;
        }
        graph.product(coefficient, list)
    };
    for (i, (a, _)) in factors.iter().enumerate() {
        if graph.overflowed() || jets[a].first.is_empty() {
            continue;
        }
        let d1 = lowered(graph, i, usize::MAX);
        form.add(graph, d1, &jets[a]);
        let others = if form.order == Order::First { &[][..] } else { &factors[i..] };
        for (j, (b, _)) in others.iter().enumerate().map(|(j, factor)| (i + j, factor)) {
            if !jets[b].first.is_empty() && !graph.overflowed() {
                let d2 = lowered(graph, i, j);
                form.add_product(graph, d2, &jets[a], &jets[b], i == j);
            }
        }
    }
}

fn select(graph: &mut Graph, condition: NodeId, a: &Jet, b: &Jet) -> Jet {
    let zero = graph.number(0.0);
    let mut jet = Jet::default();
    for variable in a.first.keys().chain(b.first.keys()) {
        let at = |j: &Jet| j.first.get(variable).copied().unwrap_or(zero);
        jet.first.insert(*variable, graph.select(condition, at(a), at(b)));
    }
    for key in a.second.keys().chain(b.second.keys()) {
        let at = |j: &Jet| j.second.get(key).copied().unwrap_or(zero);
        jet.second.insert(*key, graph.select(condition, at(a), at(b)));
    }
    jet
}

/// φ'(a) and φ''(a); `value` is φ(a).
fn derivatives(graph: &mut Graph, function: Function1, a: NodeId, value: NodeId) -> (NodeId, NodeId) {
    let one_minus_square = |graph: &mut Graph, x: NodeId| {
        let square = graph.product(1.0, [(x, 2)]);
        graph.sum(1.0, [(square, -1.0)])
    };
    match function {
        Function1::Exp => (value, value),
        Function1::Log | Function1::LogVariance => (graph.product(1.0, [(a, -1)]), graph.product(-1.0, [(a, -2)])),
        Function1::Sin => (graph.call1(Function1::Cos, a), graph.scale(-1.0, value)),
        Function1::Cos => {
            let sin = graph.call1(Function1::Sin, a);
            (graph.scale(-1.0, sin), graph.scale(-1.0, value))
        }
        Function1::Sinh => (graph.call1(Function1::Cosh, a), value),
        Function1::Cosh => {
            // sinh(x) as cosh(x) tanh(x), which is a number where cosh(x) is infinite.
            let tanh = graph.call1(Function1::Tanh, a);
            (graph.mul(value, tanh), value)
        }
        Function1::Tan => {
            let square = graph.product(1.0, [(value, 2)]);
            let d1 = graph.sum(1.0, [(square, 1.0)]);
            (d1, graph.product(2.0, [(value, 1), (d1, 1)]))
        }
        Function1::Tanh => {
            let d1 = one_minus_square(graph, value);
            (d1, graph.product(-2.0, [(value, 1), (d1, 1)]))
        }
        Function1::Asin | Function1::Acos => {
            let sign = if function == Function1::Asin { 1.0 } else { -1.0 };
            let rest = one_minus_square(graph, a);
            let root = graph.sqrt(rest);
            (graph.product(sign, [(root, -1)]), graph.product(sign, [(a, 1), (rest, -1), (root, -1)]))
        }
        Function1::Atan => {
            let square = graph.product(1.0, [(a, 2)]);
            let rest = graph.sum(1.0, [(square, 1.0)]);
            (graph.product(1.0, [(rest, -1)]), graph.product(-2.0, [(a, 1), (rest, -2)]))
        }
        Function1::Erf | Function1::Erfc => {
            let sign = if function == Function1::Erf { 1.0 } else { -1.0 };
            let square = graph.product(-1.0, [(a, 2)]);
            let bell = graph.call1(Function1::Exp, square);
            let d1 = graph.product(sign * std::f64::consts::FRAC_2_SQRT_PI, [(bell, 1)]);
            (d1, graph.product(-2.0, [(a, 1), (d1, 1)]))
        }
        Function1::BesselJ0 => {
            let (other, ratio) = (graph.call1(Function1::BesselJ1, a), graph.call1(Function1::BesselRatio1, a));
            (graph.scale(-1.0, other), graph.sub(ratio, value))
        }
        Function1::BesselJ1 => {
            let [other, ratio, next] = [Function1::BesselJ0, Function1::BesselRatio1, Function1::BesselRatio2]
                .map(|function| graph.call1(function, a));
            let bend = graph.mul(a, next);
            (graph.sub(other, ratio), graph.sub(bend, value))
        }
        Function1::BesselRatio1 | Function1::Sinc => {
            let is_bessel = function == Function1::BesselRatio1;
            let (next, n) = if is_bessel { (Function1::BesselRatio2, 3.0) } else { (Function1::SincRatio, 2.0) };
            let ratio = graph.call1(next, a);
            (graph.product(-1.0, [(a, 1), (ratio, 1)]), graph.sum(0.0, [(ratio, n), (value, -1.0)]))
        }
        // Only derivatives contain these; they are not differentiated further, and these slopes are undefined at 0.
        Function1::BesselRatio2 | Function1::SincRatio => {
            let is_bessel = function == Function1::BesselRatio2;
            let (lower, n) = if is_bessel { (Function1::BesselRatio1, 4.0) } else { (Function1::Sinc, 3.0) };
            let lower = graph.call1(lower, a);
            let next = graph.sum(0.0, [(value, n), (lower, -1.0)]);
            let bend = graph.product(n + 1.0, [(next, 1), (a, -2)]);
            (graph.product(-1.0, [(next, 1), (a, -1)]), graph.sub(bend, value))
        }
        Function1::Fraction => (graph.number(1.0), graph.number(0.0)),
        Function1::LogTail => {
            let hazard = graph.call1(Function1::Hazard, a);
            let excess = graph.sub(hazard, a);
            (graph.scale(-1.0, hazard), graph.product(-1.0, [(hazard, 1), (excess, 1)]))
        }
        Function1::Hazard => {
            let excess = graph.sub(value, a);
            let d1 = graph.product(1.0, [(value, 1), (excess, 1)]);
            let twice = graph.add2(value, excess);
            let product = graph.mul(d1, twice);
            (d1, graph.sub(product, value))
        }
    }
}

fn binary(
    graph: &mut Graph,
    function: Function2,
    a: NodeId,
    b: NodeId,
    value: NodeId,
    jets: &FxHashMap<NodeId, Jet>,
    form: &mut Form,
) {
    let (ja, jb) = (&jets[&a], &jets[&b]);
    match function {
        Function2::Atan2 => {
            // a is y, b is x; I = 1/(x² + y²), 0 at the origin: all derivatives count as 0 there.
            let (yy, xx) = (graph.product(1.0, [(a, 2)]), graph.product(1.0, [(b, 2)]));
            let square = graph.add2(xx, yy);
            let (zero, inverse) = (graph.number(0.0), graph.product(1.0, [(square, -1)]));
            let is_origin = graph.compare(Comparison::Eq, square, zero);
            let d = graph.select(is_origin, zero, inverse);
            let d1 = graph.product(1.0, [(b, 1), (d, 1)]);
            form.add(graph, d1, ja);
            let d1 = graph.product(-1.0, [(a, 1), (d, 1)]);
            form.add(graph, d1, jb);
            let mixed = graph.product(-2.0, [(a, 1), (b, 1), (d, 2)]);
            form.add_product(graph, mixed, ja, ja, true);
            let difference = graph.sub(yy, xx);
            let cross = graph.product(1.0, [(difference, 1), (d, 2)]);
            form.add_product(graph, cross, ja, jb, false);
            let mixed = graph.product(2.0, [(a, 1), (b, 1), (d, 2)]);
            form.add_product(graph, mixed, jb, jb, true);
        }
        Function2::Pow => {
            // By the base: b a^(b−1) and b (b−1) a^(b−2), from a^b by division; at a = 0 a^(b−1) is 1 for b = 1 and 0
            // for all larger b, and a^(b−2) likewise about 2. Where they do not exist they count as 0.
            let less1 = graph.sum(-1.0, [(b, 1.0)]);
            let zero = graph.number(0.0);
            let at_zero = graph.compare(Comparison::Eq, a, zero);
            let lowered = |graph: &mut Graph, power: NodeId, exponent: f64| {
                let divided = graph.product(1.0, [(power, 1), (a, -1)]);
                let there = match graph.value_of(b) {
                    Some(number) => graph.number(f64::from(u8::from(number == exponent))),
                    None => {
                        let (number, one) = (graph.number(exponent), graph.number(1.0));
                        let is_it = graph.compare(Comparison::Eq, b, number);
                        graph.select(is_it, one, zero)
                    }
                };
                graph.select(at_zero, there, divided)
            };
            let p1 = lowered(graph, value, 1.0);
            let d1 = graph.product(1.0, [(b, 1), (p1, 1)]);
            form.add(graph, d1, ja);
            let p2 = lowered(graph, p1, 2.0);
            let d2 = graph.product(1.0, [(b, 1), (less1, 1), (p2, 1)]);
            form.add_product(graph, d2, ja, ja, true);
            if !jb.first.is_empty() {
                // a^b log a tends to 0 with a.
                let log = graph.call1(Function1::Log, a);
                let log = graph.select(at_zero, zero, log);
                let d1 = graph.product(1.0, [(value, 1), (log, 1)]);
                form.add(graph, d1, jb);
                let d2 = graph.product(1.0, [(value, 1), (log, 2)]);
                form.add_product(graph, d2, jb, jb, true);
                let scaled = graph.product(1.0, [(b, 1), (log, 1)]);
                let inner = graph.sum(1.0, [(scaled, 1.0)]);
                let cross = graph.product(1.0, [(p1, 1), (inner, 1)]);
                form.add_product(graph, cross, ja, jb, false);
            }
        }
    }
}

/// The chain rule: `own` is a jet over variables, `inner` yields the jet of each.
pub(crate) fn compose<'a>(graph: &mut Graph, own: &Jet, inner: &dyn Fn(NodeId) -> &'a Jet) -> Jet {
    let mut form = Form::to(Order::Second);
    for (l, derivative) in &own.first {
        form.add(graph, *derivative, inner(*l));
    }
    for ((l, m), derivative) in &own.second {
        form.add_product(graph, *derivative, inner(*l), inner(*m), l == m);
    }
    form.finish(graph)
}

/// Total derivatives of cuts with respect to parameters, by the chain rule over lower cuts. `cuts` is ascending.
pub(crate) fn totals(
    graph: &mut Graph,
    cuts: &[NodeId],
    parameters: &[NodeId],
    order: Order,
) -> FxHashMap<NodeId, Jet> {
    let mut done: FxHashMap<NodeId, Jet> = FxHashMap::default();
    let one = graph.number(1.0);
    for parameter in parameters {
        done.insert(*parameter, Jet { first: BTreeMap::from([(*parameter, one)]), second: BTreeMap::new() });
    }
    let variables: BTreeSet<NodeId> = parameters.iter().chain(cuts).copied().collect();
    for cut in cuts {
        let own = jet(graph, *cut, &variables, order);
        let total = compose(graph, &own, &|l| &done[&l]);
        done.insert(*cut, total);
    }
    done
}
