//! sin, cos, tan: x = k π/2 + r, |r| ≤ π/4 (Cody and Waite 1980), then polynomials. Beyond 2²⁰ see [`super::large`].

use super::arithmetic::{MAGIC, Pair, SIGN, odd, polynomial, quick_sum, signed, two_product, two_sum};
use super::coefficients::{COS_DOUBLE, COS_SINGLE, HALF_PI, HALF_PI_SHORT, SIN_DOUBLE, SIN_SINGLE};
use super::machine::{Accuracy, Machine};
use crate::function::Function1;

/// From here on k has too many bits for exact products with the parts of π/2.
const LARGE: f64 = (1_u64 << 20) as f64;

/// r in two parts, and the bits of k.
#[inline(always)]
fn reduced<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> (Pair<M::Number>, M::Bits) {
    let rounded = m.mul_add(x, m.constant(std::f64::consts::FRAC_2_PI), m.constant(MAGIC));
    let k = m.sub(rounded, m.constant(MAGIC));
    let quadrant = m.bits(rounded);
    if accuracy == Accuracy::Single {
        let first = m.sub(x, m.mul(k, m.constant(HALF_PI_SHORT[0])));
        let r = m.sub(first, m.mul(k, m.constant(HALF_PI_SHORT[1])));
        return ([r, m.constant(0.0)], quadrant);
    }
    // All products but the last are exact, and so is the first difference.
    let first = m.sub(x, m.mul(k, m.constant(HALF_PI[0])));
    let [high, low] = two_sum(m, first, m.mul(k, m.constant(-HALF_PI[1])));
    let low = m.sub(low, m.mul(k, m.constant(HALF_PI[2])));
    let low = m.sub(low, m.mul(k, m.constant(HALF_PI[3])));
    (quick_sum(m, high, low), quadrant)
}

/// sin and cos of r, |r| ≤ π/4, each as a value and its error (0 in single accuracy).
#[inline(always)]
pub(super) fn kernels<M: Machine>(m: &M, accuracy: Accuracy, [r, low]: Pair<M::Number>) -> [Pair<M::Number>; 2] {
    let z = m.mul(r, r);
    let (one, half, zero) = (m.constant(1.0), m.constant(-0.5), m.constant(0.0));
    if accuracy == Accuracy::Single {
        let sin = odd(m, &SIN_SINGLE, r, z);
        let cos = m.mul_add(m.mul(z, z), polynomial(m, &COS_SINGLE, z), m.mul_add(z, half, one));
        return [[sin, zero], [cos, zero]];
    }
    // sin(r + low) = r + (r z P + low (1 − z/2)) and cos(r + low) = 1 − z/2 + (z² P − r low).
    let line = m.mul_add(z, half, one);
    let tail = m.mul_add(m.mul(r, z), polynomial(m, &SIN_DOUBLE, z), m.mul(low, line));
    let sin = quick_sum(m, r, tail);
    let drop = m.mul(z, half);
    let [cos, error] = quick_sum(m, one, drop);
    // z lacks this much of r²; half of it is missing from the second term.
    let [_, missing] = two_product(m, r, r);
    let tail = m.mul_add(missing, half, m.sub(error, m.mul(r, low)));
    let tail = m.mul_add(m.mul(z, z), polynomial(m, &COS_DOUBLE, z), tail);
    [sin, quick_sum(m, cos, tail)]
}

/// −value where the second lowest bit is set.
#[inline(always)]
fn turned<M: Machine>(m: &M, value: M::Number, quadrant: M::Bits) -> M::Number {
    let sign = m.bits_and(m.shift_left(quadrant, 62), m.pattern(SIGN));
    m.number(m.bits_xor(m.bits(value), sign))
}

#[inline(always)]
fn is_odd<M: Machine>(m: &M, quadrant: M::Bits) -> M::Truth {
    m.bits_equal(m.bits_and(quadrant, m.pattern(1)), m.pattern(1))
}

/// sin of an angle of that quadrant.
#[inline(always)]
pub(super) fn sin_of<M: Machine>(m: &M, accuracy: Accuracy, r: Pair<M::Number>, quadrant: M::Bits) -> M::Number {
    let [sin, cos] = kernels(m, accuracy, r);
    let value = m.select(is_odd(m, quadrant), cos[0], sin[0]);
    turned(m, value, quadrant)
}

/// tan of an angle of that quadrant.
#[inline(always)]
pub(super) fn tan_of<M: Machine>(m: &M, accuracy: Accuracy, r: Pair<M::Number>, quadrant: M::Bits) -> M::Number {
    let [sin, cos] = kernels(m, accuracy, r);
    let odd = is_odd(m, quadrant);
    let choose = |a: Pair<M::Number>, b: Pair<M::Number>| [m.select(odd, a[0], b[0]), m.select(odd, a[1], b[1])];
    let sign = m.shift_left(quadrant, 63);
    let (up, down) = (choose(cos, sin), choose(sin, cos));
    let quotient = m.div(up[0], down[0]);
    let value = match accuracy {
        Accuracy::Single => quotient,
        Accuracy::Double => {
            let [p, e] = two_product(m, quotient, down[0]);
            let rest = m.sub(m.sub(up[0], p), e);
            let rest = m.sub(m.add(rest, up[1]), m.mul(quotient, down[1]));
            m.add(quotient, m.div(rest, down[0]))
        }
    };
    m.number(m.bits_xor(m.bits(value), sign))
}

/// sin x
#[inline(always)]
pub(super) fn sin<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> M::Number {
    let a = m.abs(x);
    let (r, quadrant) = reduced(m, accuracy, a);
    let value = signed(m, sin_of(m, accuracy, r, quadrant), x);
    m.elsewhere(m.less(m.constant(LARGE), a), value, Function1::Sin, x)
}

/// cos x
#[inline(always)]
pub(super) fn cos<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> M::Number {
    let a = m.abs(x);
    let (r, quadrant) = reduced(m, accuracy, a);
    let value = sin_of(m, accuracy, r, m.bits_add(quadrant, m.pattern(1)));
    m.elsewhere(m.less(m.constant(LARGE), a), value, Function1::Cos, x)
}

/// sin a and cos a of a ≥ 0, from one reduction.
#[inline(always)]
pub(super) fn sin_cos<M: Machine>(m: &M, accuracy: Accuracy, a: M::Number) -> [M::Number; 2] {
    let (r, quadrant) = reduced(m, accuracy, a);
    let [sin, cos] = kernels(m, accuracy, r).map(|pair| pair[0]);
    let odd = is_odd(m, quadrant);
    let large = m.less(m.constant(LARGE), a);
    let value = turned(m, m.select(odd, cos, sin), quadrant);
    let other = turned(m, m.select(odd, sin, cos), m.bits_add(quadrant, m.pattern(1)));
    [m.elsewhere(large, value, Function1::Sin, a), m.elsewhere(large, other, Function1::Cos, a)]
}

/// tan x
#[inline(always)]
pub(super) fn tan<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> M::Number {
    let a = m.abs(x);
    let (r, quadrant) = reduced(m, accuracy, a);
    let value = signed(m, tan_of(m, accuracy, r, quadrant), x);
    m.elsewhere(m.less(m.constant(LARGE), a), value, Function1::Tan, x)
}
