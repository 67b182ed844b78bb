//! e^x = 2^k e^r with k the integer nearest to x / ln 2, |r| ≤ ½ ln 2; e^r by a polynomial.

use super::arithmetic::{MAGIC, Pair, clamped, polynomial, power_of_two, quick_sum};
use super::coefficients::{EXP_DOUBLE, EXP_SINGLE, LN_2};
use super::machine::{Accuracy, Machine};

/// e^x
#[inline(always)]
pub(super) fn exp<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> M::Number {
    scaled(m, accuracy, [x, m.constant(0.0)], 0.0)
}

/// e^(x + small) 2^shift.
#[inline(always)]
pub(super) fn scaled<M: Machine>(m: &M, accuracy: Accuracy, x: Pair<M::Number>, shift: f64) -> M::Number {
    // Beyond these the result is 0 or infinite.
    let [low, high] = match accuracy {
        Accuracy::Single => [-110.0, 95.0],
        Accuracy::Double => [-747.0, 712.0],
    };
    let large = clamped(m, x[0], low, high);
    let rounded = m.mul_add(large, m.constant(std::f64::consts::LOG2_E), m.constant(MAGIC));
    let k = m.sub(rounded, m.constant(MAGIC));
    if accuracy == Accuracy::Single {
        let r = m.mul_add(k, m.constant(-std::f64::consts::LN_2), large);
        let p = polynomial(m, &EXP_SINGLE, r);
        let e = m.mul_add(m.mul(r, r), p, m.add(r, m.constant(1.0)));
        let shifted = m.add(rounded, m.constant(shift));
        return m.mul(e, power_of_two(m, shifted));
    }
    // k · LN_2[0] and the first difference are exact.
    let first = m.sub(large, m.mul(k, m.constant(LN_2[0])));
    let [r, rest] = quick_sum(m, first, m.mul(k, m.constant(-LN_2[1])));
    let rest = m.add(rest, x[1]);
    let p = polynomial(m, &EXP_DOUBLE, r);
    let one = m.constant(1.0);
    let tail = m.mul(m.mul(r, r), p);
    // e^(r + rest) = e^r + rest e^r.
    let tail = m.mul_add(rest, m.add(one, m.add(r, tail)), tail);
    let e = m.add(one, m.add(r, tail));
    // Two factors, so that subnormal results are rounded once and the largest do not overflow early.
    let half = m.mul_add(k, m.constant(0.5), m.constant(MAGIC));
    let other = m.sub(k, m.sub(half, m.constant(MAGIC)));
    let other = m.add(other, m.constant(MAGIC + shift));
    m.mul(m.mul(e, power_of_two(m, half)), power_of_two(m, other))
}
