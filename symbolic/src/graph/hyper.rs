//! Hyper-dual numbers: a value with its gradient and Hessian, in any arithmetic, and the evaluation of a graph in them.
//!
//! Forward differentiation, whose only derivative formulas are [`isophote_elementary::derivatives`]: the reference for
//! [`crate::graph::jet`] and everything built on it. Numbers store only the variables that they depend on.

use isophote_elementary::{Function1, Function2, Two, derivatives, derivatives2};
use rustc_hash::FxHashMap;
use smallvec::{SmallVec, smallvec};

use crate::graph::{Graph, Node, NodeId};
use crate::program::arithmetic::Number;
use crate::program::{Level, holds};

/// A value and its derivatives.
#[derive(Debug)]
pub(crate) struct Hyper<N> {
    pub value: N,
    /// The variables that it depends on, ascending.
    active: Active,
    /// The gradient over the active variables; then the upper triangle of the Hessian, row by row, unless the order is
    /// first.
    derivatives: SmallVec<[N; 8]>,
}

type Active = SmallVec<[u16; 12]>;

impl<N: Number> Clone for Hyper<N> {
    fn clone(&self) -> Self {
        let (active, derivatives) = (SmallVec::from_slice(&self.active), SmallVec::from_slice(&self.derivatives));
        Hyper { value: self.value, active, derivatives }
    }
}

impl<N: Number> Hyper<N> {
    pub fn fixed(value: N) -> Hyper<N> {
        Hyper { value, active: SmallVec::new(), derivatives: SmallVec::new() }
    }

    fn first(&self) -> &[N] {
        &self.derivatives[..self.active.len()]
    }

    fn second(&self) -> &[N] {
        &self.derivatives[self.active.len()..]
    }

    /// f(self) from f, f′, f″.
    pub fn unary(&self, (value, slope, bend): (N, N, N)) -> Hyper<N> {
        let mut result = self.linear(value, slope);
        if self.second().is_empty() {
            return result;
        }
        let mut second = result.derivatives[self.active.len()..].iter_mut();
        for (i, a) in self.first().iter().enumerate() {
            self.first()[i..].iter().zip(&mut second).for_each(|(b, s)| *s = *s + bend * (*a * *b));
        }
        result
    }

    /// c · self.
    fn linear(&self, value: N, c: N) -> Hyper<N> {
        let mut result = self.clone();
        result.value = value;
        result.derivatives.iter_mut().for_each(|d| *d = c * *d);
        result
    }

    /// f(self, b).
    pub fn binary(&self, b: &Hyper<N>, f: &Two<N>) -> Hyper<N> {
        match (self.active.is_empty(), b.active.is_empty()) {
            (_, true) => return self.unary((f.value, f.a, f.aa)),
            (true, _) => return b.unary((f.value, f.b, f.bb)),
            _ => {}
        }
        let second = |[sa, sb, ai, aj, bi, bj]: [N; 6]| {
            f.a * sa + f.b * sb + f.aa * (ai * aj) + f.bb * (bi * bj) + f.ab * (ai * bj + aj * bi)
        };
        self.combined(b, f.value, &|a, b| f.a * a + f.b * b, &second)
    }

    /// Over the variables of both: `first` combines the two first derivatives, `second` the two second ones and a_i,
    /// a_j, b_i, b_j.
    fn combined(&self, b: &Hyper<N>, value: N, first: &impl Fn(N, N) -> N, second: &impl Fn([N; 6]) -> N) -> Hyper<N> {
        if self.active != b.active || self.derivatives.len() != b.derivatives.len() {
            return self.merged(b, value, first, second);
        }
        let (in_a, in_b) = (self.first(), b.first());
        let mut result = self.clone();
        result.value = value;
        let (firsts, seconds) = result.derivatives.split_at_mut(in_a.len());
        firsts.iter_mut().zip(in_b).for_each(|(a, b)| *a = first(*a, *b));
        if seconds.is_empty() {
            return result;
        }
        let mut seconds = seconds.iter_mut().zip(b.second());
        for (i, (ai, bi)) in in_a.iter().zip(in_b).enumerate() {
            let row = in_a[i..].iter().zip(&in_b[i..]).zip(&mut seconds);
            row.for_each(|((aj, bj), (sa, sb))| *sa = second([*sa, *sb, *ai, *aj, *bi, *bj]));
        }
        result
    }

    /// The same where the variables differ.
    fn merged(&self, b: &Hyper<N>, value: N, first: &impl Fn(N, N) -> N, second: &impl Fn([N; 6]) -> N) -> Hyper<N> {
        let mut merged = Hyper::fixed(value);
        let mut places: SmallVec<[[Option<usize>; 2]; 12]> = SmallVec::new();
        let (mut in_a, mut in_b) = (0, 0);
        let of = |x: &Hyper<N>, at: Option<usize>| at.map_or(N::from(0.0), |at| x.derivatives[at]);
        while let Some(variable) = [self.active.get(in_a), b.active.get(in_b)].into_iter().flatten().min().copied() {
            let place = |x: &Hyper<N>, next: &mut usize| {
                let is_its = x.active.get(*next) == Some(&variable);
                *next += usize::from(is_its);
                is_its.then(|| *next - 1)
            };
            let [i, j] = [place(self, &mut in_a), place(b, &mut in_b)];
            merged.active.push(variable);
            merged.derivatives.push(first(of(self, i), of(b, j)));
            places.push([i, j]);
        }
        let has_second = !self.second().is_empty() || !b.second().is_empty();
        for (at, [ai, bi]) in places.iter().enumerate().filter(|_| has_second) {
            merged.derivatives.extend(places[at..].iter().map(|[aj, bj]| {
                let (sa, sb) = (self.second_at(*ai, *aj), b.second_at(*bi, *bj));
                second([sa, sb, of(self, *ai), of(self, *aj), of(b, *bi), of(b, *bj)])
            }));
        }
        merged
    }

    fn second_at(&self, i: Option<usize>, j: Option<usize>) -> N {
        let n = self.active.len();
        match (i, j) {
            (Some(i), Some(j)) if self.derivatives.len() > n => self.derivatives[n + i * n - i * (i + 1) / 2 + j],
            _ => N::from(0.0),
        }
    }

    /// ∂/∂u.
    pub fn gradient(&self, u: u16) -> N {
        self.active.binary_search(&u).map_or(N::from(0.0), |i| self.derivatives[i])
    }

    /// ∂²/∂u∂v, u ≤ v.
    pub fn hessian(&self, u: u16, v: u16) -> N {
        self.second_at(self.active.binary_search(&u).ok(), self.active.binary_search(&v).ok())
    }

    /// Index of each of `n` variables among the active ones.
    fn places(&self, n: u16) -> Vec<Option<usize>> {
        (0..n).map(|variable| self.active.binary_search(&variable).ok()).collect()
    }

    /// ∂/∂u for each of `n` variables.
    pub fn gradients(&self, n: u16) -> impl Iterator<Item = N> + '_ {
        self.places(n).into_iter().map(|i| i.map_or(N::from(0.0), |i| self.derivatives[i]))
    }

    /// ∂²/∂u∂v for each pair u ≤ v of `n` variables, row by row.
    pub fn hessians(&self, n: u16) -> impl Iterator<Item = N> + '_ {
        let places = self.places(n);
        let pairs = (0..places.len()).flat_map(move |i| (i..usize::from(n)).map(move |j| (i, j)));
        pairs.map(move |(i, j)| self.second_at(places[i], places[j]))
    }

    pub fn add(&self, b: &Hyper<N>) -> Hyper<N> {
        let mut sum = self.clone();
        sum.add_scaled(b, 1.0);
        sum
    }
}

/// Order of differentiation.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Order {
    First,
    Second,
}

/// The value of a node: a number alone, or with its derivatives.
pub(crate) trait Quantity: Clone {
    type Number: Number;
    fn fixed(value: Self::Number) -> Self;
    fn variable(value: Self::Number, variable: u16, order: Order) -> Self;
    fn value(&self) -> Self::Number;
    fn add_scaled(&mut self, b: &Self, c: f64);
    fn scaled(&self, c: f64) -> Self;
    fn mul(&self, b: &Self) -> Self;
    fn power(&self, n: i32) -> Self;
    fn sqrt(&self) -> Self;
    fn call1(&self, function: Function1) -> Self;
    fn call2(&self, function: Function2, b: &Self) -> Self;
}

/// A number without derivatives.
#[derive(Clone, Copy)]
pub(crate) struct Bare<N> {
    pub value: N,
}

impl<N: Number> Quantity for Bare<N> {
    type Number = N;
    fn fixed(value: N) -> Self {
        Bare { value }
    }
    fn variable(value: N, _: u16, _: Order) -> Self {
        Bare { value }
    }
    fn value(&self) -> N {
        self.value
    }
    fn add_scaled(&mut self, b: &Self, c: f64) {
        self.value = self.value + N::from(c) * b.value;
    }
    fn scaled(&self, c: f64) -> Self {
        Bare { value: N::from(c) * self.value }
    }
    fn mul(&self, b: &Self) -> Self {
        Bare { value: self.value * b.value }
    }
    fn power(&self, n: i32) -> Self {
        Bare { value: whole_power(self.value, n) }
    }
    fn sqrt(&self) -> Self {
        Bare { value: self.value.sqrt() }
    }
    fn call1(&self, function: Function1) -> Self {
        Bare { value: self.value.call1(function) }
    }
    fn call2(&self, function: Function2, b: &Self) -> Self {
        Bare { value: self.value.call2(function, b.value) }
    }
}

impl<N: Number> Quantity for Hyper<N> {
    type Number = N;
    fn fixed(value: N) -> Self {
        Hyper::fixed(value)
    }
    fn variable(value: N, variable: u16, order: Order) -> Self {
        let (one, zero) = (N::from(1.0), N::from(0.0));
        let derivatives = if order == Order::Second { smallvec![one, zero] } else { smallvec![one] };
        Hyper { value, active: smallvec![variable], derivatives }
    }
    fn value(&self) -> N {
        self.value
    }
    fn add_scaled(&mut self, b: &Hyper<N>, c: f64) {
        let by = N::from(c);
        let value = self.value + if c == 1.0 { b.value } else { by * b.value };
        if b.active.is_empty() {
            self.value = value;
        } else if self.active.is_empty() {
            *self = if c == 1.0 { Hyper { value, ..b.clone() } } else { b.linear(value, by) };
        } else if self.active == b.active {
            self.value = value;
            let both = self.derivatives.iter_mut().zip(&b.derivatives);
            both.for_each(|(a, b)| *a = *a + if c == 1.0 { *b } else { by * *b });
        } else {
            *self = self.combined(b, value, &|a, b| a + by * b, &|[a, b, ..]| a + by * b);
        }
    }
    fn scaled(&self, by: f64) -> Hyper<N> {
        let by = N::from(by);
        self.linear(by * self.value, by)
    }
    fn mul(&self, b: &Hyper<N>) -> Hyper<N> {
        let (x, y) = (self.value, b.value);
        match (self.active.is_empty(), b.active.is_empty()) {
            (_, true) => self.linear(x * y, y),
            (true, _) => b.linear(x * y, x),
            _ => {
                let second = |[sa, sb, ai, aj, bi, bj]: [N; 6]| y * sa + x * sb + (ai * bj + aj * bi);
                self.combined(b, x * y, &|a, b| y * a + x * b, &second)
            }
        }
    }
    fn power(&self, n: i32) -> Hyper<N> {
        if n == 1 {
            return self.clone();
        }
        let whole = |exponent| whole_power(self.value, exponent);
        let (first, second) = (f64::from(n), f64::from(n) * (f64::from(n) - 1.0));
        let (slope, bend) = (whole(n.saturating_sub(1)), whole(n.saturating_sub(2)));
        self.unary((whole(n), N::from(first) * slope, N::from(second) * bend))
    }
    fn sqrt(&self) -> Hyper<N> {
        let root = self.value.sqrt();
        let slope = N::from(0.5) / root;
        self.unary((root, slope, -(slope / (N::from(2.0) * self.value))))
    }
    fn call1(&self, function: Function1) -> Self {
        match self.active.is_empty() {
            true => Hyper::fixed(self.value.call1(function)),
            false => self.unary(derivatives(function, self.value)),
        }
    }
    fn call2(&self, function: Function2, b: &Self) -> Self {
        match self.active.is_empty() && b.active.is_empty() {
            true => Hyper::fixed(self.value.call2(function, b.value)),
            false => self.binary(b, &derivatives2(function, self.value, b.value)),
        }
    }
}

fn whole_power<N: Number>(x: N, exponent: i32) -> N {
    let (mut square, mut power, mut left) = (x, N::from(1.0), exponent.unsigned_abs());
    while left > 0 {
        power = if left & 1 == 1 { power * square } else { power };
        left >>= 1;
        square = if left > 0 { square * square } else { square };
    }
    if exponent < 0 { N::from(1.0) / power } else { power }
}

#[derive(Clone)]
enum Cell<Q> {
    Number(Q),
    Truth(bool),
}

/// Evaluates `roots` repeatedly at changing pixels; computes values known per pass once.
pub(crate) struct Evaluator<'a, Q> {
    graph: &'a Graph,
    roots: Vec<NodeId>,
    order: Order,
    variables: FxHashMap<NodeId, u16>,
    /// By node index.
    cells: Vec<Cell<Q>>,
    outer: Vec<NodeId>,
    inner: Vec<NodeId>,
}

/// An evaluation without derivatives.
pub(crate) type Values<'a, N> = Evaluator<'a, Bare<N>>;

impl<'a, N: Number> Values<'a, N> {
    /// `leaf` gives inputs.
    pub fn of(graph: &'a Graph, roots: &[NodeId], leaf: &dyn Fn(&Node) -> N) -> Values<'a, N> {
        let mut values = Evaluator::new(graph, roots, &[], Order::First);
        values.enter(leaf);
        values
    }
}

impl<'a, Q: Quantity> Evaluator<'a, Q> {
    /// `variables` are the nodes to differentiate by. Call [`Self::enter`] before evaluating.
    pub fn new(graph: &'a Graph, roots: &[NodeId], variables: &[NodeId], order: Order) -> Evaluator<'a, Q> {
        let variables = variables.iter().enumerate().map(|(i, node)| (*node, i as u16)).collect();
        let (outer, inner): (Vec<_>, Vec<_>) =
            graph.reachable(roots).into_iter().partition(|node| graph.level(*node) == Level::Pass);
        let last = outer.last().max(inner.last());
        let cells = vec![Cell::Truth(false); last.map_or(0, |node| node.index() + 1)];
        Evaluator { graph, roots: roots.to_vec(), order, variables, cells, outer, inner }
    }

    /// Sets the inputs and evaluates the nodes known per pass.
    pub fn enter(&mut self, leaf: &dyn Fn(&Node) -> Q::Number) {
        for i in 0..self.outer.len() {
            self.work_out(self.outer[i], leaf);
        }
    }

    /// The roots at one pixel; `leaf` gives coordinates and channels.
    pub fn at(&mut self, leaf: &dyn Fn(&Node) -> Q::Number) -> SmallVec<[&Q; 2]> {
        self.step(leaf);
        self.roots.iter().map(|root| self.number(*root)).collect()
    }

    /// The first root, a truth value, at one pixel.
    pub fn holds_at(&mut self, leaf: &dyn Fn(&Node) -> Q::Number) -> bool {
        self.step(leaf);
        self.roots.first().is_some_and(|root| self.truth(*root))
    }

    fn step(&mut self, leaf: &dyn Fn(&Node) -> Q::Number) {
        for i in 0..self.inner.len() {
            self.work_out(self.inner[i], leaf);
        }
    }

    fn number(&self, node: NodeId) -> &Q {
        match &self.cells[node.index()] {
            Cell::Number(number) => number,
            Cell::Truth(_) => unreachable!("the elaborator keeps truth values and numbers apart"),
        }
    }

    fn truth(&self, node: NodeId) -> bool {
        matches!(self.cells[node.index()], Cell::Truth(true))
    }

    fn work_out(&mut self, id: NodeId, leaf: &dyn Fn(&Node) -> Q::Number) {
        let at = |n: &NodeId| self.number(*n);
        let number = |x: f64| Q::Number::from(x);
        let cell = match self.graph.node(id) {
            Node::Number(bits) => Cell::Number(Q::fixed(number(bits.get()))),
            node @ (Node::Input(_) | Node::Coordinate(_) | Node::Channel(_)) => {
                Cell::Number(match self.variables.get(&id) {
                    Some(variable) => Q::variable(leaf(node), *variable, self.order),
                    None => Q::fixed(leaf(node)),
                })
            }
            Node::Sum(constant, terms) => {
                let mut sum = Q::fixed(number(constant.get()));
                terms.iter().for_each(|(n, c)| sum.add_scaled(at(n), c.get()));
                Cell::Number(sum)
            }
            Node::Product(factors) => {
                let (first, others) = match &factors[..] {
                    [(a, 1), (b, 1), others @ ..] => (at(a).mul(at(b)), others),
                    [(a, exponent), others @ ..] => (at(a).power(*exponent), others),
                    [] => (Q::fixed(number(1.0)), &[][..]),
                };
                let times = |product: Q, (n, exponent): &(NodeId, i32)| match exponent {
                    1 => product.mul(at(n)),
                    _ => product.mul(&at(n).power(*exponent)),
                };
                Cell::Number(others.iter().fold(first, times))
            }
            Node::Sqrt(a) => Cell::Number(at(a).sqrt()),
            Node::Abs(a) => {
                let a = at(a);
                Cell::Number(a.scaled(if a.value() < number(0.0) { -1.0 } else { 1.0 }))
            }
            Node::Call1(f, a) => Cell::Number(at(a).call1(*f)),
            Node::Call2(f, a, b) => Cell::Number(at(a).call2(*f, at(b))),
            // Constant within a cell: no derivatives.
            Node::Gather(lookup, a, b) => {
                Cell::Number(Q::fixed(at(a).value().look_up(at(b).value(), &self.graph.tables, *lookup)))
            }
            Node::Select(c, a, b) => Cell::Number(at(if self.truth(*c) { a } else { b }).clone()),
            Node::Compare(comparison, a, b) => Cell::Truth(holds(*comparison, at(a).value(), at(b).value())),
            Node::And(a, b) => Cell::Truth(self.truth(*a) && self.truth(*b)),
            Node::Or(a, b) => Cell::Truth(self.truth(*a) || self.truth(*b)),
            Node::Not(a) => Cell::Truth(!self.truth(*a)),
        };
        self.cells[id.index()] = cell;
    }
}
