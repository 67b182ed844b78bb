//! ln x = k ln 2 + ln m, ½√2 ≤ m < √2, ln m by a polynomial in s = (m − 1)/(m + 1).

use super::arithmetic::{Pair, polynomial, product, quick_sum, two_product, two_sum};
use super::coefficients::{
    LN_2, LN_2_DOUBLE, LN_2_SINGLE, LOG_DOUBLE, LOG_SINGLE, LOG_VARIANCE_SINGLE, POWER_DOUBLE, TWO_THIRDS,
};
use super::machine::{Accuracy, Machine};

/// The bits of ½√2, rounded to a multiple of 2⁻²⁰.
const ROOT_HALF: u64 = 0x3fe6_a09e_0000_0000;
const FRACTION: u64 = (1 << 52) - 1;

/// k and m − 1 of x > 0.
#[inline(always)]
fn taken_apart<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> [M::Number; 2] {
    let (mut x, mut bias) = (x, m.constant((1_u64 << 52) as f64 + 1023.0));
    if accuracy == Accuracy::Double {
        let subnormal = m.less(x, m.constant(f64::MIN_POSITIVE));
        x = m.select(subnormal, m.mul(x, m.constant((1_u64 << 54) as f64)), x);
        bias = m.select(subnormal, m.constant((1_u64 << 52) as f64 + 1077.0), bias);
    }
    let bits = m.bits_add(m.bits(x), m.pattern(1.0_f64.to_bits() - ROOT_HALF));
    // The exponent as the fraction of a number in [2⁵², 2⁵³).
    let exponent = m.bits_or(m.shift_right(bits, 52), m.pattern(((1_u64 << 52) as f64).to_bits()));
    let k = m.sub(m.number(exponent), bias);
    let fraction = m.bits_add(m.bits_and(bits, m.pattern(FRACTION)), m.pattern(ROOT_HALF));
    [k, m.sub(m.number(fraction), m.constant(1.0))]
}

/// ln x
#[inline(always)]
pub(super) fn log<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> M::Number {
    let [k, f] = taken_apart(m, accuracy, x);
    let s = m.div(f, m.add(f, m.constant(2.0)));
    let z = m.mul(s, s);
    let value = match accuracy {
        Accuracy::Single => {
            let p = polynomial(m, &LOG_SINGLE, z);
            let fraction = m.mul_add(m.mul(s, z), p, m.add(s, s));
            m.mul_add(k, m.constant(std::f64::consts::LN_2), fraction)
        }
        Accuracy::Double => {
            // ln(1 + f) = f − (f²/2 − s (f²/2 + z P)): f is exact.
            let half = m.mul(m.mul(f, f), m.constant(0.5));
            let p = m.mul_add(z, polynomial(m, &LOG_DOUBLE, z), half);
            let small = m.mul_add(s, p, m.mul(k, m.constant(LN_2[1])));
            let [high, low] = two_sum(m, m.mul(k, m.constant(LN_2[0])), f);
            m.add(high, m.add(low, m.sub(small, half)))
        }
    };
    special(m, x, value)
}

/// The bits of ½√2 as f32.
const ROOT_HALF_SINGLE: u32 = 0x3f35_04f3;
const FRACTION_SINGLE: u32 = (1 << 23) - 1;
/// The largest subnormal f32.
const SUBNORMAL_MAX: f64 = f32::from_bits(FRACTION_SINGLE) as f64;

/// ln x; in f32 arithmetic for positive normal numbers only, such as a variance, and NaN for all others.
///
/// ln(1 + f) = f − f²/2 + f³ P(f), with independent even and odd parts of P.
#[inline(always)]
pub(super) fn log_variance<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> M::Number {
    if accuracy == Accuracy::Double {
        return log(m, accuracy, x);
    }
    let magic = (1_u32 << 23) as f32;
    let bits = m.bits_add(m.bits(x), m.pattern((1.0_f32.to_bits() - ROOT_HALF_SINGLE).into()));
    let exponent = m.bits_or(m.shift_right(bits, 23), m.pattern(magic.to_bits().into()));
    let k = m.sub(m.number(exponent), m.constant(f64::from(magic) + 127.0));
    let fraction = m.bits_and(bits, m.pattern(FRACTION_SINGLE.into()));
    let fraction = m.bits_add(fraction, m.pattern(ROOT_HALF_SINGLE.into()));
    let f = m.sub(m.number(fraction), m.constant(1.0));
    let z = m.mul(f, f);
    let even: [f64; 5] = std::array::from_fn(|i| LOG_VARIANCE_SINGLE[2 * i]);
    let odd: [f64; 4] = std::array::from_fn(|i| LOG_VARIANCE_SINGLE[2 * i + 1]);
    let [even, odd] = [polynomial(m, &even, z), polynomial(m, &odd, z)];
    let small = m.mul(m.mul(f, z), m.mul_add(odd, f, even));
    let small = m.mul_add(k, m.constant(LN_2_SINGLE[1]), small);
    let small = m.mul_add(z, m.constant(-0.5), small);
    let value = m.mul_add(k, m.constant(LN_2_SINGLE[0]), m.add(f, small));
    let is_ordinary = m.and(m.less(m.constant(SUBNORMAL_MAX), x), m.less(x, m.constant(f64::INFINITY)));
    m.select(is_ordinary, value, m.constant(f64::NAN))
}

/// `value`, or the logarithm of 0, of negative numbers, of infinity or of NaN.
#[inline(always)]
fn special<M: Machine>(m: &M, x: M::Number, value: M::Number) -> M::Number {
    let (zero, infinity) = (m.constant(0.0), m.constant(f64::INFINITY));
    let ordinary = m.and(m.less(zero, x), m.less(x, infinity));
    let nan = m.constant(f64::NAN);
    // ∞ is its own logarithm.
    let other = m.select(m.equal(x, infinity), x, nan);
    let other = m.select(m.equal(x, zero), m.constant(f64::NEG_INFINITY), other);
    m.select(ordinary, value, other)
}

/// ln x of x ≥ 0 to 2⁻⁶⁵ of itself; infinity and NaN are in the first part alone.
#[inline(always)]
pub(super) fn log_in_two<M: Machine>(m: &M, x: M::Number) -> Pair<M::Number> {
    let [k, f] = taken_apart(m, Accuracy::Double, x);
    // s = f / (2 + f) in two parts; f is exact, 2 + f is rounded.
    let [d, d_low] = quick_sum(m, m.constant(2.0), f);
    let s = m.div(f, d);
    let [p, e] = two_product(m, s, d);
    let rest = m.sub(m.sub(f, p), e);
    let rest = m.sub(rest, m.mul(s, d_low));
    let s = quick_sum(m, s, m.div(rest, d));
    let z = product(m, s, s);
    // ⅔ s z in two parts, too; later terms are small enough for one.
    let thirds = [m.constant(TWO_THIRDS[0]), m.constant(TWO_THIRDS[1])];
    let cubic = product(m, product(m, s, z), thirds);
    let higher = m.mul(m.mul(s[0], m.mul(z[0], z[0])), polynomial(m, &POWER_DOUBLE, z[0]));
    let two = m.constant(2.0);
    let [sum, low] = quick_sum(m, m.mul(two, s[0]), cubic[0]);
    let low = m.add(m.add(low, m.mul_add(two, s[1], cubic[1])), higher);
    // k · LN_2_DOUBLE[0] and [1] are exact.
    let [high, rest] = two_sum(m, m.mul(k, m.constant(LN_2_DOUBLE[0])), sum);
    let [second, rest_of_second] = two_sum(m, m.mul(k, m.constant(LN_2_DOUBLE[1])), rest);
    let low = m.add(low, m.mul_add(k, m.constant(LN_2_DOUBLE[2]), rest_of_second));
    let [high, second] = quick_sum(m, high, second);
    let [high, low] = quick_sum(m, high, m.add(second, low));
    let value = special(m, x, high);
    [value, low]
}
