//! Random models: a tree that prints itself as a formula, and that knows its value without the code under test.

use std::fmt;

use isophote_elementary::{Function1, Function2};

use super::numbers::{Hyper, PARAMETERS, Scalar};
use crate::program::Comparison;
use crate::program::holds;
pub(crate) use crate::proof::points::Random;

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

/// No formula's part may be larger, nor its inverse.
const ORDINARY: f64 = 1e30;

type Boxed = Box<Tree>;

/// A formula.
#[derive(Clone, Debug)]
pub enum Tree {
    Number(f64),
    Coordinate(usize),
    /// The channel that is not fitted.
    Predictor,
    Parameter(usize),
    Constant,
    Definition(usize),
    /// The model's own prediction, in `noise`.
    Intensity,
    /// Of the user's functions.
    Argument,
    /// Of a sum or product.
    Index,
    Negative(Boxed),
    Add(Boxed, Boxed),
    Sub(Boxed, Boxed),
    Mul(Boxed, Boxed),
    Div(Boxed, Boxed),
    Whole(Boxed, i32),
    Real(Boxed, f64),
    Sqrt(Boxed),
    Abs(Boxed),
    /// True: the larger.
    Extreme(bool, Boxed, Boxed),
    /// `if` with one condition, `piecewise` with more.
    Choice(Vec<(Condition, Tree)>, Boxed),
    Call1(Function1, Boxed),
    /// `atan2(a, b)` or `a^b`.
    Call2(Function2, Boxed, Boxed),
    /// True: a product.
    Series(bool, Boxed, i32, i32),
    /// Of the user's functions, which one.
    Own(usize, Boxed),
    Dot(Vec<Tree>, Vec<Tree>),
    /// u′ A u with A symmetric: u₀, u₁, a₁, a₂, a₃.
    Form(Box<[Tree; 5]>),
    Entry(Vec<Tree>, usize),
}

#[derive(Clone, Debug)]
pub enum Condition {
    Compare(&'static str, Tree, Tree),
    And(Box<Condition>, Box<Condition>),
    Or(Box<Condition>, Box<Condition>),
    Not(Box<Condition>),
}

fn list(trees: &[Tree]) -> String {
    trees.iter().map(|tree| tree.to_string()).collect::<Vec<_>>().join(", ")
}

impl fmt::Display for Tree {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Tree::Number(x) if *x < 0.0 => write!(f, "({x})"),
            Tree::Number(x) => write!(f, "{x}"),
            Tree::Coordinate(i) => write!(f, "{}", ["x", "y"][*i]),
            Tree::Predictor => write!(f, "u"),
            Tree::Parameter(i) => write!(f, "p{i}"),
            Tree::Constant => write!(f, "k"),
            Tree::Definition(i) => write!(f, "d{i}"),
            Tree::Intensity => write!(f, "intensity"),
            Tree::Argument => write!(f, "t"),
            Tree::Index => write!(f, "i"),
            Tree::Negative(a) => write!(f, "(-{a})"),
            Tree::Add(a, b) => write!(f, "({a} + {b})"),
            Tree::Sub(a, b) => write!(f, "({a} - {b})"),
            Tree::Mul(a, b) => write!(f, "{a} * {b}"),
            Tree::Div(a, b) => write!(f, "({a} / ({b}))"),
            Tree::Whole(a, n) => write!(f, "({a})^{n}"),
            Tree::Real(a, c) => write!(f, "({a})^{c}"),
            Tree::Sqrt(a) => write!(f, "sqrt({a})"),
            Tree::Abs(a) => write!(f, "abs({a})"),
            Tree::Extreme(max, a, b) => write!(f, "{}({a}, {b})", if *max { "max" } else { "min" }),
            Tree::Choice(pairs, otherwise) => {
                write!(f, "{}(", if pairs.len() == 1 { "if" } else { "piecewise" })?;
                for (condition, value) in pairs {
                    write!(f, "{condition}, {value}, ")?;
                }
                write!(f, "{otherwise})")
            }
            Tree::Call1(function, a) => write!(f, "{}({a})", function.name()),
            Tree::Call2(Function2::Atan2, a, b) => write!(f, "atan2({a}, {b})"),
            Tree::Call2(Function2::Pow, a, b) => write!(f, "({a})^({b})"),
            Tree::Series(product, a, lo, hi) => {
                write!(f, "{}({a}, i, {lo}, {hi})", if *product { "product" } else { "sum" })
            }
            Tree::Own(g, a) => write!(f, "g{g}({a})"),
            Tree::Dot(a, b) => write!(f, "([{}]' * [{}])", list(a), list(b)),
            Tree::Form(parts) => {
                let [u, v, a, b, c] = &**parts;
                write!(f, "([{u}, {v}]' * [[{a}, {b}], [{b}, {c}]] * [{u}, {v}])")
            }
            Tree::Entry(all, i) => write!(f, "[{}][{i}]", list(all)),
        }
    }
}

impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Condition::Compare(sign, a, b) => write!(f, "{a} {sign} {b}"),
            Condition::And(a, b) => write!(f, "({a} and {b})"),
            Condition::Or(a, b) => write!(f, "({a} or {b})"),
            Condition::Not(a) => write!(f, "(not ({a}))"),
        }
    }
}

/// What names mean at one pixel.
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
    /// A comparison that rounding may decide was met, or a value so large or small that its powers leave f64's range.
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
            // Both sides are looked at, so that an undecided one is seen.
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
        let is_small = size != N::from(0.0) && size < N::from(1.0 / ORDINARY);
        self.undecided.set(self.undecided.get() | (size > N::from(ORDINARY)) | is_small);
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
                if (a.value < b.value) == *max { b } else { a }
            }
            Tree::Choice(pairs, otherwise) => {
                let taken: Vec<bool> = pairs.iter().map(|(condition, _)| self.holds(condition)).collect();
                let first = taken.iter().position(|&taken| taken);
                self.value(first.map_or(otherwise, |i| &pairs[i].1))
            }
            Tree::Call1(function, a) => self.value(a).call1(*function),
            Tree::Call2(function, a, b) => {
                let (a, b) = (self.value(a), self.value(b));
                // At its cut the sign of a zero decides, and y − x is as good as −(x − y).
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

/// What a formula may use.
#[derive(Clone, Copy)]
pub struct Scope {
    pub coordinates: usize,
    pub parameters: usize,
    pub definitions: usize,
    pub functions: usize,
    pub predictor: bool,
    /// Inside of a user's function.
    pub argument: bool,
    /// Inside of a sum.
    pub index: bool,
}

impl Scope {
    fn leaf(&self, random: &mut Random) -> Tree {
        match random.below(16) {
            0..=3 => Tree::Coordinate(random.below(self.coordinates)),
            4 | 5 if self.argument => Tree::Argument,
            6 | 7 if self.index => Tree::Index,
            4 if self.predictor => Tree::Predictor,
            5 | 6 if self.definitions > 0 => Tree::Definition(random.below(self.definitions)),
            7 => Tree::Constant,
            8 | 9 => Tree::Number((random.between(-3.0, 6.0) * 100.0).round() / 100.0),
            _ => Tree::Parameter(random.below(self.parameters)),
        }
    }

    /// Above zero for any leaves: 0.3 + e², or e^…
    fn positive(&self, random: &mut Random, depth: usize) -> Tree {
        let inner = Box::new(self.tree(random, depth));
        match random.below(3) {
            0 => Tree::Call1(Function1::Exp, Box::new(Tree::Mul(Box::new(Tree::Number(-0.25)), inner))),
            _ => Tree::Add(Box::new(Tree::Number(0.3)), Box::new(Tree::Whole(inner, 2))),
        }
    }

    pub fn condition(&self, random: &mut Random, depth: usize) -> Condition {
        let sign = random.pick(&["<", "<=", ">", ">=", "<", "<=", ">", ">=", "==", "!="]);
        let compare = Condition::Compare(sign, self.tree(random, depth), self.tree(random, depth));
        match random.below(6) {
            0 => Condition::And(Box::new(compare), Box::new(self.condition(random, depth))),
            1 => Condition::Or(Box::new(compare), Box::new(self.condition(random, depth))),
            2 => Condition::Not(Box::new(compare)),
            _ => compare,
        }
    }

    /// A formula of at most about that depth.
    pub fn tree(&self, random: &mut Random, depth: usize) -> Tree {
        if depth == 0 || random.one_in(7) {
            return self.leaf(random);
        }
        let depth = depth - 1;
        let many = |random: &mut Random, n: usize| (0..n).map(|_| self.tree(random, depth.min(1))).collect::<Vec<_>>();
        let branch = |random: &mut Random| (self.condition(random, depth.min(1)), self.tree(random, depth));
        let kind = random.below(34);
        let mut sub = || Box::new(self.tree(random, depth));
        match kind {
            0..=3 => Tree::Add(sub(), sub()),
            4..=7 => Tree::Sub(sub(), sub()),
            8..=12 => Tree::Mul(sub(), sub()),
            13 => Tree::Div(sub(), sub()),
            14 => Tree::Div(sub(), Box::new(self.positive(random, depth))),
            15 | 16 => Tree::Whole(sub(), random.pick(&[2, 2, 2, 3, 4, -1, -2])),
            17 => Tree::Real(Box::new(self.positive(random, depth)), random.pick(&[0.5, 1.5, -0.5, 2.3, -1.7])),
            18 => Tree::Call2(Function2::Pow, Box::new(self.positive(random, depth)), Box::new(self.leaf(random))),
            19 => Tree::Sqrt(Box::new(self.positive(random, depth))),
            20 => Tree::Abs(sub()),
            21 => Tree::Extreme(random.one_in(2), Box::new(self.tree(random, depth)), Box::new(self.leaf(random))),
            22 => Tree::Choice(vec![branch(random)], Box::new(self.tree(random, depth))),
            23 => Tree::Choice(vec![branch(random), branch(random)], Box::new(self.tree(random, depth))),
            24 | 25 => Tree::Call1(random.pick(&Function1::ALL), Box::new(self.tree(random, depth))),
            26 => {
                let small = Box::new(Tree::Mul(Box::new(Tree::Number(0.15)), sub()));
                Tree::Call1(random.pick(&Function1::ALL), small)
            }
            27 => Tree::Call2(Function2::Atan2, sub(), sub()),
            28 if !self.index => {
                let inner = Scope { index: true, ..*self }.tree(random, depth);
                let lo = random.below(3) as i32;
                Tree::Series(random.one_in(4), Box::new(inner), lo, lo + random.below(3) as i32)
            }
            29 if self.functions > 0 => Tree::Own(random.below(self.functions), Box::new(self.tree(random, depth))),
            30 => Tree::Dot(many(random, 2), many(random, 2)),
            31 => Tree::Form(Box::new(std::array::from_fn(|_| self.tree(random, depth.min(1))))),
            32 => Tree::Entry(many(random, 3), random.below(3)),
            33 => Tree::Negative(sub()),
            _ => self.leaf(random),
        }
    }
}
