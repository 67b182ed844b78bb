//! Evaluates random formulas ([`super::grammar`]) at a pixel, independently of the code under test.

use isophote_elementary::Function2;

use super::grammar::{Condition, PARAMETERS, Tree};
use super::numbers::{Hyper, Scalar};
pub(crate) use crate::graph::random::Random;
use crate::program::Comparison;
use crate::program::holds;

impl Random {
    pub fn below(&mut self, n: usize) -> usize {
        (self.bits() % n as u64) as usize
    }
    pub fn between(&mut self, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }
    pub fn pick<T: Clone>(&mut self, all: &[T]) -> T {
        all[self.below(all.len())].clone()
    }
    pub fn one_in(&mut self, n: usize) -> bool {
        self.below(n) == 0
    }
}

/// The values of names at one pixel.
pub struct Place<'a, N> {
    pub coordinates: [f64; 2],
    pub predictor: f64,
    pub constant: f64,
    pub parameters: [Hyper<N>; PARAMETERS],
    pub definitions: &'a [Tree],
    pub functions: &'a [Tree],
    pub intensity: &'a Tree,
    pub argument: Option<Hyper<N>>,
    pub index: f64,
    /// Limit for every part of a formula, and for its inverse.
    pub ordinary: f64,
    /// Set by a comparison that rounding may decide, or by a value so large or small that its powers leave f64's range.
    pub undecided: &'a std::cell::Cell<bool>,
}

impl<N: Scalar> Place<'_, N> {
    fn holds(&self, condition: &Condition) -> bool {
        match condition {
            Condition::Compare(sign, a, b) => {
                let (a, b) = (self.value(a).value, self.value(b).value);
                self.decide(a, b);
                match *sign {
                    "<" => holds(Comparison::Lt, a, b),
                    "<=" => holds(Comparison::Le, a, b),
                    ">" => holds(Comparison::Lt, b, a),
                    ">=" => holds(Comparison::Le, b, a),
                    "==" => holds(Comparison::Eq, a, b),
                    _ => holds(Comparison::Ne, a, b),
                }
            }
            // Evaluates both sides, so that an undecided one shows.
            Condition::And(a, b) => self.holds(a) & self.holds(b),
            Condition::Or(a, b) => self.holds(a) | self.holds(b),
            Condition::Not(a) => !self.holds(a),
        }
    }

    fn decide(&self, a: N, b: N) {
        self.undecided.set(self.undecided.get() | a.is_near(b));
    }

    /// True where the condition holds.
    pub fn inside(&self, condition: &Condition) -> bool {
        self.holds(condition)
    }

    fn with_index(&self, index: i32) -> Self {
        Place { index: f64::from(index), ..*self }
    }

    /// The formula's value and derivatives.
    pub fn value(&self, tree: &Tree) -> Hyper<N> {
        let y = self.worked_out(tree);
        let size = y.value.abs();
        let is_small = size != N::from(0.0) && size < N::from(1.0 / self.ordinary);
        self.undecided.set(self.undecided.get() | (size > N::from(self.ordinary)) | is_small);
        y
    }

    fn worked_out(&self, tree: &Tree) -> Hyper<N> {
        let fixed = |x: f64| Hyper::fixed(N::from(x));
        let zero = N::from(0.0);
        let dot = |a: &[Tree], b: &[Tree]| {
            a.iter().zip(b).map(|(a, b)| self.value(a).mul(&self.value(b))).reduce(|a, b| a.add(&b)).unwrap()
        };
        match tree {
            Tree::Number(x) => fixed(*x),
            Tree::Coordinate(i) => fixed(self.coordinates[*i]),
            Tree::Predictor => fixed(self.predictor),
            Tree::Parameter(i) => self.parameters[*i],
            Tree::Constant => fixed(self.constant),
            Tree::Definition(i) => self.value(&self.definitions[*i]),
            Tree::Intensity => self.value(self.intensity),
            Tree::Argument => self.argument.unwrap(),
            Tree::Index => fixed(self.index),
            Tree::Negative(a) => self.value(a).scaled(-1.0),
            Tree::Add(a, b) => self.value(a).add(&self.value(b)),
            Tree::Sub(a, b) => self.value(a).sub(&self.value(b)),
            Tree::Mul(a, b) => self.value(a).mul(&self.value(b)),
            Tree::Div(a, b) => self.value(a).mul(&self.value(b).inverse()),
            Tree::Whole(a, n) => self.value(a).whole_power(*n),
            Tree::Real(a, c) => self.value(a).real_power(*c),
            Tree::Sqrt(a) => self.value(a).sqrt(),
            Tree::Abs(a) => {
                let a = self.value(a);
                self.decide(a.value, zero);
                if a.value < zero { a.scaled(-1.0) } else { a }
            }
            Tree::Extreme(max, a, b) => {
                let (a, b) = (self.value(a), self.value(b));
                self.decide(a.value, b.value);
                // Of NaN and a number, takes the number.
                let [is_a, is_b] = [&a, &b].map(|x| x.value.partial_cmp(&x.value).is_some());
                if is_b && (!is_a || (a.value < b.value) == *max) { b } else { a }
            }
            Tree::Choice(pairs, otherwise) => {
                let taken: Vec<bool> = pairs.iter().map(|(condition, _)| self.holds(condition)).collect();
                let first = taken.iter().position(|&taken| taken);
                self.value(first.map_or(otherwise, |i| &pairs[i].1))
            }
            Tree::Call1(function, a) => self.value(a).call1(*function),
            Tree::Call2(function, a, b) => {
                let (a, b) = (self.value(a), self.value(b));
                // At the cut the sign of a zero decides, and y − x may be evaluated as −(x − y).
                if *function == Function2::Atan2 && b.value < zero {
                    self.decide(a.value, zero);
                }
                a.call2(*function, &b)
            }
            Tree::Series(product, a, lo, hi) => {
                let terms = (*lo..=*hi).map(|i| self.with_index(i).value(a));
                terms.reduce(|a, b| if *product { a.mul(&b) } else { a.add(&b) }).unwrap()
            }
            Tree::Own(g, a) => {
                let argument = Some(self.value(a));
                Place { argument, ..*self }.value(&self.functions[*g])
            }
            Tree::Dot(a, b) => dot(a, b),
            Tree::Form(parts) => {
                let [u, v, a, b, c] = &**parts;
                let product = |factors: [&Tree; 3]| factors.map(|f| self.value(f)).into_iter().reduce(|a, b| a.mul(&b));
                let mixed = product([u, v, b]).unwrap().scaled(2.0);
                product([u, u, a]).unwrap().add(&mixed).add(&product([v, v, c]).unwrap())
            }
            Tree::Entry(all, i) => self.value(&all[*i]),
        }
    }
}
