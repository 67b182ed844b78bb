//! sin(x)/x, and (sin(x)/x − cos x)/x² for its derivatives: near 0 a polynomial in x².

use super::arithmetic::{clamped, polynomial};
use super::machine::{Accuracy, Machine};
use super::trigonometric::{sin, sin_cos};
use super::wave_coefficients::{SINC_DOUBLE, SINC_SINGLE};

/// sinc x = sin(x)/x: 1 at 0, 0 at infinity.
#[inline(always)]
pub(super) fn sinc<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> M::Number {
    let a = m.abs(x);
    of(m, a, sin(m, accuracy, a))
}

#[inline(always)]
fn of<M: Machine>(m: &M, a: M::Number, sin: M::Number) -> M::Number {
    let zero = m.constant(0.0);
    let value = m.select(m.equal(a, zero), m.constant(1.0), m.div(sin, a));
    m.select(m.equal(a, m.constant(f64::INFINITY)), zero, value)
}

/// (sinc x − cos x)/x² = −sinc′(x)/x: ⅓ at 0.
#[inline(always)]
pub(super) fn ratio<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> M::Number {
    let a = m.abs(x);
    let short = clamped(m, a, 0.0, 2.0);
    let z = m.mul(short, short);
    let p = polynomial(m, accuracy.pick(&SINC_SINGLE, &SINC_DOUBLE), z);
    let near = m.mul_add(z, p, m.constant(1.0 / 3.0));
    let [sin, cos] = sin_cos(m, accuracy, a);
    let far = m.div(m.div(m.sub(of(m, a, sin), cos), a), a);
    let far = m.select(m.equal(a, m.constant(f64::INFINITY)), m.constant(0.0), far);
    m.select(m.less(a, m.constant(2.0)), near, far)
}
