//! Values in the range of f32: growth of a node, and quotients of exponentials that stay finite far from a target.

use isophote_elementary::{Function1, Function2};
use smallvec::{SmallVec, smallvec};

use super::{Graph, Node, NodeId, merge, operands};

impl Graph {
    /// See [`Graph::growth`].
    pub(super) fn growth_of(&self, node: &Node) -> u8 {
        let largest = || operands(node).map(|n| self.growth(n)).max().unwrap_or(0);
        match node {
            Node::Coordinate(_) | Node::Channel(_) => 1,
            Node::Product(factors) => {
                let degree = |(n, e): &(NodeId, i32)| i64::from(self.growth(*n)) * i64::from(*e);
                factors.iter().map(degree).sum::<i64>().unsigned_abs().min(u8::MAX.into()) as u8
            }
            Node::Sqrt(a) => self.growth(*a).div_ceil(2),
            Node::Call1(Function1::Exp, a) if self.falls(*a) => 0,
            Node::Call1(Function1::Exp | Function1::Sinh | Function1::Cosh, _) if largest() > 0 => u8::MAX,
            Node::Call2(Function2::Pow, _, exponent) if self.growth(*exponent) > 0 => u8::MAX,
            // The exponent is a number of the document or a parameter.
            Node::Call2(Function2::Pow, base, exponent) => {
                let times = self.value_of(*exponent).map_or(4.0, f64::abs);
                (f64::from(self.growth(*base)) * times).ceil() as u8
            }
            Node::Call1(Function1::Log | Function1::LogVariance | Function1::LogTail | Function1::Hazard, _) => {
                largest().min(2)
            }
            Node::Call1(..) | Node::Call2(..) | Node::Gather(..) => 0,
            _ => largest(),
        }
    }

    /// True when the value falls in all directions, judged by degree: the largest degree is even, and each of its terms
    /// is subtracted. A quadratic form is taken to be positive.
    fn falls(&self, id: NodeId) -> bool {
        let degree = self.growth(id);
        let Node::Sum(_, terms) = self.node(id) else { return false };
        degree > 0 && degree.is_multiple_of(2) && terms.iter().all(|(n, c)| self.growth(*n) < degree || c.get() < 0.0)
    }

    /// Rewrites eⁿ/(A + P e)ⁿ as 1/(P + A/e)ⁿ, where e is exp(u) or 1/exp(u). Far from the target e may be infinite
    /// while the quotient, such as a slope of a logistic curve, is 1/P.
    pub(super) fn divide_exponential(&mut self, factors: &mut Vec<(NodeId, i32)>) {
        let is_exponential = |graph: &Graph, n: NodeId| {
            graph.growth(n) == u8::MAX && matches!(graph.node(n), Node::Call1(Function1::Exp, _))
        };
        let found = factors.iter().enumerate().find_map(|(over, (e, n))| {
            let divides = |(d, m): &(NodeId, i32)| *m < 0 && self.is_linear_in(*d, *e, n.signum());
            let under = is_exponential(self, *e).then(|| factors.iter().position(divides));
            Some((over, under??))
        });
        let Some((over, under)) = found else { return };
        let ((e, n), (sum, m)) = (factors[over], factors[under]);
        let (sign, times) = (n.signum(), n.abs().min(-m));
        let Node::Sum(constant, terms) = self.node(sum).clone() else { return };
        self.charge(terms.len());
        let mut divided: SmallVec<[(NodeId, f64); 8]> = smallvec![];
        for (term, coefficient) in terms.iter().map(|(term, c)| (*term, c.get())) {
            divided.push((self.product(1.0, [(term, 1), (e, -sign)]), coefficient));
        }
        divided.push((self.product(1.0, [(e, -sign)]), constant.get()));
        let divided = self.sum(0.0, divided);
        factors[over].1 -= sign * times;
        factors[under].1 += times;
        factors.push((divided, -times));
        merge(factors, i32::saturating_add);
        factors.retain(|(_, exponent)| *exponent != 0);
    }

    /// True when exactly one term of the sum has this power of an exponential as a factor, and no other grows
    /// exponentially.
    fn is_linear_in(&self, sum: NodeId, exponential: NodeId, sign: i32) -> bool {
        let Node::Sum(_, terms) = self.node(sum) else { return false };
        let power = |term: NodeId| match self.node(term) {
            _ if term == exponential => 1,
            Node::Product(factors) => factors.iter().find(|(n, _)| *n == exponential).map_or(0, |(_, e)| *e),
            _ => 0,
        };
        let is_flat = |term: &NodeId| power(*term) == sign || self.growth(*term) < u8::MAX;
        let powers = terms.iter().filter(|(term, _)| power(*term) == sign).count();
        powers == 1 && !self.is_opaque(sum) && terms.iter().all(|(term, _)| is_flat(term))
    }
}
