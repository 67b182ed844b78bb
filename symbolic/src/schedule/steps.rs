//! Computes one node of the graph from others: Horner for sums, shared powers for products, one reciprocal a
//! denominator. Operands known earlier in the loop nest are grouped, so that they leave the inner loop.

use rustc_hash::FxHashMap;
use smallvec::{SmallVec, smallvec};

use crate::graph::{Bits, Graph, Node, NodeId, Powers};
use crate::program::{CoordinateId, Level, Op, Opcode};
use crate::schedule::Builder;

type Operands = SmallVec<[NodeId; 3]>;
type Terms = SmallVec<[(NodeId, f64); 8]>;

/// Maximum number of terms that are added one after another.
const LONG: usize = 64;
/// Degree at which a numerator or denominator may leave the range of f32 in a picture some thousand pixels wide.
const STEEP: u32 = 20;

/// The operation that computes one node from others.
pub(crate) enum Step {
    Leaf(Op),
    Of(Opcode, Operands),
    /// a · b + c
    MulAdd(NodeId, NodeId, NodeId),
}

impl Step {
    fn of<const N: usize>(code: Opcode, operands: [NodeId; N]) -> Step {
        Step::Of(code, SmallVec::from_slice(&operands))
    }

    pub fn operands(&self) -> Operands {
        match self {
            Step::Leaf(_) => smallvec![],
            Step::Of(_, operands) => operands.clone(),
            Step::MulAdd(a, b, c) => smallvec![*a, *b, *c],
        }
    }
}

impl Builder<'_> {
    pub fn step(&mut self, node: NodeId) -> Step {
        match self.graph.node(node).clone() {
            Node::Number(bits) => Step::Leaf(Opcode::number(bits.get()).of([])),
            Node::Input(input) => {
                let value = self.input(input);
                Step::Leaf(self.instructions[value.index()].op)
            }
            Node::Coordinate(CoordinateId(0)) => Step::of(Opcode::Offset, [self.graph.number(0.0)]),
            Node::Coordinate(c) => Step::Leaf(Opcode::Outer(c).of([])),
            Node::Channel(c) => Step::Leaf(Opcode::Channel(c).of([])),
            Node::Sum(constant, terms) => self.sum(node, constant.get(), &terms),
            Node::Product(factors) => self.product(node, &factors),
            Node::Sqrt(a) => Step::of(Opcode::Sqrt, [a]),
            Node::Abs(a) => Step::of(Opcode::Abs, [a]),
            Node::Call1(f, a) => Step::of(Opcode::Call1(f), [a]),
            Node::Call2(f, a, b) => Step::of(Opcode::Call2(f), [a, b]),
            Node::Gather(lookup, a, b) => Step::of(Opcode::Gather(lookup), [a, b]),
            Node::Compare(c, a, b) => Step::of(Opcode::Compare(c), [a, b]),
            Node::And(a, b) => Step::of(Opcode::And, [a, b]),
            Node::Or(a, b) => Step::of(Opcode::Or, [a, b]),
            Node::Not(a) => Step::of(Opcode::Not, [a]),
            Node::Select(c, a, b) => Step::of(Opcode::Select, [c, a, b]),
        }
    }

    fn sum(&mut self, node: NodeId, constant: f64, terms: &[(NodeId, Bits)]) -> Step {
        let has_factor = !self.apart.contains(&node);
        let level = terms.iter().map(|(n, _)| self.graph.level(*n)).max().unwrap_or(Level::Pass);
        let all = terms.iter().map(|(n, c)| (*n, c.get()));
        let (high, low): (Terms, Terms) = all.partition(|(n, _)| self.graph.level(*n) == level);
        let rest = (constant != 0.0 || !low.is_empty()).then(|| self.graph.sum(constant, low.iter().copied()));
        if let Some(step) = self.equally_scaled(&high, rest, level) {
            return step;
        }
        // The inner coordinate plus an earlier value.
        if let [(node, coefficient)] = high[..]
            && matches!(self.graph.node(node), Node::Coordinate(CoordinateId(0)))
            && coefficient.abs() == 1.0
        {
            let rest = rest.unwrap_or_else(|| self.graph.number(0.0));
            if coefficient == 1.0 {
                return Step::of(Opcode::Offset, [rest]);
            }
            // c − x = −(x − c)
            let rest = self.graph.scale(-1.0, rest);
            let flipped = self.graph.sum(0.0, [(node, 1.0), (rest, 1.0)]);
            return Step::of(Opcode::Neg, [flipped]);
        }
        if let Some(rest) = rest {
            if let [(node, coefficient)] = high[..] {
                return self.term_plus(node, coefficient, rest);
            }
            return match has_factor.then(|| self.common_factor(&high, level)).flatten() {
                Some(factor) => {
                    let (inside, outside) = self.divide(&high, factor);
                    if outside.is_empty() {
                        let inside = self.graph.sum(0.0, inside);
                        Step::MulAdd(inside, factor, rest)
                    } else {
                        let inside = self.graph.sum(0.0, inside);
                        let outside = self.graph.sum(0.0, outside.into_iter().chain([(rest, 1.0)]));
                        Step::MulAdd(inside, factor, outside)
                    }
                }
                None => self.chain(&high, Some(rest)),
            };
        }
        if let [(node, coefficient)] = high[..] {
            return self.scaled(node, coefficient);
        }
        match has_factor.then(|| self.common_factor(&high, level)).flatten() {
            Some(factor) => {
                let (inside, outside) = self.divide(&high, factor);
                let inside = self.graph.sum(0.0, inside);
                if outside.is_empty() {
                    return Step::of(Opcode::Mul, [inside, factor]);
                }
                let outside = self.graph.sum(0.0, outside);
                Step::MulAdd(inside, factor, outside)
            }
            None => self.chain(&high, None),
        }
    }

    /// c · a + c · b + … as c · (a + b) + …, where c is known earlier: the factor that most terms have.
    fn equally_scaled(&mut self, terms: &[(NodeId, f64)], rest: Option<NodeId>, level: Level) -> Option<Step> {
        // Products of several values are left to `common_factor`.
        let mut scales: SmallVec<[(f64, Powers, Option<NodeId>); 8]> = SmallVec::new();
        for (node, coefficient) in terms {
            let (high, low): (Powers, Powers) = match self.graph.node(*node) {
                Node::Product(factors) if self.is_plain_product(*node) => {
                    factors.iter().copied().partition(|(n, _)| self.graph.level(*n) == level)
                }
                _ => (Powers::from_slice(&[(*node, 1)]), Powers::new()),
            };
            match high[..] {
                [(high, 1)] => scales.push((*coefficient, low, Some(high))),
                _ => scales.push((1.0, Powers::new(), None)),
            }
        }
        self.graph.charge(terms.len());
        let mut counts = FxHashMap::<(u64, &[(NodeId, i32)]), usize>::default();
        for (c, low, _) in &scales {
            *counts.entry((c.to_bits(), low)).or_default() += 1;
        }
        let alike = |(c, low, _): &(f64, Powers, Option<NodeId>)| counts[&(c.to_bits(), &low[..])];
        let is_factor = |(c, low, _): &&(f64, Powers, Option<NodeId>)| c.abs() != 1.0 || !low.is_empty();
        let best = scales.iter().filter(is_factor).max_by_key(|scale| alike(scale)).filter(|scale| alike(scale) > 1)?;
        let (coefficient, low, _) = best.clone();
        let has_scale = |(c, other, _): &(f64, Powers, Option<NodeId>)| *c == coefficient && *other == low;
        let inside: Terms =
            scales.iter().filter(|scale| has_scale(scale)).filter_map(|(.., high)| Some(((*high)?, 1.0))).collect();
        let scale = self.graph.product(coefficient, low.iter().copied());
        let inside = self.graph.sum(0.0, inside);
        let outside = terms.iter().zip(&scales).filter(|(_, scale)| !has_scale(scale)).map(|(term, _)| *term);
        let outside: Terms = outside.chain(rest.map(|rest| (rest, 1.0))).collect();
        if outside.is_empty() {
            return Some(Step::of(Opcode::Mul, [scale, inside]));
        }
        let outside = self.graph.sum(0.0, outside);
        Some(Step::MulAdd(scale, inside, outside))
    }

    /// coefficient · node + rest, as a · b + rest for a product.
    fn term_plus(&mut self, node: NodeId, coefficient: f64, rest: NodeId) -> Step {
        if coefficient == 1.0 && !self.is_plain_product(node) {
            return Step::of(Opcode::Add, [node, rest]);
        }
        if coefficient == -1.0 && !self.is_plain_product(node) {
            return Step::of(Opcode::Sub, [rest, node]);
        }
        match self.two_factors(node, coefficient) {
            Some((a, b)) => Step::MulAdd(a, b, rest),
            None => {
                let coefficient = self.graph.number(coefficient);
                Step::MulAdd(coefficient, node, rest)
            }
        }
    }

    fn is_plain_product(&self, node: NodeId) -> bool {
        !self.values.contains_key(&node)
            && matches!(self.graph.node(node), Node::Product(_))
            && !self.wanted.contains(&node)
    }

    /// coefficient · node as two factors, the coefficient with the factors known earlier.
    fn two_factors(&mut self, node: NodeId, coefficient: f64) -> Option<(NodeId, NodeId)> {
        if !self.is_plain_product(node) {
            return None;
        }
        let Node::Product(factors) = self.graph.node(node).clone() else { return None };
        let level = self.graph.level(node);
        let (high, low) = self.divided(&factors, level);
        if !low.is_empty() {
            let low = self.graph.product(coefficient, low);
            let high = self.graph.product(1.0, high);
            return Some((low, high));
        }
        if coefficient.abs() != 1.0 {
            return None;
        }
        match self.product(node, &factors) {
            Step::Of(_, factors_of) if coefficient == 1.0 && !factors.iter().any(|(_, e)| *e < 0) => {
                match factors_of[..] {
                    [a, b] => Some((a, b)),
                    _ => None,
                }
            }
            _ => None,
        }
    }

    /// Factors of `level`, and those known earlier; shared powers of reciprocals are grouped with the latter.
    fn divided(&mut self, factors: &[(NodeId, i32)], level: Level) -> (Powers, Powers) {
        let (high, low): (Powers, Powers) = factors.iter().copied().partition(|(n, _)| self.graph.level(*n) == level);
        if self.is_steep(&high) {
            return (high, low);
        }
        let (over, under): (Powers, Powers) = high.iter().copied().partition(|(_, e)| *e > 0);
        let is_shared = under.len() > 1 || under.iter().any(|(_, e)| *e < -1);
        if level < Level::Pixel || over.is_empty() || under.is_empty() || !is_shared || self.is_begun(&high) {
            return (high, low);
        }
        (over, low.into_iter().chain(under).collect())
    }

    /// True when numerator and denominator may each overflow or underflow where their quotient does not.
    fn is_steep(&self, factors: &[(NodeId, i32)]) -> bool {
        let degree = |sign: i32| -> u32 {
            let own = factors.iter().filter(|(_, e)| e.signum() == sign);
            own.map(|(n, e)| u32::from(self.graph.growth(*n)).saturating_mul(e.unsigned_abs()))
                .fold(0, u32::saturating_add)
        };
        degree(1) >= STEEP && degree(-1) >= STEEP
    }

    /// A steep product as two factors, each with about as much of the numerator as of the denominator.
    fn balanced(&mut self, factors: &[(NodeId, i32)]) -> (NodeId, NodeId) {
        if factors.iter().all(|(_, e)| e % 2 == 0) {
            let root = self.graph.product(1.0, factors.iter().map(|(n, e)| (*n, e / 2)).collect::<Powers>());
            return (root, root);
        }
        let steepest = |sign: i32| {
            let own = factors.iter().filter(|(_, e)| e.signum() == sign);
            own.max_by_key(|(n, _)| (self.graph.growth(*n), *n)).copied()
        };
        let (Some((over, most)), Some((under, _))) = (steepest(1), steepest(-1)) else {
            return (self.graph.product(1.0, factors.iter().copied()), self.graph.number(1.0));
        };
        let times = self.graph.growth(under) / self.graph.growth(over).max(1);
        let times = i32::from(times).clamp(1, most);
        let quotient = self.graph.product(1.0, [(over, times), (under, -1)]);
        let rest = self.graph.product(1.0, factors.iter().copied().chain([(over, -times), (under, 1)]));
        match self.graph.value_of(rest) {
            Some(_) => (self.graph.product(1.0, [(over, times)]), self.graph.product(1.0, [(under, -1)])),
            None => (quotient, rest),
        }
    }

    /// True when this product exists already, or one with one factor less.
    fn is_begun(&mut self, factors: &[(NodeId, i32)]) -> bool {
        let less = (0..factors.len()).map(Some).chain([None]);
        less.into_iter().any(|i| {
            let one = i.map(|i| (factors[i].0, -factors[i].1.signum()));
            let product = self.graph.product(1.0, factors.iter().copied().chain(one));
            self.values.contains_key(&product) || self.wanted.contains(&product)
        })
    }

    fn scaled(&mut self, node: NodeId, coefficient: f64) -> Step {
        if coefficient == -1.0 {
            return Step::of(Opcode::Neg, [node]);
        }
        if coefficient != 1.0
            && let Some((a, b)) = self.two_factors(node, coefficient)
        {
            return Step::of(Opcode::Mul, [a, b]);
        }
        let coefficient = self.graph.number(coefficient);
        Step::of(Opcode::Mul, [coefficient, node])
    }

    /// The factor at `level` that most of the terms share, at least two.
    fn common_factor(&self, terms: &[(NodeId, f64)], level: Level) -> Option<NodeId> {
        let mut found: SmallVec<[(NodeId, i32); 16]> = SmallVec::new();
        for (node, _) in terms {
            match self.graph.node(*node) {
                // A steep product stays with its denominator.
                Node::Product(factors) if !self.graph.is_opaque(*node) && !self.is_steep(factors) => {
                    found.extend(factors.iter().copied().filter(|(n, e)| *e > 0 && self.graph.level(*n) == level));
                }
                _ => found.push((*node, 1)),
            }
        }
        found.sort_unstable_by_key(|(n, _)| *n);
        let alike = found.chunk_by(|a, b| a.0 == b.0).filter(|alike| alike.len() > 1);
        let most = alike.max_by_key(|alike| (alike.len(), alike.iter().map(|(_, e)| e).sum::<i32>(), alike[0].0));
        most.map(|alike| alike[0].0)
    }

    /// The terms with the factor, divided by it once, and the others.
    fn divide(&mut self, terms: &[(NodeId, f64)], factor: NodeId) -> (Terms, Terms) {
        let (mut inside, mut outside) = (Terms::new(), Terms::new());
        for (node, coefficient) in terms {
            let divided = match self.graph.node(*node).clone() {
                _ if *node == factor => Some(self.graph.number(1.0)),
                Node::Product(factors)
                    if !self.graph.is_opaque(*node)
                        && !self.is_steep(&factors)
                        && factors.iter().any(|(n, e)| *n == factor && *e > 0) =>
                {
                    Some(self.graph.product(1.0, factors.iter().copied().chain([(factor, -1)])))
                }
                _ => None,
            };
            match divided {
                Some(node) => inside.push((node, *coefficient)),
                None => outside.push((*node, *coefficient)),
            }
        }
        (inside, outside)
    }

    /// One term plus the sum of the others; a positive term comes first, products last (they contract).
    /// No two terms share a factor, so neither do the remaining ones.
    /// Many terms become the sum of two halves, so that the work does not grow with the square of their number.
    fn chain(&mut self, terms: &[(NodeId, f64)], rest: Option<NodeId>) -> Step {
        if terms.len() > LONG {
            let (first, last) = terms.split_at(terms.len() / 2);
            let first = first.iter().copied().chain(rest.map(|rest| (rest, 1.0)));
            let halves = [self.graph.sum(0.0, first), self.graph.sum(0.0, last.iter().copied())];
            return Step::of(Opcode::Add, halves);
        }
        let at = terms.iter().rposition(|(n, c)| self.is_plain_product(*n) && *c > 0.0);
        let at = at.or_else(|| terms.iter().rposition(|(n, _)| self.is_plain_product(*n))).unwrap_or(terms.len() - 1);
        let (node, coefficient) = terms[at];
        let others: Terms =
            terms.iter().enumerate().filter(|(i, _)| *i != at).map(|(_, t)| *t).chain(rest.map(|r| (r, 1.0))).collect();
        let is_negative = coefficient == 1.0 && others.iter().all(|(_, c)| *c < 0.0);
        let sign = if is_negative { -1.0 } else { 1.0 };
        let left = terms.len() - 1;
        let others = self.graph.sum(0.0, others.into_iter().map(|(n, c)| (n, sign * c)));
        // A sum flattened into the others brings factors of its own.
        if left > 1 && self.graph.operand_count(others) == left + usize::from(rest.is_some()) {
            self.apart.insert(others);
        }
        match is_negative {
            true => Step::of(Opcode::Sub, [node, others]),
            false => self.term_plus(node, coefficient, others),
        }
    }

    fn product(&mut self, node: NodeId, factors: &[(NodeId, i32)]) -> Step {
        let level = self.graph.level(node);
        let (high, low) = self.divided(factors, level);
        if !low.is_empty() {
            let (low, high) = (self.graph.product(1.0, low), self.graph.product(1.0, high));
            return Step::of(Opcode::Mul, [low, high]);
        }
        if let [(base, exponent)] = high[..] {
            let one = self.graph.number(1.0);
            return match exponent {
                -1 => Step::of(Opcode::Div, [one, base]),
                e if e < 0 => {
                    let reciprocal = self.graph.product(1.0, [(base, -1)]);
                    let (a, b) = self.halves(reciprocal, -e);
                    Step::of(Opcode::Mul, [a, b])
                }
                e => {
                    let (a, b) = self.halves(base, e);
                    Step::of(Opcode::Mul, [a, b])
                }
            };
        }
        if self.is_steep(&high) {
            let (a, b) = self.balanced(&high);
            return Step::of(Opcode::Mul, [a, b]);
        }
        // An existing product times one factor; else lowers the highest power by one.
        let one_less = |graph: &mut Graph, i: usize| {
            let sign = high[i].1.signum();
            let smaller = graph.product(1.0, high.iter().copied().chain([(high[i].0, -sign)]));
            let factor = graph.product(1.0, [(high[i].0, sign)]);
            (smaller, factor)
        };
        let mut choice = None;
        for (i, (_, exponent)) in high.iter().enumerate() {
            let (smaller, factor) = one_less(self.graph, i);
            let there = self.values.contains_key(&smaller) || self.wanted.contains(&smaller);
            if there && choice.is_none_or(|(_, _, e)| e < *exponent) {
                choice = Some((smaller, factor, *exponent));
            }
        }
        let (smaller, factor) = match choice {
            Some((smaller, factor, _)) => (smaller, factor),
            None => {
                let last =
                    (0..high.len()).max_by_key(|i| (high[*i].1.abs(), std::cmp::Reverse(high[*i].0))).unwrap_or(0);
                one_less(self.graph, last)
            }
        };
        Step::of(Opcode::Mul, [smaller, factor])
    }

    /// base^exponent as a product of two powers.
    fn halves(&mut self, base: NodeId, exponent: i32) -> (NodeId, NodeId) {
        // Powers of a reciprocal are products with negative exponents of its base; both halves stay canonical.
        let mut power = |e: i32| self.graph.product(1.0, [(base, e)]);
        if exponent % 2 == 0 { (power(exponent / 2), power(exponent / 2)) } else { (power(exponent - 1), power(1)) }
    }
}
