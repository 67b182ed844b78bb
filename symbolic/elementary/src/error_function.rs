//! erf: below 1 an odd polynomial, above it 1 − e^(−x²) P(t). erfc = 1 − erf near 0, elsewhere from the tail of the
//! normal distribution, so that it keeps its digits where erf is 1.

use super::arithmetic::{clamped, polynomial, signed, two_product};
use super::coefficients::{ERF_DOUBLE, ERF_SINGLE, ERFC_DOUBLE, ERFC_SINGLE, TAIL_DOUBLE, TAIL_SINGLE};
use super::exponential::{exp, scaled};
use super::machine::{Accuracy, Machine};

/// erf x = 2/√π ∫ e^(−t²) dt from 0 to x.
#[inline(always)]
pub(super) fn erf<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> M::Number {
    // From 6 on the value is 1.
    let a = clamped(m, m.abs(x), 0.0, 6.0);
    let z = m.mul(a, a);
    let near = m.mul_add(a, polynomial(m, accuracy.pick(&ERF_SINGLE, &ERF_DOUBLE), z), a);
    let (one, middle) = (m.constant(1.0), m.constant(2.5));
    let t = m.div(m.sub(a, middle), m.add(a, middle));
    let p = polynomial(m, accuracy.pick(&ERFC_SINGLE, &ERFC_DOUBLE), t);
    let bell = exp(m, accuracy, m.neg(z));
    let far = m.sub(one, m.mul(bell, p));
    signed(m, m.select(m.less(a, one), near, far), x)
}

/// erfc x = 1 − erf x
#[inline(always)]
pub(super) fn erfc<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> M::Number {
    let (one, two) = (m.constant(1.0), m.constant(2.0));
    let near = polynomial(m, accuracy.pick(&ERF_SINGLE, &ERF_DOUBLE), m.mul(x, x));
    let near = m.sub(one, m.mul_add(x, near, x));
    // From 28 on the value is 0.
    let a = clamped(m, m.abs(x), 0.0, 28.0);
    let t = m.div(m.sub(a, two), m.add(a, two));
    let p = polynomial(m, accuracy.pick(&TAIL_SINGLE, &TAIL_DOUBLE), t);
    let p = m.div(p, m.mul_add(a, two, one));
    let [square, rest] = match accuracy {
        Accuracy::Single => [m.mul(a, a), m.constant(0.0)],
        Accuracy::Double => two_product(m, a, a),
    };
    let tail = m.mul(scaled(m, accuracy, [m.neg(square), m.neg(rest)], 0.0), p);
    let far = m.select(m.less(x, m.constant(0.0)), m.sub(two, tail), tail);
    m.select(m.less(a, m.constant(0.25)), near, far)
}
