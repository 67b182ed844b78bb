//! Double-double numbers: the reference for functions, and the referee of programs; accurate, not fast.
//!
//! A number hi + lo has about 32 digits (106 bits), |lo| ≤ ½ ulp(hi), for the operators and every function of the
//! language; at least 28 digits for arguments of ordinary size (likelihood's own functions are as exact as f64). The
//! range is that of f64; below 1e-290 there are fewer digits. NaN and ∞ follow f64.
//!
//! Sums and products: Dekker 1971, Knuth's two-sum. Functions: argument reduction with three-part constants, then a
//! series whose terms do not cancel.

use std::cmp::Ordering;
use std::ops::{Add, Div, Mul, Neg, Sub};

use crate::function::{Function1, Function2};

/// hi + lo, unevaluated.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct DoubleDouble {
    hi: f64,
    lo: f64,
}

/// A constant in three parts, 160 bits.
type Three = [f64; 3];
const LN_2: Three = [std::f64::consts::LN_2, 2.319_046_813_846_299_6e-17, 5.707_708_438_416_212e-34];
const HALF_PI: Three = [std::f64::consts::FRAC_PI_2, 6.123_233_995_736_766e-17, -1.497_384_904_859_169_8e-33];
const TWO_OVER_ROOT_PI: DoubleDouble =
    DoubleDouble { hi: std::f64::consts::FRAC_2_SQRT_PI, lo: 1.533_545_961_316_588e-17 };

/// Maximum number of terms of a series (erf at 8.7 needs 270).
const TERMS: u32 = 400;
/// A term this small relative to the sum ends a series.
const NEGLIGIBLE: f64 = 1e-35;

/// a + b = s + e exactly.
#[inline]
fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let s = a + b;
    let t = s - a;
    (s, (a - (s - t)) + (b - t))
}

impl DoubleDouble {
    /// 0
    pub const ZERO: Self = Self { hi: 0.0, lo: 0.0 };
    /// 1
    pub const ONE: Self = Self { hi: 1.0, lo: 0.0 };
    /// π
    pub const PI: Self = Self { hi: 2.0 * HALF_PI[0], lo: 2.0 * HALF_PI[1] };

    /// hi + lo for |hi| ≥ |lo|. NaN, ∞ and signed zeros have no low part.
    #[inline]
    fn quick(hi: f64, lo: f64) -> Self {
        let s = hi + lo;
        if s.is_finite() && s != 0.0 { Self { hi: s, lo: lo - (s - hi) } } else { Self { hi: s, lo: 0.0 } }
    }

    /// a + b, exactly.
    #[inline]
    pub fn sum(a: f64, b: f64) -> Self {
        let (hi, lo) = two_sum(a, b);
        if hi.is_finite() { Self { hi, lo } } else { Self { hi, lo: 0.0 } }
    }

    /// a · b, exactly.
    #[inline]
    pub fn product(a: f64, b: f64) -> Self {
        let hi = a * b;
        if hi.is_finite() && hi != 0.0 { Self { hi, lo: a.mul_add(b, -hi) } } else { Self { hi, lo: 0.0 } }
    }

    /// The nearest f64.
    #[inline]
    pub fn to_f64(self) -> f64 {
        self.hi
    }

    /// hi and lo.
    pub fn parts(self) -> [f64; 2] {
        [self.hi, self.lo]
    }

    /// True for NaN.
    #[inline]
    pub fn is_nan(self) -> bool {
        self.hi.is_nan()
    }

    /// True unless NaN or infinite.
    #[inline]
    pub fn is_finite(self) -> bool {
        self.hi.is_finite()
    }

    #[inline]
    fn is_negative(self) -> bool {
        self.hi.is_sign_negative()
    }

    /// |x|
    #[inline]
    pub fn abs(self) -> Self {
        if self.is_negative() { -self } else { self }
    }

    /// √x: one Newton step from the f64 root.
    #[inline]
    pub fn sqrt(self) -> Self {
        let root = self.hi.sqrt();
        if root == 0.0 || !root.is_finite() {
            return root.into();
        }
        let rest = self - Self::product(root, root);
        Self::quick(root, rest.hi / (2.0 * root))
    }

    /// x · 2^k, exact within the range; ∞ has no low part (which may be −∞).
    fn scaled(self, k: i32) -> Self {
        let hi = libm::ldexp(self.hi, k);
        if hi.is_finite() { Self::quick(hi, libm::ldexp(self.lo, k)) } else { hi.into() }
    }

    /// x − k · c.
    fn reduced(self, k: f64, c: Three) -> Self {
        c.into_iter().fold(self, |x, part| x - Self::product(k, part))
    }

    /// first + first·ratio(1) + first·ratio(1)·ratio(2) + … until a term is negligible.
    fn series(first: Self, ratio: impl Fn(f64) -> Self) -> Self {
        let (mut term, mut total) = (first, first);
        for n in 1..TERMS {
            term = term * ratio(f64::from(n));
            total = total + term;
            // Also ends at a NaN.
            let matters = term.hi.abs() > NEGLIGIBLE * total.hi.abs();
            if !matters {
                break;
            }
        }
        total
    }

    /// e^x = 2^k e^r, |r| ≤ ½ ln 2, by the power series.
    fn exp(self) -> Self {
        // Beyond these the f64 value is 0 or infinite.
        if self.is_nan() || self.hi.abs() >= 800.0 {
            return libm::exp(self.hi).into();
        }
        let k = (self.hi / LN_2[0]).round();
        let r = self.reduced(k, LN_2);
        Self::series(Self::ONE, |n| r / n.into()).scaled(k as i32)
    }

    /// ln x = k ln 2 + ln m, ½√2 ≤ m ≤ √2, ln m = 2 artanh((m − 1)/(m + 1)).
    fn log(self) -> Self {
        let (mantissa, mut k) = libm::frexp(self.hi);
        if !(self.hi > 0.0 && self.hi.is_finite()) {
            return libm::log(self.hi).into();
        }
        k -= i32::from(mantissa < std::f64::consts::FRAC_1_SQRT_2);
        let m = self.scaled(-k);
        let z = (m - Self::ONE) / (m + Self::ONE);
        let square = z * z;
        let two_z = z + z;
        let (mut power, mut total) = (two_z, two_z);
        for n in 1..40 {
            power = power * square;
            total = total + power / f64::from(2 * n + 1).into();
        }
        Self::ZERO.reduced(f64::from(-k), LN_2) + total
    }

    /// (sin x, cos x). From 2⁴⁰ on only hi counts.
    fn sin_cos(self) -> (Self, Self) {
        let (r, k) = if self.hi.abs() < (1_u64 << 40) as f64 {
            let k = (self.hi / HALF_PI[0]).round();
            (self.reduced(k, HALF_PI), k)
        } else {
            let ([hi, lo], k) = crate::large::reduced(self.hi.abs());
            let (r, k) = (Self { hi, lo }, (k % 4) as f64);
            if self.is_negative() { (-r, -k) } else { (r, k) }
        };
        let square = -(r * r);
        let sin = Self::series(r, |n| square / (2.0 * n * (2.0 * n + 1.0)).into());
        let cos = Self::series(Self::ONE, |n| square / (2.0 * n * (2.0 * n - 1.0)).into());
        match k.rem_euclid(4.0) as u8 {
            0 => (sin, cos),
            1 => (cos, -sin),
            2 => (-sin, -cos),
            _ => (-cos, sin),
        }
    }

    /// arctan x = a + δ with a from f64 and tan δ = (x cos a − sin a)/(cos a + x sin a).
    fn atan(self) -> Self {
        let near = libm::atan(self.hi);
        if self.hi.is_infinite() {
            let half = Self { hi: HALF_PI[0], lo: HALF_PI[1] };
            return if self.is_negative() { -half } else { half };
        }
        if near == 0.0 || near.is_nan() {
            return near.into();
        }
        let (sin, cos) = Self::from(near).sin_cos();
        let tan = (self * cos - sin) / (cos + self * sin);
        Self::from(near) + (tan - tan * tan * tan / 3.0.into())
    }

    fn atan2(self, x: Self) -> Self {
        let y = self;
        if y.is_nan() || x.is_nan() || (y.hi.is_infinite() && x.hi.is_infinite()) {
            return libm::atan2(y.hi, x.hi).into();
        }
        if y.hi == 0.0 && x.hi == 0.0 {
            return y;
        }
        let half = Self { hi: HALF_PI[0], lo: HALF_PI[1] };
        let (up, right) = (y.abs(), x.abs());
        let acute = match (up.hi == 0.0, up <= right) {
            (true, _) => Self::ZERO,
            (false, true) => (up / right).atan(),
            (false, false) => half - (right / up).atan(),
        };
        let angle = if x.is_negative() { Self::PI - acute } else { acute };
        if y.is_negative() { -angle } else { angle }
    }

    /// arcsin x = atan2(x, √((1 − x)(1 + x))).
    fn asin(self) -> Self {
        self.atan2(((Self::ONE - self) * (Self::ONE + self)).sqrt())
    }

    /// arccos x = 2 atan2(√(1 − x), √(1 + x)).
    fn acos(self) -> Self {
        let half = (Self::ONE - self).sqrt().atan2((Self::ONE + self).sqrt());
        half + half
    }

    fn sinh(self) -> Self {
        if self.hi.abs() < 1.0 {
            let square = self * self;
            return Self::series(self, |n| square / (2.0 * n * (2.0 * n + 1.0)).into());
        }
        // Halved first: e^x may be infinite where sinh is not.
        let root = (self.abs() * 0.5.into()).exp();
        let up = root * 0.5.into() * root;
        let value = up - Self::from(0.25) / up;
        if self.is_negative() { -value } else { value }
    }

    fn cosh(self) -> Self {
        let root = (self.abs() * 0.5.into()).exp();
        let up = root * 0.5.into() * root;
        up + Self::from(0.25) / up
    }

    fn tanh(self) -> Self {
        // 1 − 2e^(−2·40) is 1 to 34 digits.
        if self.hi.abs() > 40.0 {
            return self.hi.signum().into();
        }
        self.sinh() / self.cosh()
    }

    /// erf x = 2/√π e^(−x²) Σ 2ⁿ x^(2n+1)/(2n+1)!!: terms of one sign for every x.
    fn erf(self) -> Self {
        // 1 − erf 8.7 < 1e-34; the series would need ever more terms.
        if self.hi.abs() > 8.7 {
            return self.hi.signum().into();
        }
        let square = self * self;
        let twice = square + square;
        let sum = Self::series(self, |n| twice / (2.0 * n + 1.0).into());
        TWO_OVER_ROOT_PI * (-square).exp() * sum
    }

    /// erfc x: for x > 2 e^(−x²)/(x √π) over a continued fraction, evaluated from its far end.
    fn erfc(self) -> Self {
        if self.is_nan() || self.hi.is_infinite() || self.hi < 2.0 {
            return Self::ONE - self.erf();
        }
        if self.hi > 28.0 {
            return Self::ZERO;
        }
        let half = Self::from(0.5);
        let fraction = (1..TERMS).rev().fold(self, |f, n| self + half * f64::from(n).into() / f);
        TWO_OVER_ROOT_PI * half * (-(self * self)).exp() / fraction
    }

    /// sin(x)/x
    fn sinc(self) -> Self {
        match self.hi {
            0.0 => Self::ONE,
            x if x.is_infinite() => Self::ZERO,
            _ => self.sin_cos().0 / self,
        }
    }

    /// (sin(x)/x − cos x)/x², near 0 by its series ⅓ − x²/30 + ….
    fn sinc_ratio(self) -> Self {
        if self.hi.is_infinite() {
            return Self::ZERO;
        }
        if self.hi.abs() < 2.0 {
            let square = self * self * Self::from(-0.5);
            return Self::series(Self::ONE / 3.0.into(), |n| square / (n * (2.0 * n + 3.0)).into());
        }
        (self.sinc() - self.sin_cos().1) / self / self
    }

    /// J0(|x|), J1(|x|), J1(x)/x, J2(x)/x²: by power series, downward recurrence (Miller 1952) or Hankel's series, for
    /// growing x.
    fn bessel(self) -> [Self; 4] {
        let x = self.abs();
        if x.hi < 1.0 {
            let quarter = x * x * Self::from(-0.25);
            let [first, ratio, next] = [(1.0, 0.0), (0.5, 1.0), (0.125, 2.0)]
                .map(|(start, order)| Self::series(start.into(), |n| quarter / (n * (n + order)).into()));
            return [first, x * ratio, ratio, next];
        }
        if x.hi.is_infinite() {
            return [Self::ZERO; 4];
        }
        let [first, second] = if x.hi < 40.0 { x.miller() } else { [0.0, 1.0].map(|order| x.hankel(order)) };
        let ratio = second / x;
        [first, second, ratio, (ratio + ratio - first) / x / x]
    }

    /// J0 and J1 of 1 ≤ x < 40: Jₙ₋₁ = 2n/x Jₙ − Jₙ₊₁ from n = 120, with J0 + 2 J2 + 2 J4 + … = 1.
    fn miller(self) -> [Self; 2] {
        let [mut above, mut value, mut sum] = [Self::ZERO, Self::from(1e-200), Self::ZERO];
        for n in (1..=120).rev() {
            if n % 2 == 0 {
                sum = sum + value + value;
            }
            (above, value) = (value, Self::from(f64::from(2 * n)) / self * value - above);
        }
        [value / (sum + value), above / (sum + value)]
    }

    /// J0 or J1 of x ≥ 40: √(2/πx) (P cos χ − Q sin χ), P and Q until their terms are negligible.
    fn hankel(self, order: f64) -> Self {
        let (mut p, mut q, mut term) = (Self::ONE, Self::ZERO, Self::ONE);
        for k in 1..60 {
            let k = f64::from(k);
            let odd = 2.0 * k - 1.0;
            term = term * Self::from(4.0 * order * order - odd * odd) / (self * Self::from(8.0 * k));
            let sign = if k % 4.0 < 2.0 { Self::ONE } else { -Self::ONE };
            if k % 2.0 == 1.0 {
                q = q + sign * term
            } else {
                p = p + sign * term
            };
            if term.hi.abs() < NEGLIGIBLE {
                break;
            }
        }
        let (sin, cos) = self.sin_cos();
        let waves = if order == 0.0 { (p + q) * cos + (p - q) * sin } else { (p + q) * sin - (p - q) * cos };
        waves / (Self::PI.sqrt() * self.sqrt())
    }

    /// x^y for real y: e^(y ln x); a negative base requires a whole exponent.
    fn pow(self, y: Self) -> Self {
        let plain = libm::pow(self.hi, y.hi);
        let ordinary = self.hi != 0.0 && self.is_finite() && y.is_finite() && y.hi != 0.0 && !plain.is_nan();
        if !ordinary {
            return plain.into();
        }
        let size = (y * self.abs().log()).exp();
        if plain.is_sign_negative() { -size } else { size }
    }

    /// The value of an elementary function.
    pub fn call1(self, function: Function1) -> Self {
        match function {
            Function1::Exp => self.exp(),
            Function1::Log | Function1::LogVariance => self.log(),
            Function1::Sin => self.sin_cos().0,
            Function1::Cos => self.sin_cos().1,
            Function1::Tan => {
                let (sin, cos) = self.sin_cos();
                sin / cos
            }
            Function1::Asin => self.asin(),
            Function1::Acos => self.acos(),
            Function1::Atan => self.atan(),
            Function1::Sinh => self.sinh(),
            Function1::Cosh => self.cosh(),
            Function1::Tanh => self.tanh(),
            Function1::Erf => self.erf(),
            Function1::Erfc => self.erfc(),
            Function1::BesselJ0 => self.bessel()[0],
            Function1::BesselJ1 if self.is_negative() => -(-self).bessel()[1],
            Function1::BesselJ1 => self.bessel()[1],
            Function1::BesselRatio1 => self.bessel()[2],
            Function1::BesselRatio2 => self.bessel()[3],
            Function1::Sinc => self.sinc(),
            Function1::SincRatio => self.sinc_ratio(),
            Function1::Fraction if self.hi.is_infinite() => Self::ZERO,
            Function1::Fraction => {
                let floor = self.hi.floor();
                self - if floor == self.hi && self.lo < 0.0 { floor - 1.0 } else { floor }.into()
            }
            Function1::LogTail | Function1::Hazard => function.value(self.to_f64()).into(),
        }
    }

    /// The value of an elementary function of two arguments, in the order of [`Function2`].
    pub fn call2(self, function: Function2, other: Self) -> Self {
        match function {
            Function2::Atan2 => self.atan2(other),
            Function2::Pow => self.pow(other),
        }
    }
}

impl From<f64> for DoubleDouble {
    #[inline]
    fn from(x: f64) -> Self {
        Self { hi: x, lo: 0.0 }
    }
}

impl Neg for DoubleDouble {
    type Output = Self;
    #[inline]
    fn neg(self) -> Self {
        Self { hi: -self.hi, lo: -self.lo }
    }
}

impl Add for DoubleDouble {
    type Output = Self;
    #[inline]
    fn add(self, b: Self) -> Self {
        let (high, low) = (Self::sum(self.hi, b.hi), Self::sum(self.lo, b.lo));
        let first = Self::quick(high.hi, high.lo + low.hi);
        Self::quick(first.hi, first.lo + low.lo)
    }
}

impl Sub for DoubleDouble {
    type Output = Self;
    #[inline]
    fn sub(self, b: Self) -> Self {
        self + -b
    }
}

impl Mul for DoubleDouble {
    type Output = Self;
    #[inline]
    fn mul(self, b: Self) -> Self {
        let p = Self::product(self.hi, b.hi);
        if p.hi == 0.0 || !p.is_finite() {
            return p;
        }
        Self::quick(p.hi, p.lo + (self.hi * b.lo + self.lo * b.hi))
    }
}

impl Div for DoubleDouble {
    type Output = Self;
    #[inline]
    fn div(self, b: Self) -> Self {
        let first = self.hi / b.hi;
        if first == 0.0 || !first.is_finite() || b.hi.is_infinite() {
            return first.into();
        }
        let rest = self - b * first.into();
        let second = rest.hi / b.hi;
        let rest = rest - b * second.into();
        Self::quick(first, second) + (rest.hi / b.hi).into()
    }
}

impl PartialOrd for DoubleDouble {
    #[inline]
    fn partial_cmp(&self, b: &Self) -> Option<Ordering> {
        match self.hi.partial_cmp(&b.hi) {
            Some(Ordering::Equal) => self.lo.partial_cmp(&b.lo),
            order => order,
        }
    }
}

#[cfg(test)]
#[path = "double_double_tests.rs"]
mod tests;
