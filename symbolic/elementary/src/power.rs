//! x^y = e^(y ln |x|), with the logarithm and its product with y in two parts, and the special values of C99's Annex F.

use super::arithmetic::{SIGN, clamped, two_product};
use super::exponential::scaled;
use super::logarithm::{log, log_in_two};
use super::machine::{Accuracy, Machine};

/// Is |y| = b whole, and is it odd?
#[inline(always)]
fn whole<M: Machine>(m: &M, b: M::Number) -> [M::Truth; 2] {
    // From 2⁵² on every number is whole, from 2⁵³ on even.
    let limit = m.constant((1_u64 << 52) as f64);
    let small = m.less(b, limit);
    let shifted = m.select(small, m.add(b, limit), b);
    let rounded = m.select(small, m.sub(shifted, limit), b);
    let last = m.bits_and(m.bits(shifted), m.pattern(1));
    let is_whole = m.equal(rounded, b);
    let odd = m.and(m.bits_equal(last, m.pattern(1)), m.less(b, m.constant((1_u64 << 53) as f64)));
    [is_whole, m.and(is_whole, odd)]
}

/// |x|^y without the special values.
#[inline(always)]
fn magnitude<M: Machine>(m: &M, accuracy: Accuracy, a: M::Number, y: M::Number) -> M::Number {
    let zero = m.constant(0.0);
    if accuracy == Accuracy::Single {
        // The absolute error of y ln a, at most 104 · 2⁻⁵², is the relative error of the result.
        let product = m.mul(y, log(m, Accuracy::Double, a));
        return scaled(m, accuracy, [product, zero], 0.0);
    }
    let [high, low] = log_in_two(m, a);
    // Splitting a larger y would overflow; the result is then already 0, 1 or infinite.
    let y = clamped(m, y, -1e270, 1e270);
    let [product, error] = two_product(m, y, high);
    let rest = m.mul_add(y, low, error);
    let ordinary = m.less(m.abs(product), m.constant(1000.0));
    scaled(m, accuracy, [product, m.select(ordinary, rest, zero)], 0.0)
}

/// x^y
#[inline(always)]
pub(super) fn pow<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number, y: M::Number) -> M::Number {
    let (a, b) = (m.abs(x), m.abs(y));
    let (zero, one, infinity) = (m.constant(0.0), m.constant(1.0), m.constant(f64::INFINITY));
    let value = magnitude(m, accuracy, a, y);
    let [is_whole, odd] = whole(m, b);
    let number = m.and(m.equal(x, x), m.equal(y, y));
    // A finite negative base requires a whole exponent.
    let negative = m.and(m.less(x, zero), m.less(a, infinity));
    let real = m.and(number, m.not(m.and(negative, m.not(is_whole))));
    let value = m.select(real, value, m.constant(f64::NAN));
    let sign = m.bits_and(m.bits(x), m.pattern(SIGN));
    let value = m.select(odd, m.number(m.bits_xor(m.bits(value), sign)), value);
    let one_always = m.or(m.equal(x, one), m.equal(y, zero));
    let one_at_infinity = m.and(m.equal(a, one), m.equal(b, infinity));
    m.select(m.or(one_always, one_at_infinity), one, value)
}
