//! arcsin, arccos, arctan and the angle of a point: each from a polynomial on a short interval.

use super::arithmetic::{SIGN, odd, polynomial, quick_sum, signed};
use super::coefficients::{ASIN_DOUBLE, ASIN_SINGLE, ATAN_DOUBLE, ATAN_SINGLE, HALF_PI_DOUBLE, PI_DOUBLE};
use super::machine::{Accuracy, Machine};

/// arctan u, 0 ≤ u ≤ 1.
#[inline(always)]
fn acute<M: Machine>(m: &M, accuracy: Accuracy, u: M::Number) -> M::Number {
    odd(m, accuracy.pick(&ATAN_SINGLE, &ATAN_DOUBLE), u, m.mul(u, u))
}

/// arctan x; beyond 1 it is π/2 − arctan 1/x.
#[inline(always)]
pub(super) fn atan<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> M::Number {
    let a = m.abs(x);
    let one = m.constant(1.0);
    let steep = m.less(one, a);
    let u = m.select(steep, m.div(one, a), a);
    let near = acute(m, accuracy, u);
    let rest = m.sub(m.constant(HALF_PI_DOUBLE[1]), near);
    let far = m.add(m.constant(HALF_PI_DOUBLE[0]), rest);
    signed(m, m.select(steep, far, near), x)
}

/// The angle of the point (x, y): multiples of π/2 plus or minus the arctan of the smaller over the larger.
#[inline(always)]
pub(super) fn atan2<M: Machine>(m: &M, accuracy: Accuracy, y: M::Number, x: M::Number) -> M::Number {
    let (up, right) = (m.abs(y), m.abs(x));
    let (zero, one) = (m.constant(0.0), m.constant(1.0));
    let steep = m.less(right, up);
    let small = m.select(steep, right, up);
    let large = m.select(steep, up, right);
    let u = m.div(small, large);
    // 0/0 counts as 0, ∞/∞ as 1.
    let u = m.select(m.equal(large, zero), zero, u);
    let u = m.select(m.equal(small, m.constant(f64::INFINITY)), one, u);
    let near = acute(m, accuracy, u);
    // The sign bit of x as a number's sign: −0 is to the left.
    let left = m.less(signed(m, one, x), zero);
    let [half, whole] = [HALF_PI_DOUBLE, PI_DOUBLE].map(|parts| parts.map(|part| m.constant(part)));
    let flips = m.or(m.and(left, m.not(steep)), m.and(steep, m.not(left)));
    let near = m.select(flips, m.neg(near), near);
    let choose = |i: usize| m.select(steep, half[i], m.select(left, whole[i], zero));
    let angle = m.add(choose(0), m.add(choose(1), near));
    // −0 is to the left, except at the origin.
    let angle = m.select(m.equal(large, zero), zero, m.abs(angle));
    let number = m.and(m.equal(x, x), m.equal(y, y));
    m.select(number, signed(m, angle, y), m.constant(f64::NAN))
}

/// For arcsin and arccos of a = |x|: a > ½; s = a, or √((1 − a)/2) where a > ½; and s z P(z), z = s².
#[inline(always)]
fn halves<M: Machine>(m: &M, accuracy: Accuracy, a: M::Number) -> (M::Truth, M::Number, M::Number) {
    let half = m.constant(0.5);
    let large = m.less(half, a);
    let z = m.select(large, m.mul(m.sub(m.constant(1.0), a), half), m.mul(a, a));
    let s = m.select(large, m.sqrt(z), a);
    let p = polynomial(m, accuracy.pick(&ASIN_SINGLE, &ASIN_DOUBLE), z);
    (large, s, m.mul(m.mul(s, z), p))
}

/// arcsin x; beyond ½ it is π/2 − 2 arcsin √((1 − x)/2).
#[inline(always)]
pub(super) fn asin<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> M::Number {
    let (large, s, tail) = halves(m, accuracy, m.abs(x));
    let near = m.add(s, tail);
    let two = m.constant(-2.0);
    let rest = m.mul_add(tail, two, m.constant(HALF_PI_DOUBLE[1]));
    let [far, low] = quick_sum(m, m.constant(HALF_PI_DOUBLE[0]), m.mul(s, two));
    let far = m.add(far, m.add(low, rest));
    signed(m, m.select(large, far, near), x)
}

/// arccos x = π/2 − arcsin x; beyond ½ it is 2 arcsin √((1 − |x|)/2), or π minus that.
#[inline(always)]
pub(super) fn acos<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> M::Number {
    let (large, s, tail) = halves(m, accuracy, m.abs(x));
    let sign = m.bits_and(m.bits(x), m.pattern(SIGN));
    let flip = |v: M::Number| m.number(m.bits_xor(m.bits(v), sign));
    let [half, whole] = [HALF_PI_DOUBLE, PI_DOUBLE].map(|parts| parts.map(|part| m.constant(part)));
    let middle = m.sub(half[0], m.sub(flip(s), m.sub(half[1], flip(tail))));
    let arc = m.add(s, tail);
    let twice = m.add(arc, arc);
    let left = m.add(whole[0], m.sub(whole[1], twice));
    let end = m.select(m.less(x, m.constant(0.0)), left, twice);
    m.select(large, end, middle)
}
