//! Builds a pixel value's contribution to F from nodes for its residual r and its variance σ²: −2 ln of its
//! probability, without constants; for Gauss–Newton also L = dF/dr and the weight Q. Programs are checked against
//! [`Shape::direct`], the same in any arithmetic.
//! - a pixel below its limit: r²/σ² (and ln σ², which its users add), or a robust function ρ of r/σ;
//! - one at its limit, where r is the limit minus the intensity: −2 ln Q(r/σ), Q the upper tail of the normal
//!   distribution: light could not have been less (Tobin 1958); −2 ln[(1 − ε) Q + ε] where a share ε of all pixels is
//!   at the limit whatever the light.
//!
//! Gauss–Newton weighs the slopes of r² by ρ′/(2r), and those of −2 ln Q by the probability (1 − ε) Q/[(1 − ε) Q + ε]
//! that the pixel shows light: never negative (iteratively reweighted least squares).

use isophote_elementary::Function1;

use crate::graph::hyper::Order;
use crate::graph::jet::{Jet, jet};
use crate::graph::{Graph, NodeId};
use crate::likelihood::shape::{HOPELESS, Shape, bend};
use crate::model::Loss;
use crate::program::{Comparison, ConstantId, Input};

impl Shape {
    /// F without ln σ².
    pub fn value(self, graph: &mut Graph, residual: NodeId, variance: Option<NodeId>) -> NodeId {
        let factors = [(residual, 2)].into_iter().chain(variance.map(|v| (v, -1)));
        match self {
            Shape::Seen(Loss::Squares) => graph.product(1.0, factors),
            Shape::Seen(Loss::Tukey(c)) => {
                let square = graph.product(1.0, factors);
                let (inside, rest) = biweight(graph, square, c);
                let cube = graph.product(-c * c / 3.0, [(rest, 3)]);
                let near = graph.sum(c * c / 3.0, [(cube, 1.0)]);
                let far = graph.number(c * c / 3.0);
                graph.select(inside, near, far)
            }
            Shape::Seen(Loss::Huber(c)) => {
                let square = graph.product(1.0, factors);
                let inside = within(graph, square, c * c);
                let root = graph.sqrt(square);
                let far = graph.sum(-c * c, [(root, 2.0 * c)]);
                graph.select(inside, square, far)
            }
            Shape::Clipped(Loss::Squares, Some(defects)) => {
                let Odds { tail, light, defect, ratio, is_defect } = odds(graph, residual, variance, defects);
                let both = graph.sum(1.0, [(ratio, 1.0)]);
                let both = graph.call1(Function1::Log, both);
                let (near, far) =
                    (graph.sum(0.0, [(tail, -2.0), (light, -2.0), (both, -2.0)]), graph.scale(-2.0, defect));
                graph.select(is_defect, far, near)
            }
            Shape::Clipped(loss, _) => {
                let z = whitened(graph, residual, variance);
                let logarithm = graph.call1(Function1::LogTail, z);
                let near = graph.scale(-2.0, logarithm);
                let (c, far) = match loss {
                    Loss::Squares => return near,
                    Loss::Tukey(c) => (c, graph.number(bend(c).0)),
                    Loss::Huber(c) => {
                        let (value, slope) = bend(c);
                        (c, graph.sum(value - slope * c, [(z, slope)]))
                    }
                };
                let inside = within(graph, z, c);
                graph.select(inside, near, far)
            }
        }
    }

    /// F with ln σ², and F without it.
    pub fn full(self, graph: &mut Graph, residual: NodeId, variance: Option<NodeId>) -> [NodeId; 2] {
        let value = self.value(graph, residual, variance);
        let Some(v) = variance.filter(|_| self.has_logarithm()) else { return [value, value] };
        let logarithm = graph.call1(Function1::LogVariance, v);
        [graph.add2(value, logarithm), value]
    }

    /// F, and its first and second derivatives by r (and by σ² at second order).
    pub fn jet(self, graph: &mut Graph, order: Order, tops: &[NodeId], variance: Option<NodeId>) -> (NodeId, Jet) {
        let residual = tops[0];
        let value = self.value(graph, residual, variance);
        let total = if order == Order::Second { self.full(graph, residual, variance)[0] } else { value };
        let weighed = match self {
            Shape::Seen(loss) if order == Order::First => {
                robust_weight(graph, loss, residual, variance).map(|weight| (weight, Shape::Seen(Loss::Squares)))
            }
            Shape::Clipped(Loss::Squares, Some(defects)) if order == Order::First => {
                let Odds { ratio, is_defect, .. } = odds(graph, residual, variance, defects);
                let both = graph.sum(1.0, [(ratio, 1.0)]);
                let (far, near) = (graph.number(0.0), graph.product(1.0, [(both, -1)]));
                Some((graph.select(is_defect, far, near), Shape::Clipped(Loss::Squares, None)))
            }
            _ => None,
        };
        let Some((weight, plain)) = weighed else {
            let top = jet(graph, total, &tops.iter().copied().collect(), Order::Second);
            return (total, top);
        };
        let plain = plain.value(graph, residual, variance);
        let mut top = jet(graph, plain, &[residual].into(), Order::Second);
        top.first.values_mut().chain(top.second.values_mut()).for_each(|slope| *slope = graph.mul(weight, *slope));
        (total, top)
    }
}

/// The odds that a pixel at its limit is a defect.
struct Odds {
    /// ln Q
    tail: NodeId,
    /// ln (1 − ε) and ln ε
    light: NodeId,
    defect: NodeId,
    /// ε/[(1 − ε) Q]
    ratio: NodeId,
    /// ln of that ratio is at least [`HOPELESS`]: only there may the ratio overflow.
    is_defect: NodeId,
}

fn odds(graph: &mut Graph, residual: NodeId, variance: Option<NodeId>, defects: ConstantId) -> Odds {
    let z = whitened(graph, residual, variance);
    let share = graph.input(Input::Constant(defects));
    let rest = graph.sum(1.0, [(share, -1.0)]);
    let [tail, light, defect] = [(Function1::LogTail, z), (Function1::Log, rest), (Function1::Log, share)]
        .map(|(function, argument)| graph.call1(function, argument));
    let odds = graph.sum(0.0, [(defect, 1.0), (light, -1.0), (tail, -1.0)]);
    let hopeless = graph.number(HOPELESS);
    let is_defect = graph.compare(Comparison::Le, hopeless, odds);
    Odds { tail, light, defect, ratio: graph.call1(Function1::Exp, odds), is_defect }
}

/// r/σ.
fn whitened(graph: &mut Graph, residual: NodeId, variance: Option<NodeId>) -> NodeId {
    match variance {
        None => residual,
        Some(v) => {
            let deviation = graph.sqrt(v);
            graph.div(residual, deviation)
        }
    }
}

/// value < limit.
fn within(graph: &mut Graph, value: NodeId, limit: f64) -> NodeId {
    let limit = graph.number(limit);
    graph.compare(Comparison::Lt, value, limit)
}

/// w < c², and 1 − w/c².
fn biweight(graph: &mut Graph, square: NodeId, c: f64) -> (NodeId, NodeId) {
    (within(graph, square, c * c), graph.sum(1.0, [(square, -1.0 / (c * c))]))
}

/// ρ′/(2r) times σ²; `None` where it is 1.
fn robust_weight(graph: &mut Graph, loss: Loss, residual: NodeId, variance: Option<NodeId>) -> Option<NodeId> {
    let square = graph.product(1.0, [(residual, 2)].into_iter().chain(variance.map(|v| (v, -1))));
    Some(match loss {
        Loss::Squares => return None,
        Loss::Tukey(c) => {
            let (inside, rest) = biweight(graph, square, c);
            let (near, far) = (graph.product(1.0, [(rest, 2)]), graph.number(0.0));
            graph.select(inside, near, far)
        }
        Loss::Huber(c) => {
            let inside = within(graph, square, c * c);
            let root = graph.sqrt(square);
            let (near, far) = (graph.number(1.0), graph.product(c, [(root, -1)]));
            graph.select(inside, near, far)
        }
    })
}
