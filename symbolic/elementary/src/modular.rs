//! Exact arithmetic modulo the prime 2⁶¹ − 1: two rational expressions that agree at a random point are equal except
//! with probability degree / 2⁶¹ (Schwartz and Zippel).
//!
//! Elementary functions and roots are uninterpreted, with equal values for equal arguments: identities of these hold
//! for the true functions. Comparisons read the parity of a difference, so that terms may change sides.

use std::cmp::Ordering;
use std::ops::{Add, Div, Mul, Neg, Sub};

use crate::{Function1, Function2, Lookup, Number, Tables};

const P: u64 = (1 << 61) - 1;

/// A residue, below the prime.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Modular(u64);

impl Modular {
    /// The residue of any bits, for random points.
    #[inline]
    pub fn of_bits(bits: u64) -> Modular {
        Modular(bits % P)
    }

    /// The fraction with this residue whose numerator and denominator are below 2²⁰, if there is one.
    pub fn small_fraction(self) -> Option<f64> {
        const SMALL: i64 = 1 << 20;
        let (mut r, mut r_next, mut t, mut t_next) = (P as i64, self.0 as i64, 0_i64, 1_i64);
        while r_next >= SMALL {
            let quotient = r / r_next;
            (r, r_next) = (r_next, r - quotient * r_next);
            (t, t_next) = (t_next, t.checked_sub(quotient.checked_mul(t_next)?)?);
        }
        (t_next.abs() < SMALL && t_next != 0).then(|| r_next as f64 / t_next as f64)
    }

    /// x^(P − 2), by Fermat; that of 0 is 0.
    fn inverse(self) -> Modular {
        let squared = |x: Modular, times: u32| (0..times).fold(x, |x, _| x * x);
        // The power of 2ⁿ − 1, squared k times and multiplied by that of 2ᵏ − 1, is that of 2ⁿ⁺ᵏ − 1.
        let of_2 = squared(self, 1) * self;
        let of_4 = squared(of_2, 2) * of_2;
        let of_8 = squared(of_4, 4) * of_4;
        let of_16 = squared(of_8, 8) * of_8;
        let of_32 = squared(of_16, 16) * of_16;
        let of_56 = squared(squared(of_32, 16) * of_16, 8) * of_8;
        let of_59 = squared(squared(of_56, 2) * of_2, 1) * self;
        squared(of_59, 2) * self
    }

    /// A pseudorandom value that depends on the tag and the residue alone.
    #[inline]
    fn opaque(self, tag: u64) -> Modular {
        let mut z = self.0 ^ tag.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        Modular::of_bits(z ^ (z >> 31))
    }
}

impl From<f64> for Modular {
    /// For a number of the document, or one computed from such in f64: the fraction with the smallest denominator
    /// within two units in the last place, so that 0.1 · 3 is three tenths.
    fn from(x: f64) -> Modular {
        if !x.is_finite() {
            return Modular(0x5eed).opaque(x.to_bits());
        }
        let magnitude = x.abs();
        let (mut h, mut h_before, mut k, mut k_before) = (1_u64, 0_u64, 0_u64, 1_u64);
        let mut rest = magnitude;
        for _ in 0..24 {
            let whole = rest.floor();
            if whole > 1e15 {
                break;
            }
            let step = |now: u64, before: u64| now.checked_mul(whole as u64)?.checked_add(before);
            let (Some(h_next), Some(k_next)) = (step(h, h_before), step(k, k_before)) else { break };
            (h, h_before, k, k_before) = (h_next, h, k_next, k);
            let tolerance = 2.0 * f64::EPSILON * magnitude;
            let near = (h as f64 / k as f64 - magnitude).abs() <= tolerance;
            // An arbitrary number has a fraction as near as that with k² ≈ 1 / tolerance.
            if near && k as f64 * k as f64 * tolerance < 0.05 && h < 1 << 52 {
                let fraction = if k == 1 { Modular(h % P) } else { Modular(h % P) / Modular(k % P) };
                return if x < 0.0 { -fraction } else { fraction };
            }
            rest = 1.0 / (rest - whole);
        }
        // Otherwise the exact value: mantissa · 2^exponent, with 2⁶¹ = 1.
        let bits = magnitude.to_bits();
        let (exponent, fraction) = ((bits >> 52) as i64, bits & ((1 << 52) - 1));
        let (mantissa, exponent) =
            if exponent == 0 { (fraction, -1074) } else { (fraction | 1 << 52, exponent - 1075) };
        let value = Modular(mantissa) * Modular(1 << exponent.rem_euclid(61));
        if x < 0.0 { -value } else { value }
    }
}

impl PartialOrd for Modular {
    #[inline]
    fn partial_cmp(&self, other: &Modular) -> Option<Ordering> {
        let difference = (*self - *other).0;
        Some(match difference {
            0 => Ordering::Equal,
            d if d % 2 == 1 => Ordering::Less,
            _ => Ordering::Greater,
        })
    }
}
impl Neg for Modular {
    type Output = Modular;
    #[inline]
    fn neg(self) -> Modular {
        Modular(if self.0 == 0 { 0 } else { P - self.0 })
    }
}
impl Add for Modular {
    type Output = Modular;
    #[inline]
    fn add(self, b: Modular) -> Modular {
        let sum = self.0 + b.0;
        Modular(if sum >= P { sum - P } else { sum })
    }
}
impl Sub for Modular {
    type Output = Modular;
    #[inline]
    fn sub(self, b: Modular) -> Modular {
        self + -b
    }
}
impl Mul for Modular {
    type Output = Modular;
    #[inline]
    fn mul(self, b: Modular) -> Modular {
        let product = u128::from(self.0) * u128::from(b.0);
        Modular((product as u64) & P) + Modular((product >> 61) as u64)
    }
}
impl Div for Modular {
    type Output = Modular;
    /// x / 0 is 0.
    #[allow(clippy::suspicious_arithmetic_impl)] // a product with the inverse
    #[inline]
    fn div(self, b: Modular) -> Modular {
        self * b.inverse()
    }
}

impl Number for Modular {
    #[inline]
    fn abs(self) -> Modular {
        if self < Modular(0) { -self } else { self }
    }
    #[inline]
    fn sqrt(self) -> Modular {
        self.opaque(1)
    }
    #[inline]
    fn call1(self, function: Function1) -> Modular {
        let meant = if function == Function1::LogVariance { Function1::Log } else { function };
        self.opaque(16 + meant as u64)
    }
    #[inline]
    fn call2(self, function: Function2, other: Modular) -> Modular {
        self.opaque(64 + function as u64) + other.opaque(96 + function as u64) * self.opaque(128)
    }
    #[inline]
    fn look_up(self, other: Modular, _: &Tables, lookup: Lookup) -> Modular {
        let tag = 256 + 2 * (u64::from(lookup.table) << 8 | u64::from(lookup.coefficient));
        self.opaque(tag) + other.opaque(tag + 1) * self.opaque(129)
    }
}

#[cfg(test)]
#[path = "modular_tests.rs"]
mod tests;
