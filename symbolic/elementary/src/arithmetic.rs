//! Building blocks of the functions: polynomials, numbers in two parts, signs, powers of two.

use super::machine::{Accuracy, Machine};

/// 1.5 · 2⁵²: x + MAGIC has the integer nearest to x, |x| < 2⁵¹, in its low bits.
pub const MAGIC: f64 = 1.5 * (1_u64 << 52) as f64;
pub(super) const SIGN: u64 = 1 << 63;
/// 2²⁷ + 1, which splits a number into halves whose products are exact.
const SPLITTER: f64 = 134_217_729.0;

impl Accuracy {
    /// The coefficients for an accuracy.
    pub(super) fn pick<'a>(self, single: &'a [f64], double: &'a [f64]) -> &'a [f64] {
        match self {
            Accuracy::Single => single,
            Accuracy::Double => double,
        }
    }
}

/// Longer polynomials are split into independent blocks of this length.
const BLOCK: usize = 8;

/// c₀ + c₁ x + c₂ x² + …, lowest power first.
#[inline(always)]
pub(super) fn polynomial<M: Machine>(m: &M, coefficients: &[f64], x: M::Number) -> M::Number {
    let mut blocks = coefficients.chunks(BLOCK).rev();
    let mut value = horner(m, blocks.next().unwrap_or(&[]), x);
    if coefficients.len() <= BLOCK {
        return value;
    }
    let second = m.mul(x, x);
    let fourth = m.mul(second, second);
    let eighth = m.mul(fourth, fourth);
    for block in blocks {
        value = m.mul_add(value, eighth, horner(m, block, x));
    }
    value
}

/// c₀ + x (c₁ + x (c₂ + …))
#[inline(always)]
fn horner<M: Machine>(m: &M, coefficients: &[f64], x: M::Number) -> M::Number {
    let mut powers = coefficients.iter().rev();
    let mut value = m.constant(powers.next().copied().unwrap_or(0.0));
    for c in powers {
        value = m.mul_add(value, x, m.constant(*c));
    }
    value
}

/// x + x (z P(z)), the form of the odd functions.
#[inline(always)]
pub(super) fn odd<M: Machine>(m: &M, coefficients: &[f64], x: M::Number, z: M::Number) -> M::Number {
    let p = polynomial(m, coefficients, z);
    m.mul_add(m.mul(x, z), p, x)
}

/// A number with its rounding error.
pub(super) type Pair<N> = [N; 2];

/// a + b = s + e, exactly.
#[inline(always)]
pub(super) fn two_sum<M: Machine>(m: &M, a: M::Number, b: M::Number) -> Pair<M::Number> {
    let s = m.add(a, b);
    let t = m.sub(s, a);
    let e = m.add(m.sub(a, m.sub(s, t)), m.sub(b, t));
    [s, e]
}

/// a + b = s + e, exactly, for |a| ≥ |b|.
#[inline(always)]
pub(super) fn quick_sum<M: Machine>(m: &M, a: M::Number, b: M::Number) -> Pair<M::Number> {
    let s = m.add(a, b);
    [s, m.sub(b, m.sub(s, a))]
}

/// a · b = p + e, exactly (Dekker 1971 where nothing is fused), for |a|, |b| < 2⁹⁹⁵ and p no subnormal.
#[inline(always)]
pub(super) fn two_product<M: Machine>(m: &M, a: M::Number, b: M::Number) -> Pair<M::Number> {
    let p = m.mul(a, b);
    if m.is_fused() {
        return [p, m.mul_add(a, b, m.neg(p))];
    }
    let split = |x: M::Number| {
        let c = m.mul(m.constant(SPLITTER), x);
        let high = m.sub(c, m.sub(c, x));
        [high, m.sub(x, high)]
    };
    let [a, a_low] = split(a);
    let [b, b_low] = split(b);
    let e = m.sub(m.mul(a, b), p);
    let e = m.add(m.add(e, m.mul(a, b_low)), m.mul(a_low, b));
    [p, m.add(e, m.mul(a_low, b_low))]
}

/// The product of two numbers in two parts, to about 2⁻¹⁰⁰ of it.
#[inline(always)]
pub(super) fn product<M: Machine>(m: &M, a: Pair<M::Number>, b: Pair<M::Number>) -> Pair<M::Number> {
    let [p, e] = two_product(m, a[0], b[0]);
    let e = m.mul_add(a[0], b[1], e);
    let e = m.mul_add(a[1], b[0], e);
    quick_sum(m, p, e)
}

/// `y` with the sign of `x` multiplied in; y ≥ 0 or NaN becomes a value of the sign of x.
#[inline(always)]
pub(super) fn signed<M: Machine>(m: &M, y: M::Number, x: M::Number) -> M::Number {
    let sign = m.bits_and(m.bits(x), m.pattern(SIGN));
    m.number(m.bits_xor(m.bits(y), sign))
}

/// x, limited to the bounds; keeps NaN.
#[inline(always)]
pub(super) fn clamped<M: Machine>(m: &M, x: M::Number, low: f64, high: f64) -> M::Number {
    let (low, high) = (m.constant(low), m.constant(high));
    let x = m.select(m.less(x, low), low, x);
    m.select(m.less(high, x), high, x)
}

/// x − ⌊x⌋; 0 for large numbers without a fraction, NaN for NaN.
#[inline(always)]
pub(super) fn fraction<M: Machine>(m: &M, x: M::Number) -> M::Number {
    let magic = m.constant(MAGIC);
    let nearest = m.sub(m.add(x, magic), magic);
    let lower = m.sub(nearest, m.constant(1.0));
    let floor = m.select(m.less(x, nearest), lower, nearest);
    let is_whole = m.less(m.constant((1_u64 << 51) as f64), m.abs(x));
    m.select(is_whole, m.constant(0.0), m.sub(x, floor))
}

/// 2^k of a k that was rounded by adding [`MAGIC`], −1022 ≤ k ≤ 1023.
#[inline(always)]
pub(super) fn power_of_two<M: Machine>(m: &M, rounded: M::Number) -> M::Number {
    let k = m.shift_left(m.bits(rounded), 52);
    m.number(m.bits_add(k, m.pattern(1.0_f64.to_bits())))
}
