//! Gauss–Newton's features: pixel values that every derivative of the residual combines with coefficients known per
//! row, r_u = Σ c_ut φ_t. So F_u = Σ c_ut Σ L φ_t and F_uv = Σ c_us c_vt Σ Q φ_s φ_t for any r: one target at four
//! points of a pixel has no more features than one at its centre.

use std::collections::{BTreeMap, BTreeSet};

use crate::derive::cuts::Finite;
use crate::derive::monomial::{Monomial, Polynomial, Splitter, factors, multiply};
use crate::graph::hyper::Order;
use crate::graph::jet::{Jet, jet};
use crate::graph::{Graph, Node, NodeId, Powers};
use crate::program::Level;

/// See the module's text.
#[derive(Clone, Debug, Default)]
pub(crate) struct Features {
    /// φ; the number itself for the constant 1.
    pub values: Vec<NodeId>,
    /// Per parameter: features and factors known per row.
    pub slopes: Vec<Vec<(usize, NodeId)>>,
}

/// Input of the chain rule.
pub(crate) struct Chain<'a> {
    /// The derivatives by the variables, of a residual or of a direction of several residuals.
    pub gradient: &'a Jet,
    /// The derivatives of the cuts.
    pub slopes: &'a BTreeMap<NodeId, Jet>,
    /// Cuts, values known per pass, parameters.
    pub variables: &'a BTreeSet<NodeId>,
    /// Values other than these are differentiated only where the residual depends on them.
    pub finite: &'a Finite,
}

/// A parameter's use of a pixel value: parameter index, row factors, a coefficient known per pass.
type Share = (usize, Powers, NodeId);
/// Pixel monomials with their shares.
type Columns = BTreeMap<Powers, Vec<Share>>;

/// Pixel values in a fixed proportion that have the same shares.
#[derive(Debug, Default)]
struct Group {
    /// Monomials with their multipliers: row factors, a number.
    parts: Vec<(Powers, Powers, f64)>,
    shares: Vec<Share>,
}

/// The features of a residual; `None` when the chain rule cannot pass through a variable.
pub(crate) fn features(graph: &mut Graph, chain: &Chain<'_>, parameters: &[NodeId]) -> Option<Features> {
    let mut gradient = gradient(graph, chain)?;
    let leaves: Vec<NodeId> = gradient.keys().copied().collect();
    // First by the values known per pass, if any: parameters share their features.
    if leaves.iter().any(|l| !parameters.contains(l)) {
        let columns = columns(gradient.values());
        gradient = BTreeMap::new();
        for (value, shares) in reduced(graph, &columns, leaves.len()) {
            for (l, row, coefficient) in shares {
                let monomial = Monomial { pixel: Powers::from_slice(&[(value, 1)]), row };
                gradient.entry(leaves[l]).or_default().add(graph, &Polynomial::of(monomial, coefficient));
            }
        }
        for inner in leaves.iter().rev().filter(|l| !parameters.contains(l)) {
            let Some(above) = gradient.remove(inner) else { continue };
            let own = jet(graph, *inner, chain.variables, Order::First);
            for (l, slope) in &own.first {
                let slope = Splitter::new(&BTreeSet::new()).whole(graph, *slope);
                let product = above.times(graph, &slope)?;
                gradient.entry(*l).or_default().add(graph, &product);
            }
        }
    }
    let gradient: Vec<Polynomial> = parameters.iter().map(|u| gradient.remove(u).unwrap_or_default()).collect();
    let mut features = Features { values: Vec::new(), slopes: vec![Vec::new(); parameters.len()] };
    for (value, shares) in reduced(graph, &columns(&gradient), parameters.len()) {
        for (u, row, coefficient) in shares {
            let factor = graph.product(1.0, row.into_iter().chain([(coefficient, 1)]));
            features.slopes[u].push((features.values.len(), factor));
        }
        features.values.push(value);
    }
    (!graph.overflowed()).then_some(features)
}

fn columns<'a>(gradient: impl IntoIterator<Item = &'a Polynomial>) -> Columns {
    let mut columns = Columns::new();
    for (u, polynomial) in gradient.into_iter().enumerate() {
        for (monomial, coefficient) in polynomial.terms() {
            columns.entry(monomial.pixel.clone()).or_default().push((u, monomial.row.clone(), *coefficient));
        }
    }
    columns
}

/// Combines the columns into few values, with their shares.
fn reduced(graph: &mut Graph, columns: &Columns, parameters: usize) -> Vec<(NodeId, Vec<Share>)> {
    let whole = values_of_their_own(graph, columns, parameters);
    let taken = |is_whole: bool| -> Columns {
        let kept = |shares: &Vec<Share>| -> Vec<Share> {
            shares.iter().filter(|(u, ..)| whole.contains(u) == is_whole).cloned().collect()
        };
        columns.iter().map(|(pixel, shares)| (pixel.clone(), kept(shares))).filter(|(_, s)| !s.is_empty()).collect()
    };
    let mut list: Vec<(NodeId, Vec<Share>)> =
        groups(graph, &taken(false)).into_iter().map(|group| (group.value(graph), group.shares)).collect();
    let mut own: BTreeMap<usize, Vec<(NodeId, f64)>> = BTreeMap::new();
    for group in groups(graph, &taken(true)) {
        let value = group.value(graph);
        let mut factors: BTreeMap<usize, Vec<(NodeId, f64)>> = BTreeMap::new();
        for (u, row, coefficient) in group.shares {
            let factor = graph.product(1.0, row.into_iter().chain([(coefficient, 1)]));
            factors.entry(u).or_default().push((factor, 1.0));
        }
        for (u, factors) in factors {
            let factor = graph.sum(0.0, factors);
            own.entry(u).or_default().push((graph.mul(factor, value), 1.0));
        }
    }
    for (u, terms) in own {
        let one = graph.number(1.0);
        list.push((graph.sum(0.0, terms), vec![(u, Powers::new(), one)]));
    }
    list
}

/// The residual's derivatives by values known per pass: the chain rule from the residual down, collecting the terms
/// above each variable once.
fn gradient(graph: &mut Graph, chain: &Chain<'_>) -> Option<BTreeMap<NodeId, Polynomial>> {
    let nothing = BTreeSet::new();
    let mut splitter = Splitter::new(&nothing);
    let is_cut = |l: &NodeId| chain.slopes.contains_key(l);
    let mut adjoints: BTreeMap<NodeId, Vec<(NodeId, f64)>> = BTreeMap::new();
    let mut gradient: BTreeMap<NodeId, Polynomial> = BTreeMap::new();
    for (l, slope) in &chain.gradient.first {
        if is_cut(l) {
            adjoints.entry(*l).or_default().push((*slope, 1.0));
        } else {
            gradient.insert(*l, splitter.whole(graph, *slope));
        }
    }
    while let Some((cut, terms)) = adjoints.pop_last() {
        let mut adjoint = graph.sum(0.0, terms);
        graph.set_opaque(adjoint);
        let guard = match chain.finite.finite.contains(&cut) {
            true => None,
            false => Some(guard(graph, adjoint, GUARD)?),
        };
        let mut above = splitter.whole(graph, adjoint);
        let (monomial, coefficient) = above.terms()[0].clone();
        if monomial.pixel.len() > 1 && chain.slopes[&cut].first.len() > 1 {
            // Multiplied once for all slopes.
            let pixel = graph.product(1.0, monomial.pixel);
            graph.set_opaque(pixel);
            above = Polynomial::of(
                Monomial { pixel: Powers::from_slice(&[(pixel, 1)]), row: monomial.row.clone() },
                coefficient,
            );
            adjoint = graph.product(1.0, monomial.row.into_iter().chain([(coefficient, 1), (pixel, 1)]));
        }
        for (l, slope) in &chain.slopes[&cut].first {
            let product = match guard {
                Some(guard) => guarded(graph, chain.finite, guard, &above, *slope),
                None => graph.mul(adjoint, *slope),
            };
            if is_cut(l) {
                adjoints.entry(*l).or_default().push((product, 1.0));
                continue;
            }
            let expanded = match guard {
                Some(_) => None,
                None => {
                    let slope = splitter.expand(graph, *slope);
                    above.times(graph, &slope)
                }
            };
            let product = expanded.unwrap_or_else(|| splitter.whole(graph, product));
            gradient.entry(*l).or_default().add(graph, &product);
        }
    }
    (!graph.overflowed()).then_some(gradient)
}

/// Search depth for a condition.
const GUARD: u32 = 6;

/// A condition outside of which a value is zero.
fn guard(graph: &mut Graph, value: NodeId, depth: u32) -> Option<NodeId> {
    let depth = depth.checked_sub(1)?;
    match graph.node(value).clone() {
        Node::Select(condition, _, other) if graph.value_of(other) == Some(0.0) => Some(condition),
        Node::Select(condition, other, _) if graph.value_of(other) == Some(0.0) => Some(graph.not(condition)),
        Node::Product(factors) => factors.iter().find_map(|(n, e)| if *e > 0 { guard(graph, *n, depth) } else { None }),
        Node::Sum(constant, terms) if constant.get() == 0.0 => {
            let mut any: Option<NodeId> = None;
            for (n, _) in terms.iter() {
                let guard = guard(graph, *n, depth)?;
                any = Some(any.map_or(guard, |any| if any == guard { any } else { graph.or(any, guard) }));
            }
            any
        }
        _ => None,
    }
}

/// adjoint · slope where the guard holds, 0 elsewhere, where the slope may be anything.
fn guarded(graph: &mut Graph, finite: &Finite, guard: NodeId, adjoint: &Polynomial, slope: NodeId) -> NodeId {
    let zero = graph.number(0.0);
    let (monomial, coefficient) = &adjoint.terms()[0];
    let chosen = |(n, e): &(NodeId, i32)| match graph.node(*n) {
        Node::Select(condition, value, other) if *condition == guard && *other == zero && *e == 1 => Some((*n, *value)),
        _ => None,
    };
    let inner = monomial.pixel.iter().find_map(chosen);
    let outside = monomial.row.iter().copied().chain([(*coefficient, 1)]);
    let (outside, inside): (Powers, Powers) = match inner {
        Some((select, value)) => (
            outside.chain(monomial.pixel.iter().copied().filter(|(n, _)| *n != select)).collect(),
            Powers::from_slice(&[(value, 1)]),
        ),
        None => (outside.collect(), monomial.pixel.clone()),
    };
    let product = graph.product(1.0, inside.into_iter().chain([(slope, 1)]));
    // Finite factors that are known earlier leave the branch.
    let (number, factors) = factors(graph, product);
    let is_kept = |(n, e): &(NodeId, i32)| graph.level(*n) < Level::Pixel && finite.has_power(graph, *n, *e);
    let (kept, left): (Powers, Powers) = factors.into_iter().partition(is_kept);
    let product = graph.product(1.0, left);
    let product = graph.select(guard, product, zero);
    graph.product(number, outside.into_iter().chain(kept).chain([(product, 1)]))
}

/// The parameters whose derivatives become features themselves, because that takes fewer features than their parts.
fn values_of_their_own(graph: &mut Graph, columns: &Columns, parameters: usize) -> BTreeSet<usize> {
    let without = |whole: &BTreeSet<usize>| -> Columns {
        let kept = |shares: &Vec<Share>| shares.iter().filter(|(u, ..)| !whole.contains(u)).cloned().collect();
        let left = columns.iter().map(|(pixel, shares)| (pixel.clone(), kept(shares)));
        left.filter(|(_, shares): &(_, Vec<Share>)| !shares.is_empty()).collect()
    };
    let mut whole = BTreeSet::new();
    let mut left = groups(graph, columns);
    // Single parameters that keep parts of others from being the same.
    while left.len() + whole.len() > parameters && !graph.overflowed() {
        let mut best = None;
        for u in (0..parameters).filter(|u| !whole.contains(u)) {
            if graph.overflowed() {
                break;
            }
            let mut more = whole.clone();
            more.insert(u);
            let fewer = groups(graph, &without(&more));
            if fewer.len() + 1 < best.as_ref().map_or(left.len(), |(_, groups): &(_, Vec<Group>)| groups.len() + 1) {
                best = Some((u, fewer));
            }
        }
        let Some((u, fewer)) = best else { break };
        whole.insert(u);
        left = fewer;
    }
    // Groups of parameters that share more parts than they have members.
    while let Some(group) = left.pop() {
        let mut members: BTreeSet<usize> = group.shares.iter().map(|(u, ..)| *u).collect();
        let mut parts = 1;
        while let Some(i) = left.iter().position(|group| group.shares.iter().any(|(u, ..)| members.contains(u))) {
            members.extend(left.swap_remove(i).shares.iter().map(|(u, ..)| *u));
            parts += 1;
        }
        if members.len() < parts {
            whole.extend(members);
        }
    }
    whole
}

/// Groups columns that differ by row factors and numbers only.
fn groups(graph: &mut Graph, columns: &Columns) -> Vec<Group> {
    let mut groups: BTreeMap<Vec<Share>, Group> = BTreeMap::new();
    for (pixel, shares) in columns {
        graph.charge(4 * shares.len());
        let mut common = shares[0].1.clone();
        for (_, row, _) in shares {
            let least = |(n, e): &(NodeId, i32)| row.iter().find(|(m, _)| m == n).map_or(0, |(_, f)| *e.min(f));
            common = common.iter().map(|(n, e)| (*n, least(&(*n, *e)))).filter(|(_, e)| *e > 0).collect();
        }
        let first = number_of(graph, shares[0].2);
        let is_exact = |c: f64| (c / first).mul_add(first, -c) == 0.0;
        let number = match shares.iter().all(|(_, _, c)| is_exact(number_of(graph, *c))) {
            true => first,
            false => 1.0,
        };
        let rest = |(u, row, c): &Share, graph: &mut Graph| {
            let power = |n: &NodeId| common.iter().find(|(m, _)| m == n).map_or(0, |(_, e)| *e);
            let row = row.iter().map(|(n, e)| (*n, e - power(n))).filter(|(_, e)| *e != 0).collect();
            let old = number_of(graph, *c);
            let body = match graph.node(*c).clone() {
                Node::Number(_) => graph.number(old / number),
                Node::Sum(_, terms) if old != 1.0 => graph.scale(old / number, terms[0].0),
                _ => graph.scale(1.0 / number, *c),
            };
            (*u, row, body)
        };
        let key: Vec<Share> = shares.iter().map(|share| rest(share, graph)).collect();
        let group = groups.entry(key).or_default();
        group.parts.push((pixel.clone(), common, number));
    }
    let mut list = Vec::with_capacity(groups.len());
    for (key, mut group) in groups {
        let (_, common, number) = group.parts[0].clone();
        // Common factors of all parts leave the loop.
        let is_common = group.parts.iter().all(|(_, row, _)| *row == common);
        let is_scaled = group.parts.iter().all(|(.., n)| (n / number).mul_add(number, -n) == 0.0);
        let (row, number) = (if is_common { common } else { Powers::new() }, if is_scaled { number } else { 1.0 });
        for part in &mut group.parts {
            part.2 /= number;
            if is_common {
                part.1 = Powers::new();
            }
        }
        let share = |(u, own, c): Share| (u, multiply(&own, &row), graph.scale(number, c));
        group.shares = key.into_iter().map(share).collect();
        list.push(group);
    }
    list
}

/// The numeric factor of a coefficient.
fn number_of(graph: &Graph, coefficient: NodeId) -> f64 {
    match graph.node(coefficient) {
        Node::Number(bits) => bits.get(),
        Node::Sum(constant, terms) if terms.len() == 1 && constant.get() == 0.0 => terms[0].1.get(),
        _ => 1.0,
    }
}

impl Group {
    fn value(&self, graph: &mut Graph) -> NodeId {
        let mut terms = Vec::with_capacity(self.parts.len());
        for (pixel, row, number) in &self.parts {
            terms.push((graph.product(1.0, row.iter().chain(pixel).copied()), *number));
        }
        graph.sum(0.0, terms)
    }
}
