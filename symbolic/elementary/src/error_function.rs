//! erf: below 1 an odd polynomial, above it 1 − e^(−x²) P(t).

use super::arithmetic::{clamped, polynomial, signed};
use super::coefficients::{ERF_DOUBLE, ERF_SINGLE, ERFC_DOUBLE, ERFC_SINGLE};
use super::exponential::exp;
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
