//! sinh, cosh, tanh: from e^x where nothing cancels, by a polynomial near 0.

use super::arithmetic::{odd, signed};
use super::coefficients::{SINH_DOUBLE, SINH_SINGLE, TANH_DOUBLE, TANH_SINGLE};
use super::exponential::scaled;
use super::machine::{Accuracy, Machine};

/// e^a/2 and e^−a/2.
#[inline(always)]
fn halves<M: Machine>(m: &M, accuracy: Accuracy, a: M::Number) -> [M::Number; 2] {
    let up = scaled(m, accuracy, [a, m.constant(0.0)], -1.0);
    [up, m.div(m.constant(0.25), up)]
}

/// sinh x
#[inline(always)]
pub(super) fn sinh<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> M::Number {
    let a = m.abs(x);
    let [up, down] = halves(m, accuracy, a);
    let near = odd(m, accuracy.pick(&SINH_SINGLE, &SINH_DOUBLE), a, m.mul(a, a));
    let value = m.select(m.less(a, m.constant(1.0)), near, m.sub(up, down));
    signed(m, value, x)
}

/// cosh x
#[inline(always)]
pub(super) fn cosh<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> M::Number {
    let [up, down] = halves(m, accuracy, m.abs(x));
    m.add(up, down)
}

/// tanh x = 1 − 2/(e^2x + 1)
#[inline(always)]
pub(super) fn tanh<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> M::Number {
    let a = m.abs(x);
    let (one, two) = (m.constant(1.0), m.constant(2.0));
    let up = scaled(m, accuracy, [m.add(a, a), m.constant(0.0)], 0.0);
    let far = m.sub(one, m.div(two, m.add(up, one)));
    let near = odd(m, accuracy.pick(&TANH_SINGLE, &TANH_DOUBLE), a, m.mul(a, a));
    signed(m, m.select(m.less(a, m.constant(0.75)), near, far), x)
}
