//! What a pixel value adds to F, by its residual r and its variance σ²: −2 ln of its probability, constants left out.
//!
//! What comes in: nodes for r and σ². What goes out: nodes for F and, for Gauss–Newton, for L = dF/dr and the weight Q.
//! [`Shape::direct`] says the same in any arithmetic; programs are checked against it.
//! - a pixel below its limit: r²/σ² (and ln σ², which its users add), or a robust function ρ of r/σ;
//! - one at its limit, where r is the limit minus the intensity: −2 ln Q(r/σ), Q the upper tail of the normal
//!   distribution: light could not have been less (Tobin 1958).
//!
//! Gauss–Newton of a robust ρ uses the weight ρ′/(2r), which is never negative (iteratively reweighted least squares).

use crate::derive::graph::{Graph, NodeId};
use crate::derive::jet::{Jet, jet};
use crate::program::Comparison;
use crate::program::function::Function1;
use crate::proof::calculus::derivatives;
use crate::proof::evaluate::Number;
use crate::proof::hyper::Hyper;

/// How residuals count.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub enum Loss {
    /// Their square.
    #[default]
    Squares,
    /// Huber's: beyond c standard deviations linearly.
    Huber(f64),
    /// Tukey's biweight: beyond c standard deviations not at all.
    Tukey(f64),
}

/// What becomes of a pixel at its channel's limit.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Saturated {
    /// It is left out.
    #[default]
    Dropped,
    /// It is left out where it is predicted to be near the limit, whatever it shows.
    Predicted,
    /// It says that there was at least that much light.
    Censored,
}

/// F of a pixel as a function of r and σ².
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) enum Shape {
    /// Of a pixel below its limit.
    Seen(Loss),
    /// Of a pixel at its limit.
    Clipped(Loss),
}

/// −2 ln Q(c) and its slope: what a tail is continued with beyond c.
fn bend(c: f64) -> (f64, f64) {
    (-2.0 * Function1::LogTail.value(c), 2.0 * Function1::Hazard.value(c))
}

impl Shape {
    /// True when F is put together of pieces.
    pub fn is_conditional(self) -> bool {
        self != Shape::Seen(Loss::Squares)
    }

    /// True when F has ln σ² as well.
    pub fn has_logarithm(self) -> bool {
        matches!(self, Shape::Seen(_))
    }

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
            Shape::Clipped(loss) => {
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

    /// F, and its first and second derivatives by r (and by σ² with `newton`).
    pub fn jet(self, graph: &mut Graph, newton: bool, tops: &[NodeId], variance: Option<NodeId>) -> (NodeId, Jet) {
        let residual = tops[0];
        let value = self.value(graph, residual, variance);
        let total = match variance {
            Some(v) if newton && self.has_logarithm() => {
                let log = graph.call1(Function1::Log, v);
                graph.add2(value, log)
            }
            _ => value,
        };
        let weight = match self {
            Shape::Seen(loss) if !newton => robust_weight(graph, loss, residual, variance),
            _ => None,
        };
        let Some(weight) = weight else {
            let top = jet(graph, total, &tops.iter().copied().collect(), true);
            return (total, top);
        };
        let mut own = Jet::default();
        let factors =
            |more: &[(NodeId, i32)]| [more, &variance.map(|v| (v, -1)).into_iter().collect::<Vec<_>>()].concat();
        own.first.insert(residual, graph.product(2.0, factors(&[(weight, 1), (residual, 1)])));
        own.second.insert((residual, residual), graph.product(2.0, factors(&[(weight, 1)])));
        (total, own)
    }

    /// F, gradient and upper Hessian of one pixel value, in any arithmetic: of Newton's method, …
    #[allow(clippy::neg_cmp_op_on_partial_ord)] // what is not a number takes the same branch as in the kernels
    pub fn newton<N: Number>(self, residual: &Hyper<N>, variance: Option<&Hyper<N>>) -> Hyper<N> {
        let square = variance.map_or_else(|| residual.power(2), |v| residual.power(2).mul(&v.power(-1)));
        let f = match self {
            Shape::Seen(Loss::Squares) => square,
            Shape::Seen(Loss::Tukey(c)) if square.value < N::from(c * c) => {
                let rest = Hyper::fixed(N::from(1.0)).add(&square.scaled(-1.0 / (c * c)));
                Hyper::fixed(N::from(c * c / 3.0)).add(&rest.power(3).scaled(-c * c / 3.0))
            }
            Shape::Seen(Loss::Tukey(c)) => Hyper::fixed(N::from(c * c / 3.0)),
            Shape::Seen(Loss::Huber(c)) if square.value < N::from(c * c) => square,
            Shape::Seen(Loss::Huber(c)) => Hyper::fixed(N::from(-c * c)).add(&square.sqrt().scaled(2.0 * c)),
            Shape::Clipped(loss) => {
                let z = variance.map_or_else(|| residual.clone(), |v| residual.mul(&v.sqrt().power(-1)));
                match loss {
                    Loss::Tukey(c) if z.value >= N::from(c) => Hyper::fixed(N::from(bend(c).0)),
                    Loss::Huber(c) if z.value >= N::from(c) => {
                        let (value, slope) = bend(c);
                        Hyper::fixed(N::from(value - slope * c)).add(&z.scaled(slope))
                    }
                    _ => z.unary(derivatives(Function1::LogTail, z.value)).scaled(-2.0),
                }
            }
        };
        match variance {
            Some(v) if self.has_logarithm() => f.add(&v.unary(derivatives(Function1::Log, v.value))),
            _ => f,
        }
    }

    /// … and F, L and Q, of Gauss–Newton.
    #[allow(clippy::neg_cmp_op_on_partial_ord)] // what is not a number takes the same branch as in the kernels
    pub fn direct<N: Number>(self, residual: N, variance: Option<N>) -> [N; 3] {
        let (one, two, four) = (N::from(1.0), N::from(2.0), N::from(4.0));
        let weight = variance.map_or(one, |v| one / v);
        let square = residual * residual * weight;
        let weighed = |value: N, w: N| [value, two * w * residual * weight, two * w * weight];
        match self {
            Shape::Seen(Loss::Squares) => weighed(square, one),
            Shape::Seen(Loss::Tukey(c)) if square < N::from(c * c) => {
                let third = N::from(c * c / 3.0);
                let rest = one - N::from(1.0 / (c * c)) * square;
                weighed(third - third * (rest * rest * rest), rest * rest)
            }
            Shape::Seen(Loss::Tukey(c)) => weighed(N::from(c * c / 3.0), N::from(0.0)),
            Shape::Seen(Loss::Huber(c)) if square < N::from(c * c) => weighed(square, one),
            Shape::Seen(Loss::Huber(c)) => {
                let root = square.sqrt();
                weighed(N::from(2.0 * c) * root - N::from(c * c), N::from(c) / root)
            }
            Shape::Clipped(loss) => {
                let deviation = variance.map_or(one, |v| v.sqrt());
                let z = residual / deviation;
                let zero = N::from(0.0);
                match loss {
                    Loss::Tukey(c) if z >= N::from(c) => [N::from(bend(c).0), zero, zero],
                    Loss::Huber(c) if z >= N::from(c) => {
                        let (value, slope) = bend(c);
                        [N::from(value - slope * c) + N::from(slope) * z, N::from(slope) / deviation, zero]
                    }
                    _ => {
                        let hazard = z.call1(Function1::Hazard);
                        let log = z.call1(Function1::LogTail);
                        let slope = two * hazard / deviation;
                        [-(two * log), slope, four * hazard * (hazard - z) * weight / two]
                    }
                }
            }
        }
    }
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

/// ρ′/(2r) times σ²; nothing where it is 1.
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
