//! sin, cos, tan of large arguments, one f64 at a time: 192 bits of x · 2/π modulo 4 (Payne and Hanek 1983).

use super::arithmetic::{Pair, product};
use super::coefficients::{HALF_PI_DOUBLE, TWO_OVER_PI};
use super::machine::Accuracy;
use super::plain::Plain;
use super::trigonometric::{sin_of, tan_of};
use crate::function::Function1;

const UNFUSED: Plain = Plain { fused: false };

/// The value of sin, cos or tan at |x| ≥ 2²⁰; NaN for infinities.
pub(super) fn value(function: Function1, x: f64) -> f64 {
    let (r, quadrant) = reduced(x.abs());
    let sign = 1.0_f64.copysign(x);
    match function {
        Function1::Sin => sign * sin_of(&UNFUSED, Accuracy::Double, r, quadrant),
        Function1::Tan => sign * tan_of(&UNFUSED, Accuracy::Double, r, quadrant),
        _ => sin_of(&UNFUSED, Accuracy::Double, r, quadrant + 1),
    }
}

/// 64 bits of 2/π, the first with the weight 2^−first.
fn window(first: i64) -> u128 {
    let at = (first + 63) as usize;
    let pair = u128::from(TWO_OVER_PI[at / 64]) << 64 | u128::from(TWO_OVER_PI[at / 64 + 1]);
    pair >> (64 - at % 64) & u128::from(u64::MAX)
}

/// x = k π/2 + r for x ≥ 2²⁰: r in two parts, NaN for NaN and ∞, and k up to multiples of 4.
pub fn reduced(x: f64) -> (Pair<f64>, u64) {
    if !x.is_finite() {
        return ([f64::NAN; 2], 0);
    }
    // x = mantissa · 2^exponent; drops bits of 2/π that contribute multiples of 4.
    let mantissa = u128::from(x.to_bits() & ((1 << 52) - 1) | 1 << 52);
    let first = (x.to_bits() >> 52) as i64 - 1075 - 1;
    let low = mantissa * window(first + 128);
    let middle = mantissa * window(first + 64) + (low >> 64);
    let high = mantissa * window(first) + (middle >> 64);
    // 192 bits, of which the first two are k; the truncation error of the table is below 2⁻¹³⁷.
    let quadrant = high as u64 >> 62;
    let mut top = (high << 64 | middle & u128::from(u64::MAX)) & (u128::MAX >> 2);
    let negative = top >> 125 == 1;
    let mut rest = low as u64;
    if negative {
        top = (1 << 126) - top - u128::from(rest != 0);
        rest = rest.wrapping_neg();
    }
    // f64 come no closer to a multiple of π/2 than 2⁻⁶²: at least 60 bits are left.
    let shift = top.leading_zeros();
    let digits = top << shift;
    let digits = digits | (u128::from(rest) << shift >> 64);
    let unit = |exponent: i64| f64::from_bits(((1023 + exponent) as u64) << 52);
    let lowest = -126 - i64::from(shift);
    let quarters =
        [(digits >> 75) as f64 * unit(lowest + 75), (digits >> 22 & ((1 << 53) - 1)) as f64 * unit(lowest + 22)];
    let [r, rest] = product(&UNFUSED, quarters, HALF_PI_DOUBLE);
    match negative {
        true => ([-r, -rest], quadrant + 1),
        false => ([r, rest], quadrant),
    }
}
