//! Hyper-dual numbers: a value with its gradient and Hessian, in any arithmetic, and the evaluation of a graph in them.
//!
//! It is forward differentiation, with no formula for a derivative but those of [`crate::proof::calculus`]: what the derivatives
//! of [`crate::derive::jet`], and all that is made of them, are compared with. Only variables that a value depends on take room.

use rustc_hash::FxHashMap;

use crate::language::graph::{Graph, Node, NodeId};
use crate::program::{Level, holds};
use crate::proof::calculus::{Two, derivatives, derivatives2};
use crate::proof::evaluate::Number;

/// A value and its derivatives.
#[derive(Clone, Debug)]
pub(crate) struct Hyper<N> {
    pub value: N,
    /// The variables that it depends on, ascending.
    active: Vec<u16>,
    first: Vec<N>,
    /// Upper triangle over the active variables, row by row; empty where only first orders are asked for.
    second: Vec<N>,
}

impl<N: Number> Hyper<N> {
    pub fn fixed(value: N) -> Hyper<N> {
        Hyper { value, active: Vec::new(), first: Vec::new(), second: Vec::new() }
    }

    fn variable(value: N, variable: u16, order: Order) -> Hyper<N> {
        let second = if order == Order::Second { vec![N::from(0.0)] } else { Vec::new() };
        Hyper { value, active: vec![variable], first: vec![N::from(1.0)], second }
    }

    /// f(self) from f, f′, f″.
    pub fn unary(&self, (value, slope, bend): (N, N, N)) -> Hyper<N> {
        let mut second = Vec::with_capacity(self.second.len());
        if !self.second.is_empty() {
            let mut k = 0;
            for i in 0..self.first.len() {
                for j in i..self.first.len() {
                    second.push(slope * self.second[k] + bend * (self.first[i] * self.first[j]));
                    k += 1;
                }
            }
        }
        let first = self.first.iter().map(|d| slope * *d).collect();
        Hyper { value, active: self.active.clone(), first, second }
    }

    /// f(self, b).
    fn binary(&self, b: &Hyper<N>, f: &Two<N>) -> Hyper<N> {
        match (self.active.is_empty(), b.active.is_empty()) {
            (_, true) => return self.unary((f.value, f.a, f.aa)),
            (true, _) => return b.unary((f.value, f.b, f.bb)),
            _ => {}
        }
        let zero = N::from(0.0);
        let mut active = [&self.active[..], &b.active[..]].concat();
        active.sort_unstable();
        active.dedup();
        let places = |x: &Hyper<N>| -> Vec<Option<usize>> {
            active.iter().map(|variable| x.active.binary_search(variable).ok()).collect()
        };
        let (in_a, in_b) = (places(self), places(b));
        let first_of = |x: &Hyper<N>, i: Option<usize>| i.map_or(zero, |i| x.first[i]);
        let first: Vec<N> =
            (0..active.len()).map(|i| f.a * first_of(self, in_a[i]) + f.b * first_of(b, in_b[i])).collect();
        let mut second = Vec::new();
        if !self.second.is_empty() || !b.second.is_empty() {
            second.reserve(active.len() * (active.len() + 1) / 2);
            for i in 0..active.len() {
                for j in i..active.len() {
                    let (ai, aj) = (first_of(self, in_a[i]), first_of(self, in_a[j]));
                    let (bi, bj) = (first_of(b, in_b[i]), first_of(b, in_b[j]));
                    let own = f.a * self.second_at(in_a[i], in_a[j]) + f.b * b.second_at(in_b[i], in_b[j]);
                    second.push(own + f.aa * (ai * aj) + f.bb * (bi * bj) + f.ab * (ai * bj + aj * bi));
                }
            }
        }
        Hyper { value: f.value, active, first, second }
    }

    fn second_at(&self, i: Option<usize>, j: Option<usize>) -> N {
        match (i, j) {
            (Some(i), Some(j)) if !self.second.is_empty() => {
                let n = self.first.len();
                self.second[i * n - i * (i + 1) / 2 + j]
            }
            _ => N::from(0.0),
        }
    }

    /// ∂/∂u.
    pub fn gradient(&self, u: u16) -> N {
        self.active.binary_search(&u).map_or(N::from(0.0), |i| self.first[i])
    }

    /// ∂²/∂u∂v, u ≤ v.
    pub fn hessian(&self, u: u16, v: u16) -> N {
        self.second_at(self.active.binary_search(&u).ok(), self.active.binary_search(&v).ok())
    }

    pub fn add(&self, b: &Hyper<N>) -> Hyper<N> {
        let (one, zero) = (N::from(1.0), N::from(0.0));
        self.binary(b, &Two { value: self.value + b.value, a: one, b: one, aa: zero, ab: zero, bb: zero })
    }

    pub fn scaled(&self, by: f64) -> Hyper<N> {
        let by = N::from(by);
        self.unary((by * self.value, by, N::from(0.0)))
    }

    pub fn mul(&self, b: &Hyper<N>) -> Hyper<N> {
        let (one, zero) = (N::from(1.0), N::from(0.0));
        self.binary(b, &Two { value: self.value * b.value, a: b.value, b: self.value, aa: zero, ab: one, bb: zero })
    }

    /// The whole power n ≠ 0.
    pub fn power(&self, n: i32) -> Hyper<N> {
        if n == 1 {
            return self.clone();
        }
        let whole = |exponent: i32| -> N {
            let (mut square, mut power, mut left) = (self.value, N::from(1.0), exponent.unsigned_abs());
            while left > 0 {
                power = if left & 1 == 1 { power * square } else { power };
                square = square * square;
                left >>= 1;
            }
            if exponent < 0 { N::from(1.0) / power } else { power }
        };
        let (first, second) = (f64::from(n), f64::from(n) * (f64::from(n) - 1.0));
        let (slope, bend) = (whole(n.saturating_sub(1)), whole(n.saturating_sub(2)));
        self.unary((whole(n), N::from(first) * slope, N::from(second) * bend))
    }

    pub fn sqrt(&self) -> Hyper<N> {
        let root = self.value.sqrt();
        let slope = N::from(0.5) / root;
        self.unary((root, slope, -(slope / (N::from(2.0) * self.value))))
    }
}

/// How far to differentiate.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Order {
    First,
    Second,
}

#[derive(Clone)]
enum Cell<N> {
    Number(Hyper<N>),
    Truth(bool),
}

/// Evaluates `roots` again and again at changing pixels; what is known per pass is worked out once.
pub(crate) struct Evaluator<'a, N> {
    graph: &'a Graph,
    roots: &'a [NodeId],
    order: Order,
    variables: FxHashMap<NodeId, u16>,
    /// By node.
    cells: Vec<Cell<N>>,
    inner: Vec<NodeId>,
}

impl<'a, N: Number> Evaluator<'a, N> {
    /// `variables` are the nodes to differentiate by; `leaf` gives inputs.
    pub fn new(
        graph: &'a Graph,
        roots: &'a [NodeId],
        variables: &[NodeId],
        order: Order,
        leaf: &dyn Fn(&Node) -> N,
    ) -> Evaluator<'a, N> {
        let variables = variables.iter().enumerate().map(|(i, node)| (*node, i as u16)).collect();
        let (outer, inner): (Vec<_>, Vec<_>) =
            graph.reachable(roots).into_iter().partition(|node| graph.level(*node) == Level::Pass);
        let cells = vec![Cell::Truth(false); graph.len()];
        let mut evaluator = Evaluator { graph, roots, order, variables, cells, inner };
        outer.into_iter().for_each(|node| evaluator.work_out(node, leaf));
        evaluator
    }

    /// The roots at one pixel; `leaf` gives coordinates and channels.
    pub fn at(&mut self, leaf: &dyn Fn(&Node) -> N) -> Vec<Hyper<N>> {
        self.step(leaf);
        self.roots.iter().map(|root| self.number(*root).clone()).collect()
    }

    /// The first root, a truth value, at one pixel.
    pub fn holds_at(&mut self, leaf: &dyn Fn(&Node) -> N) -> bool {
        self.step(leaf);
        self.roots.first().is_some_and(|root| self.truth(*root))
    }

    fn step(&mut self, leaf: &dyn Fn(&Node) -> N) {
        for i in 0..self.inner.len() {
            self.work_out(self.inner[i], leaf);
        }
    }

    fn number(&self, node: NodeId) -> &Hyper<N> {
        match &self.cells[node.index()] {
            Cell::Number(number) => number,
            Cell::Truth(_) => unreachable!("the elaborator keeps truth values and numbers apart"),
        }
    }

    fn truth(&self, node: NodeId) -> bool {
        matches!(self.cells[node.index()], Cell::Truth(true))
    }

    fn work_out(&mut self, id: NodeId, leaf: &dyn Fn(&Node) -> N) {
        let at = |n: &NodeId| self.number(*n);
        let cell = Cell::Number(match self.graph.node(id) {
            Node::Number(bits) => Hyper::fixed(N::from(bits.get())),
            node @ (Node::Input(_) | Node::Coordinate(_) | Node::Channel(_)) => match self.variables.get(&id) {
                Some(variable) => Hyper::variable(leaf(node), *variable, self.order),
                None => Hyper::fixed(leaf(node)),
            },
            Node::Sum(constant, terms) => {
                let constant = Hyper::fixed(N::from(constant.get()));
                terms.iter().fold(constant, |sum, (n, c)| sum.add(&at(n).scaled(c.get())))
            }
            Node::Product(factors) => {
                let mut powers = factors.iter().map(|(n, e)| at(n).power(*e));
                let first = powers.next().unwrap_or_else(|| Hyper::fixed(N::from(1.0)));
                powers.fold(first, |product, power| product.mul(&power))
            }
            Node::Sqrt(a) => at(a).sqrt(),
            Node::Abs(a) => {
                let a = at(a);
                a.scaled(if a.value < N::from(0.0) { -1.0 } else { 1.0 })
            }
            Node::Call1(f, a) => at(a).unary(derivatives(*f, at(a).value)),
            Node::Call2(f, a, b) => at(a).binary(at(b), &derivatives2(*f, at(a).value, at(b).value)),
            Node::Select(c, a, b) => at(if self.truth(*c) { a } else { b }).clone(),
            Node::Compare(comparison, a, b) => {
                let holds = holds(*comparison, at(a).value, at(b).value);
                self.cells[id.index()] = Cell::Truth(holds);
                return;
            }
            Node::And(a, b) | Node::Or(a, b) => {
                let (a, b) = (self.truth(*a), self.truth(*b));
                let both = matches!(self.graph.node(id), Node::And(..));
                self.cells[id.index()] = Cell::Truth(if both { a && b } else { a || b });
                return;
            }
            Node::Not(a) => {
                let not = !self.truth(*a);
                self.cells[id.index()] = Cell::Truth(not);
                return;
            }
        });
        self.cells[id.index()] = cell;
    }
}
