//! Hash-consed expression graph: n-ary sums with numeric coefficients, products with integer exponents.
//!
//! Constructors keep a canonical form. Ids are dense; equal expressions have equal ids; an operand's id is smaller than
//! its user's. A span per node is the only link to its formula: the graph knows nothing of documents.
//!
//! [`jet`] differentiates nodes to nodes, [`hyper`] evaluates them with their derivatives as numbers.

pub(crate) mod budget;
pub(crate) mod expressions;
pub(crate) mod hyper;
pub(crate) mod jet;
pub(crate) mod random;
mod range;
pub(crate) mod signs;

use std::collections::BTreeSet;
use std::hash::BuildHasher;
use std::sync::Arc;

use hashbrown::HashTable;
use isophote_elementary::{Function1, Function2, Lookup, Tables};
use rustc_hash::{FxBuildHasher, FxHashMap};
use smallvec::SmallVec;

use crate::graph::budget::Budget;
use crate::program::{ChannelId, Comparison, CoordinateId, Input, Level, ParameterId, holds, id};
use isophote_syntax::diagnostic::Span;
use isophote_syntax::limits::LIMITS;

id!(/// A node of the graph.
    NodeId);

/// Factors with their exponents.
pub(crate) type Powers = SmallVec<[(NodeId, i32); 4]>;

/// A hashable number; never NaN from user text, −0 is stored as 0.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Bits(u64);

impl Bits {
    pub(crate) fn new(value: f64) -> Bits {
        Bits((value + 0.0).to_bits())
    }
    /// The number.
    pub fn get(self) -> f64 {
        f64::from_bits(self.0)
    }
}

/// An expression. Sums and products are built by the graph's own constructors only.
#[derive(Clone, PartialEq, Eq, Hash, Debug)]
#[allow(missing_docs)]
pub enum Node {
    Number(Bits),
    Input(Input),
    Coordinate(CoordinateId),
    Channel(ChannelId),
    /// constant + Σ coefficient · node; no coefficient is 0, at least one term.
    Sum(Bits, Arc<[(NodeId, Bits)]>),
    /// Π node^exponent; no exponent is 0; never a single factor with exponent 1.
    Product(Arc<[(NodeId, i32)]>),
    Sqrt(NodeId),
    Abs(NodeId),
    Call1(Function1, NodeId),
    Call2(Function2, NodeId, NodeId),
    /// A coefficient of a table's cell, constant within it.
    Gather(Lookup, NodeId, NodeId),
    Compare(Comparison, NodeId, NodeId),
    And(NodeId, NodeId),
    Or(NodeId, NodeId),
    Not(NodeId),
    Select(NodeId, NodeId, NodeId),
}

/// The arena. At the limit `overflowed` is set and no node is added any more.
#[derive(Clone, Debug, Default)]
pub(crate) struct Graph {
    nodes: Vec<Node>,
    traits: Vec<Traits>,
    spans: Vec<Option<Span>>,
    opaque: Vec<bool>,
    /// By node hash; entries keep as much of it as growing takes.
    index: HashTable<(u32, NodeId)>,
    span: Option<Span>,
    overflowed: bool,
    /// Units of work of this graph and of those it was cloned from.
    work: usize,
    budget: Budget,
    positive: BTreeSet<ParameterId>,
    pub tables: Tables,
    /// Scratch buffers of the sum and product constructors.
    terms: Vec<(NodeId, Bits)>,
    factors: Vec<(NodeId, i32)>,
}

/// Properties computed when a node is added.
#[derive(Clone, Copy, Debug)]
struct Traits {
    level: Level,
    /// See [`Graph::growth`].
    growth: u8,
    /// See [`Graph::may_lack_value`].
    may_lack_value: bool,
    /// Of sums, see [`content`]; else 1.
    content: f64,
}

/// Spare node capacity of a copy.
const ROOM: usize = 1024;

/// A snapshot for [`Graph::roll_back`].
#[derive(Clone, Copy)]
pub(crate) struct Mark {
    nodes: usize,
    overflowed: bool,
}

impl Graph {
    pub fn len(&self) -> usize {
        self.nodes.len()
    }
    pub fn node(&self, id: NodeId) -> &Node {
        &self.nodes[id.index()]
    }
    /// Level of the value in the loop nest: pass, row or pixel.
    pub fn level(&self, id: NodeId) -> Level {
        self.traits[id.index()].level
    }
    /// Approximate degree of growth or decay in coordinates and pixels: 255 for an exponential, 0 for a bounded value,
    /// such as a quotient of two that grow alike.
    pub fn growth(&self, id: NodeId) -> u8 {
        self.traits[id.index()].growth
    }
    /// The value may be NaN for numeric inputs: it depends on a pixel, a quotient, a root or a function.
    pub fn may_lack_value(&self, id: NodeId) -> bool {
        self.traits[id.index()].may_lack_value
    }
    pub fn span(&self, id: NodeId) -> Option<Span> {
        self.spans[id.index()]
    }
    pub fn overflowed(&self) -> bool {
        self.overflowed
    }
    /// Declares that the document's bounds keep this parameter above zero.
    pub fn declare_positive(&mut self, parameter: ParameterId) {
        self.positive.insert(parameter);
    }
    pub fn is_declared_positive(&self, id: NodeId) -> bool {
        matches!(self.node(id), Node::Input(Input::Parameter(p) | Input::Entry(p)) if self.positive.contains(p))
    }
    /// Sets the span of new nodes.
    pub fn set_span(&mut self, span: Option<Span>) {
        self.span = span;
    }
    /// Marks a sum or product as a unit: it is not flattened into others.
    pub fn set_opaque(&mut self, id: NodeId) {
        self.opaque[id.index()] = true;
    }
    pub fn is_opaque(&self, id: NodeId) -> bool {
        self.opaque[id.index()]
    }

    /// Units of work so far: operands visited by constructors, and other charges.
    pub fn work(&self) -> usize {
        self.work
    }

    /// Charges units of work; beyond the budget the graph counts as full.
    pub fn charge(&mut self, units: usize) {
        self.work += units;
        self.overflowed |= !self.budget.charge(units);
    }

    /// The document's budget.
    pub fn budget(&self) -> &Budget {
        &self.budget
    }

    /// A copy that draws on `budget`, which is charged for it.
    pub fn drawing_on(&self, budget: Budget) -> Graph {
        let mut graph = Graph { budget, overflowed: false, work: 0, ..self.clone() };
        graph.charge(self.len() / 2);
        graph
    }

    /// A copy on the same budget, with spare capacity.
    pub fn copied(&self) -> Graph {
        let mut graph = self.clone();
        graph.charge(self.len() / 2);
        graph.nodes.reserve(ROOM);
        graph.index.reserve(ROOM, |(hash, _)| spread(*hash));
        graph
    }

    /// A snapshot to roll back to.
    pub fn mark(&self) -> Mark {
        Mark { nodes: self.nodes.len(), overflowed: self.overflowed }
    }

    /// Removes the nodes added since. None may still be referenced, and no older one may have become opaque.
    pub fn roll_back(&mut self, mark: Mark) {
        for id in mark.nodes..self.nodes.len() {
            let hash = spread(hash(&self.nodes[id]));
            if let Ok(entry) = self.index.find_entry(hash, |(_, known)| known.index() == id) {
                entry.remove();
            }
        }
        self.nodes.truncate(mark.nodes);
        self.traits.truncate(mark.nodes);
        self.spans.truncate(mark.nodes);
        self.opaque.truncate(mark.nodes);
        self.overflowed = mark.overflowed;
    }

    /// Switches to another budget.
    pub fn draw_on(&mut self, budget: Budget) {
        self.budget = budget;
    }

    fn add(&mut self, node: Node) -> NodeId {
        let hash = hash(&node);
        self.entry(hash, |known| *known == node).unwrap_or_else(|| self.push(hash, node))
    }

    /// The node with this hash that satisfies `is_it`.
    fn entry(&mut self, hash: u32, is_it: impl Fn(&Node) -> bool) -> Option<NodeId> {
        self.charge(1);
        let found = self.index.find(spread(hash), |(its, id)| *its == hash && is_it(&self.nodes[id.index()]));
        found.map(|(_, id)| *id)
    }

    fn push(&mut self, hash: u32, node: Node) -> NodeId {
        if self.nodes.len() >= LIMITS.nodes || self.overflowed {
            self.overflowed = true;
            return NodeId(0);
        }
        let id = NodeId(self.nodes.len() as u32);
        let level = match &node {
            Node::Coordinate(c) if c.0 > 0 => Level::Row,
            Node::Coordinate(_) | Node::Channel(_) => Level::Pixel,
            node => operands(node).fold(Level::Pass, |level, n| level.max(self.level(n))),
        };
        let content = match &node {
            Node::Sum(constant, terms) => content(*constant, terms),
            _ => 1.0,
        };
        let may_lack_value = match &node {
            Node::Product(factors) if factors.iter().any(|(_, exponent)| *exponent < 0) => true,
            Node::Channel(_) | Node::Sqrt(_) | Node::Call1(..) | Node::Call2(..) | Node::Gather(..) => true,
            node => operands(node).any(|n| self.may_lack_value(n)),
        };
        self.traits.push(Traits { level, growth: self.growth_of(&node), may_lack_value, content });
        self.nodes.push(node);
        self.index.insert_unique(spread(hash), (hash, id), |(hash, _)| spread(*hash));
        self.spans.push(self.span);
        self.opaque.push(false);
        id
    }

    pub fn number(&mut self, value: f64) -> NodeId {
        self.add(Node::Number(Bits::new(value)))
    }
    pub fn input(&mut self, input: Input) -> NodeId {
        self.add(Node::Input(input))
    }
    pub fn coordinate(&mut self, coordinate: CoordinateId) -> NodeId {
        self.add(Node::Coordinate(coordinate))
    }
    pub fn channel(&mut self, channel: ChannelId) -> NodeId {
        self.add(Node::Channel(channel))
    }

    pub fn value_of(&self, id: NodeId) -> Option<f64> {
        match self.node(id) {
            Node::Number(bits) => Some(bits.get()),
            _ => None,
        }
    }

    /// True when a number, or a sum's constant and coefficients, are neither infinite nor NaN.
    pub fn has_finite_numbers(&self, id: NodeId) -> bool {
        match self.node(id) {
            Node::Number(bits) => bits.get().is_finite(),
            Node::Sum(constant, terms) => constant.get().is_finite() && terms.iter().all(|(_, c)| c.get().is_finite()),
            _ => true,
        }
    }

    /// constant + Σ coefficient · node. Collects like terms; flattens sums that are not opaque.
    pub fn sum(&mut self, constant: f64, terms: impl IntoIterator<Item = (NodeId, f64)>) -> NodeId {
        let mut constant = constant;
        let mut collected = std::mem::take(&mut self.terms);
        collected.clear();
        for (node, coefficient) in terms {
            if coefficient == 0.0 {
                continue;
            }
            match self.node(node) {
                Node::Number(bits) => constant += coefficient * bits.get(),
                Node::Sum(inner, list) if !self.is_opaque(node) || (list.len() == 1 && inner.get() == 0.0) => {
                    constant += coefficient * inner.get();
                    collected.extend(list.iter().map(|(n, c)| (*n, Bits::new(coefficient * c.get()))));
                }
                _ => collected.push((node, Bits::new(coefficient))),
            }
        }
        self.charge(1 + collected.len());
        merge(&mut collected, |total, coefficient| Bits::new(total.get() + coefficient.get()));
        collected.retain(|(_, coefficient)| coefficient.get() != 0.0);
        let sum = match collected[..] {
            [] => self.number(constant),
            [(node, one)] if constant == 0.0 && one.get() == 1.0 => node,
            _ => self.sum_of(Bits::new(constant), &collected),
        };
        self.terms = collected;
        sum
    }

    /// Interns a canonical sum.
    fn sum_of(&mut self, constant: Bits, terms: &[(NodeId, Bits)]) -> NodeId {
        let hash = hash_sum(constant, terms);
        let is_it = |known: &Node| matches!(known, Node::Sum(c, list) if *c == constant && list[..] == *terms);
        self.entry(hash, is_it).unwrap_or_else(|| self.push(hash, Node::Sum(constant, terms.into())))
    }

    /// Interns a canonical product.
    fn product_of(&mut self, factors: &[(NodeId, i32)]) -> NodeId {
        let hash = hash_product(factors);
        let is_it = |known: &Node| matches!(known, Node::Product(list) if list[..] == *factors);
        self.entry(hash, is_it).unwrap_or_else(|| self.push(hash, Node::Product(factors.into())))
    }

    /// Number of terms of a sum or factors of a product.
    pub fn operand_count(&self, id: NodeId) -> usize {
        match self.node(id) {
            Node::Sum(_, terms) => terms.len(),
            Node::Product(factors) => factors.len(),
            _ => 0,
        }
    }

    /// The largest magnitude of a product's exponents.
    pub fn exponent_max(&self, id: NodeId) -> u32 {
        match self.node(id) {
            Node::Product(factors) => factors.iter().map(|(_, e)| e.unsigned_abs()).max().unwrap_or(0),
            Node::Sum(constant, terms) if terms.len() == 1 && constant.get() == 0.0 => self.exponent_max(terms[0].0),
            _ => 0,
        }
    }

    /// The terms of a sum, in order, if others would flatten it; else the node alone.
    pub fn terms(&self, id: NodeId) -> SmallVec<[NodeId; 8]> {
        match self.node(id) {
            Node::Sum(constant, terms) if !self.is_opaque(id) || (terms.len() == 1 && constant.get() == 0.0) => {
                terms.iter().map(|(n, _)| *n).collect()
            }
            _ => SmallVec::from_slice(&[id]),
        }
    }

    pub fn add2(&mut self, a: NodeId, b: NodeId) -> NodeId {
        self.sum(0.0, [(a, 1.0), (b, 1.0)])
    }
    pub fn sub(&mut self, a: NodeId, b: NodeId) -> NodeId {
        self.sum(0.0, [(a, 1.0), (b, -1.0)])
    }
    pub fn scale(&mut self, coefficient: f64, a: NodeId) -> NodeId {
        if let Node::Sum(constant, terms) = self.node(a)
            && (terms.len() > 1 || constant.get() != 0.0)
            && coefficient != 1.0
            && coefficient != 0.0
        {
            return self.sum_of(Bits::new(0.0), &[(a, Bits::new(coefficient))]);
        }
        self.sum(0.0, [(a, coefficient)])
    }
    pub fn mul(&mut self, a: NodeId, b: NodeId) -> NodeId {
        self.product(1.0, [(a, 1), (b, 1)])
    }
    pub fn div(&mut self, a: NodeId, b: NodeId) -> NodeId {
        self.product(1.0, [(a, 1), (b, -1)])
    }

    /// coefficient · Π node^exponent. Numeric factors and the contents of sums go to the coefficient, which is kept
    /// outside, on a sum of one term. 0 · x is 0.
    pub fn product<F>(&mut self, coefficient: f64, factors: F) -> NodeId
    where
        F: IntoIterator<Item = (NodeId, i32), IntoIter: DoubleEndedIterator>,
    {
        let mut coefficient = coefficient;
        let mut collected = std::mem::take(&mut self.factors);
        collected.clear();
        for (mut node, exponent) in factors.into_iter().rev().filter(|(_, e)| *e != 0) {
            while let Node::Sum(constant, list) = self.node(node)
                && list.len() == 1
                && constant.get() == 0.0
            {
                coefficient *= list[0].1.get().powi(exponent);
                node = list[0].0;
            }
            match self.node(node) {
                Node::Number(bits) => coefficient *= bits.get().powi(exponent),
                // Its factors are canonical.
                Node::Product(list) if !self.is_opaque(node) => {
                    collected.extend(list.iter().map(|(n, e)| (*n, e.saturating_mul(exponent))));
                }
                Node::Sum(constant, list) if self.traits[node.index()].content != 1.0 && !self.is_opaque(node) => {
                    let content = self.traits[node.index()].content;
                    let constant = Bits::new(constant.get() / content);
                    let list: SmallVec<[_; 8]> = list.iter().map(|(n, c)| (*n, Bits::new(c.get() / content))).collect();
                    coefficient *= content.powi(exponent);
                    collected.push((self.sum_of(constant, &list), exponent));
                }
                _ => collected.push((node, exponent)),
            }
        }
        if coefficient == 0.0 {
            self.factors = collected;
            return self.number(0.0);
        }
        self.charge(1 + collected.len());
        merge(&mut collected, i32::saturating_add);
        collected.retain(|(_, exponent)| *exponent != 0);
        self.divide_exponential(&mut collected);
        // Beyond the range of exponents.
        self.overflowed |= collected.iter().any(|(_, exponent)| exponent.unsigned_abs() >= i32::MAX as u32);
        let body = match collected[..] {
            [] => None,
            [(node, 1)] => Some(node),
            _ => Some(self.product_of(&collected)),
        };
        self.factors = collected;
        let Some(body) = body else { return self.number(coefficient) };
        if coefficient == 1.0 {
            self.charge(2);
            return body;
        }
        self.scale(coefficient, body)
    }

    pub fn sqrt(&mut self, a: NodeId) -> NodeId {
        match self.value_of(a) {
            Some(value) => self.number(value.sqrt()),
            None => self.add(Node::Sqrt(a)),
        }
    }
    pub fn abs(&mut self, a: NodeId) -> NodeId {
        match self.value_of(a) {
            Some(value) => self.number(value.abs()),
            None => self.add(Node::Abs(a)),
        }
    }
    pub fn call1(&mut self, function: Function1, a: NodeId) -> NodeId {
        match self.value_of(a) {
            Some(value) => self.number(function.value(value)),
            None => self.add(Node::Call1(function, a)),
        }
    }
    pub fn call2(&mut self, function: Function2, a: NodeId, b: NodeId) -> NodeId {
        match (self.value_of(a), self.value_of(b)) {
            (Some(x), Some(y)) => self.number(function.value(x, y)),
            _ => self.add(Node::Call2(function, a, b)),
        }
    }

    pub fn gather(&mut self, lookup: Lookup, a: NodeId, b: NodeId) -> NodeId {
        self.add(Node::Gather(lookup, a, b))
    }

    /// base^exponent: integer powers are products, halves use the square root, all else is `pow`.
    pub fn power(&mut self, base: NodeId, exponent: NodeId) -> NodeId {
        let Some(value) = self.value_of(exponent) else { return self.call2(Function2::Pow, base, exponent) };
        let whole = value.floor();
        if whole.abs() > LIMITS.exponent as f64 || (value != whole && value - whole != 0.5) {
            return self.call2(Function2::Pow, base, exponent);
        }
        if value == whole {
            return self.product(1.0, [(base, whole as i32)]);
        }
        let root = self.sqrt(base);
        self.product(1.0, [(base, whole as i32), (root, 1)])
    }

    pub fn compare(&mut self, comparison: Comparison, a: NodeId, b: NodeId) -> NodeId {
        self.add(Node::Compare(comparison, a, b))
    }
    pub fn and(&mut self, a: NodeId, b: NodeId) -> NodeId {
        if a == b { a } else { self.add(Node::And(a, b)) }
    }
    pub fn or(&mut self, a: NodeId, b: NodeId) -> NodeId {
        if a == b { a } else { self.add(Node::Or(a, b)) }
    }
    pub fn not(&mut self, a: NodeId) -> NodeId {
        self.add(Node::Not(a))
    }
    pub fn select(&mut self, condition: NodeId, a: NodeId, b: NodeId) -> NodeId {
        if a == b { a } else { self.add(Node::Select(condition, a, b)) }
    }

    pub fn is_truth(&self, id: NodeId) -> bool {
        matches!(self.node(id), Node::Compare(..) | Node::And(..) | Node::Or(..) | Node::Not(_))
    }

    /// All nodes below `roots`, roots included, operands first.
    pub fn reachable(&self, roots: &[NodeId]) -> Vec<NodeId> {
        let Some(last) = roots.iter().max() else { return Vec::new() };
        let mut live = vec![false; last.index() + 1];
        roots.iter().for_each(|r| live[r.index()] = true);
        let mut found = Vec::with_capacity(live.len());
        for i in (0..live.len()).rev() {
            if live[i] {
                found.push(NodeId(i as u32));
                match &self.nodes[i] {
                    Node::Sum(_, terms) => terms.iter().for_each(|(n, _)| live[n.index()] = true),
                    Node::Product(factors) => factors.iter().for_each(|(n, _)| live[n.index()] = true),
                    node => operands(node).for_each(|n| live[n.index()] = true),
                }
            }
        }
        found.reverse();
        found
    }

    /// As [`Graph::reachable`], but charges units of work: for repeated use.
    pub fn walked(&mut self, roots: &[NodeId]) -> Vec<NodeId> {
        let found = self.reachable(roots);
        self.charge(found.len() + self.len() / 64);
        found
    }

    /// The channels that are read below `roots`.
    pub fn channels(&self, roots: &[NodeId]) -> Vec<ChannelId> {
        let channel = |id: NodeId| match self.node(id) {
            Node::Channel(channel) => Some(*channel),
            _ => None,
        };
        self.reachable(roots).into_iter().filter_map(channel).collect()
    }

    /// Uses of each node by others below `roots`, by index.
    pub fn use_counts(&self, roots: &[NodeId]) -> Vec<u32> {
        let mut counts = vec![0; self.nodes.len()];
        for id in self.reachable(roots) {
            operands(self.node(id)).for_each(|n| counts[n.index()] += 1);
        }
        counts
    }

    /// The same expression with every leaf replaced by `leaf` (`None` keeps it); keeps opaqueness.
    pub fn substitute(&mut self, root: NodeId, leaf: &mut dyn FnMut(&mut Graph, &Node) -> Option<NodeId>) -> NodeId {
        let mut map: FxHashMap<NodeId, NodeId> = FxHashMap::default();
        let reachable = self.walked(&[root]);
        for id in reachable {
            let replaced = match self.node(id) {
                node @ (Node::Number(_) | Node::Input(_) | Node::Coordinate(_) | Node::Channel(_)) => {
                    let node = node.clone();
                    leaf(self, &node)
                }
                _ => None,
            };
            let new = replaced.unwrap_or_else(|| self.rebuild(id, &map));
            map.insert(id, new);
        }
        map[&root]
    }

    /// `node` with `old` replaced by `new`.
    pub fn replaced(&mut self, node: NodeId, old: NodeId, new: NodeId) -> NodeId {
        let mut map = FxHashMap::default();
        let reachable = self.walked(&[node]);
        for id in reachable {
            let next = if id == old { new } else { self.rebuild(id, &map) };
            map.insert(id, next);
        }
        map[&node]
    }

    /// `id` with its operands mapped.
    pub fn rebuild(&mut self, id: NodeId, map: &FxHashMap<NodeId, NodeId>) -> NodeId {
        let at = |n: &NodeId| map.get(n).copied().unwrap_or(*n);
        if operands(self.node(id)).all(|n| at(&n) == n) {
            return id;
        }
        let node = self.node(id).clone();
        let before = std::mem::replace(&mut self.span, self.spans[id.index()]);
        let new = match &node {
            Node::Sum(c, terms) => self.sum(c.get(), terms.iter().map(|(n, c)| (at(n), c.get())).collect::<Vec<_>>()),
            Node::Product(f) => self.product(1.0, f.iter().map(|(n, e)| (at(n), *e)).collect::<Vec<_>>()),
            Node::Sqrt(a) => self.sqrt(at(a)),
            Node::Abs(a) => self.abs(at(a)),
            Node::Call1(f, a) => self.call1(*f, at(a)),
            Node::Call2(f, a, b) => self.call2(*f, at(a), at(b)),
            Node::Gather(lookup, a, b) => self.gather(*lookup, at(a), at(b)),
            Node::Compare(c, a, b) => self.compare(*c, at(a), at(b)),
            Node::And(a, b) => self.and(at(a), at(b)),
            Node::Or(a, b) => self.or(at(a), at(b)),
            Node::Not(a) => self.not(at(a)),
            Node::Select(c, a, b) => self.select(at(c), at(a), at(b)),
            _ => id,
        };
        self.span = before;
        if self.is_opaque(id) {
            self.set_opaque(new);
        }
        new
    }

    /// The value in f64, for formulas without pixels. Truth values are 1 and 0. `leaf` gives inputs and coordinates.
    pub fn evaluate(&self, root: NodeId, leaf: &dyn Fn(&Node) -> f64) -> f64 {
        let mut values = vec![f64::NAN; root.index() + 1];
        let truth = |b: bool| f64::from(u8::from(b));
        for id in self.reachable(&[root]) {
            let at = |n: &NodeId| values[n.index()];
            let value = match self.node(id) {
                Node::Number(bits) => bits.get(),
                node @ (Node::Input(_) | Node::Coordinate(_) | Node::Channel(_)) => leaf(node),
                Node::Sum(c, terms) => terms.iter().fold(c.get(), |sum, (n, c)| sum + c.get() * at(n)),
                Node::Product(factors) => factors.iter().map(|(n, e)| at(n).powi(*e)).product(),
                Node::Sqrt(a) => at(a).sqrt(),
                Node::Abs(a) => at(a).abs(),
                Node::Call1(f, a) => f.value(at(a)),
                Node::Call2(f, a, b) => f.value(at(a), at(b)),
                Node::Gather(lookup, a, b) => self.tables.look_up(*lookup, at(a), at(b)),
                Node::Compare(c, a, b) => truth(holds(*c, at(a), at(b))),
                Node::And(a, b) => at(a) * at(b),
                Node::Or(a, b) => at(a).max(at(b)),
                Node::Not(a) => 1.0 - at(a),
                Node::Select(c, a, b) => {
                    if at(c) != 0.0 {
                        at(a)
                    } else {
                        at(b)
                    }
                }
            };
            values[id.index()] = value;
        }
        values[root.index()]
    }
}

/// Sorts by node and merges entries of the same node.
fn merge<T: Copy>(list: &mut Vec<(NodeId, T)>, both: impl Fn(T, T) -> T) {
    if list.is_sorted_by(|a, b| a.0 < b.0) {
        return;
    }
    list.sort_by_key(|(node, _)| *node);
    list.dedup_by(|next, kept| {
        let is_same = next.0 == kept.0;
        if is_same {
            kept.1 = both(kept.1, next.1);
        }
        is_same
    });
}

fn hash(node: &Node) -> u32 {
    match node {
        Node::Sum(constant, terms) => hash_sum(*constant, terms),
        Node::Product(factors) => hash_product(factors),
        _ => FxBuildHasher.hash_one(node) as u32,
    }
}

fn hash_sum(constant: Bits, terms: &[(NodeId, Bits)]) -> u32 {
    FxBuildHasher.hash_one((constant, terms)) as u32
}

fn hash_product(factors: &[(NodeId, i32)]) -> u32 {
    FxBuildHasher.hash_one(factors) as u32
}

/// Spreads the hash over 64 bits, for the table.
fn spread(hash: u32) -> u64 {
    u64::from(hash).wrapping_mul(0x9e37_79b9_7f4a_7c15)
}

/// The factor that divides a sum exactly: the common magnitude, or the greatest common divisor of whole coefficients,
/// with the sign of the first term.
pub(crate) fn content(constant: Bits, terms: &[(NodeId, Bits)]) -> f64 {
    let all = || terms.iter().map(|(_, c)| c.get()).chain((constant.get() != 0.0).then(|| constant.get()));
    let sign = if terms.first().is_some_and(|(_, c)| c.get() < 0.0) { -1.0 } else { 1.0 };
    let first = terms.first().map_or(1.0, |(_, c)| c.get().abs());
    if all().all(|c| c.abs() == first) {
        return sign * first;
    }
    if all().all(|c| c.fract() == 0.0 && c.abs() < 1e9) {
        let gcd = all().fold(0_u64, |g, c| gcd(g, c.abs() as u64));
        return sign * gcd.max(1) as f64;
    }
    sign
}

fn gcd(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// The nodes that `node` reads.
pub(crate) fn operands(node: &Node) -> impl Iterator<Item = NodeId> + '_ {
    let mut few = [None; 3];
    let (mut terms, mut factors) = (&[][..], &[][..]);
    match node {
        Node::Number(_) | Node::Input(_) | Node::Coordinate(_) | Node::Channel(_) => {}
        Node::Sum(_, list) => terms = list,
        Node::Product(list) => factors = list,
        Node::Sqrt(a) | Node::Abs(a) | Node::Call1(_, a) | Node::Not(a) => few = [Some(*a), None, None],
        Node::Call2(_, a, b) | Node::Gather(_, a, b) | Node::Compare(_, a, b) | Node::And(a, b) | Node::Or(a, b) => {
            few = [Some(*a), Some(*b), None];
        }
        Node::Select(c, a, b) => few = [Some(*c), Some(*a), Some(*b)],
    }
    let listed = terms.iter().map(|(n, _)| *n).chain(factors.iter().map(|(n, _)| *n));
    few.into_iter().flatten().chain(listed)
}
