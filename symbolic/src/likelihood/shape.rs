//! [`Shape`]: F as a function of residual and variance, and its value in any arithmetic: F, its derivatives, and
//! Gauss–Newton's L and Q from numbers for r and σ². The derivation implements the same function independently.

use isophote_elementary::{Function1, Two, derivatives};

use crate::graph::hyper::{Hyper, Order, Quantity};
use crate::model::{Formulas, Loss, Summand};
use crate::program::ConstantId;
use crate::program::arithmetic::Number;

/// F of a pixel as a function of r and σ².
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) enum Shape {
    /// Of a pixel below its limit.
    Seen(Loss),
    /// Of a pixel at its limit; the constant is the share of pixels at their limit whatever the light.
    Clipped(Loss, Option<ConstantId>),
}

/// ln of the odds of a defect against light from which F counts the defect only.
pub(crate) const HOPELESS: f64 = 30.0;

/// −2 ln Q(c) and its slope, which continue a tail beyond c.
pub(crate) fn bend(c: f64) -> (f64, f64) {
    (-2.0 * Function1::LogTail.value(c), 2.0 * Function1::Hazard.value(c))
}

impl Summand {
    /// F as a function of a residual.
    pub(crate) fn shape(&self) -> Shape {
        let Formulas { loss, defects, .. } = self.model().formulas;
        if self.is_clipped() { Shape::Clipped(loss, defects) } else { Shape::Seen(loss) }
    }
}

impl Shape {
    /// True when F is piecewise.
    pub fn is_conditional(self) -> bool {
        self != Shape::Seen(Loss::Squares)
    }

    /// True when F contains ln σ².
    pub fn has_logarithm(self) -> bool {
        matches!(self, Shape::Seen(_))
    }

    /// F, gradient and upper Hessian of one pixel value by Newton's method, in any arithmetic.
    ///
    /// F is differentiated by r and σ² alone, which no program multiplies out, and then composed with their
    /// derivatives.
    pub fn newton<N: Number>(self, residual: &Hyper<N>, variance: Option<&Hyper<N>>, share: Option<N>) -> Hyper<N> {
        let variable = |x: &Hyper<N>, i| Hyper::variable(x.value.alone(), i, Order::Second);
        let (r, v) = (variable(residual, 0), variance.map(|v| variable(v, 1)));
        let f = self.differentiated(&r, v.as_ref(), share.map(N::alone));
        let made = |y: N| y.made_of(residual.value, variance.map(|v| v.value));
        let (value, a, aa) = (made(f.value), made(f.gradient(0)), made(f.hessian(0, 0)));
        let Some(variance) = variance else { return residual.unary((value, a, aa)) };
        let [b, ab, bb] = [f.gradient(1), f.hessian(0, 1), f.hessian(1, 1)].map(made);
        residual.binary(variance, &Two { value, a, b, aa, ab, bb })
    }

    #[allow(clippy::neg_cmp_op_on_partial_ord)] // NaN takes the same branch as in the kernels
    fn differentiated<N: Number>(self, residual: &Hyper<N>, variance: Option<&Hyper<N>>, share: Option<N>) -> Hyper<N> {
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
            Shape::Clipped(loss, _) => {
                let z = variance.map_or_else(|| residual.clone(), |v| residual.mul(&v.sqrt().power(-1)));
                let tail = z.unary(derivatives(Function1::LogTail, z.value));
                match (loss, share) {
                    (Loss::Tukey(c), _) if z.value >= N::from(c) => Hyper::fixed(N::from(bend(c).0)),
                    (Loss::Huber(c), _) if z.value >= N::from(c) => {
                        let (value, slope) = bend(c);
                        Hyper::fixed(N::from(value - slope * c)).add(&z.scaled(slope))
                    }
                    (Loss::Squares, Some(share)) => {
                        let one = N::from(1.0);
                        let [light, defect] = [one - share, share].map(|x| x.call1(Function1::Log));
                        let odds = Hyper::fixed(defect - light).add(&tail.scaled(-1.0));
                        let ratio = odds.unary(derivatives(Function1::Exp, odds.value));
                        let both = Hyper::fixed(one).add(&ratio);
                        let both = both.unary(derivatives(Function1::Log, both.value));
                        match odds.value >= N::from(HOPELESS) {
                            true => Hyper::fixed(defect).scaled(-2.0),
                            false => tail.add(&Hyper::fixed(light)).add(&both).scaled(-2.0),
                        }
                    }
                    _ => tail.scaled(-2.0),
                }
            }
        };
        match variance {
            Some(v) if self.has_logarithm() => f.add(&v.unary(derivatives(Function1::Log, v.value))),
            _ => f,
        }
    }

    /// F, L and Q of one pixel value by Gauss–Newton, in any arithmetic.
    #[allow(clippy::neg_cmp_op_on_partial_ord)] // NaN takes the same branch as in the kernels
    pub fn direct<N: Number>(self, residual: N, variance: Option<N>, share: Option<N>) -> [N; 3] {
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
            Shape::Clipped(loss, _) => {
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
                        let (slope, bend) = (two * hazard / deviation, four * hazard * (hazard - z) * weight / two);
                        let Some(share) = share.filter(|_| loss == Loss::Squares) else {
                            return [-(two * log), slope, bend];
                        };
                        let [light, defect] = [one - share, share].map(|x| x.call1(Function1::Log));
                        let odds = defect - light - log;
                        if odds >= N::from(HOPELESS) {
                            return [-(two * defect), zero, zero];
                        }
                        let both = one + odds.call1(Function1::Exp);
                        [-(two * (log + light + both.call1(Function1::Log))), slope / both, bend / both]
                    }
                }
            }
        }
    }
}
