//! Double-double numbers: the referee of the self-check.
//!
//! What comes in: f64 values. What goes out: a number hi + lo of about 32 digits (106 bits), |lo| ≤ ½ ulp(hi), for the
//! operators and for every function of the language; at least 28 digits for arguments of ordinary size (likelihood's own
//! functions are as exact as f64). The range is that of f64; below 1e-290 there are fewer digits. NaN, ∞ follow f64.
//! It must never know: programs, formulas. It is written to be right, not to be fast.
//!
//! Sums and products: Dekker 1971, Knuth's two-sum. Functions: argument reduction with three-part constants, then a series
//! whose terms do not cancel.

use std::cmp::Ordering;
use std::ops::{Add, Div, Mul, Neg, Sub};

use crate::program::function::{Function1, Function2};

/// hi + lo, unevaluated.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct DoubleDouble {
    hi: f64,
    lo: f64,
}

/// A constant in three parts, 160 bits.
type Three = [f64; 3];
const LN_2: Three = [std::f64::consts::LN_2, 2.319_046_813_846_299_6e-17, 5.707_708_438_416_212e-34];
const HALF_PI: Three = [std::f64::consts::FRAC_PI_2, 6.123_233_995_736_766e-17, -1.497_384_904_859_169_8e-33];
const TWO_OVER_ROOT_PI: DoubleDouble =
    DoubleDouble { hi: std::f64::consts::FRAC_2_SQRT_PI, lo: 1.533_545_961_316_588e-17 };

/// No series needs more terms (erf at 8.7 needs 270).
const TERMS: u32 = 400;
/// A term this much smaller than the sum ends a series.
const NEGLIGIBLE: f64 = 1e-35;

/// a + b = s + e exactly.
fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let s = a + b;
    let t = s - a;
    (s, (a - (s - t)) + (b - t))
}

impl DoubleDouble {
    pub(crate) const ZERO: Self = Self { hi: 0.0, lo: 0.0 };
    pub(crate) const ONE: Self = Self { hi: 1.0, lo: 0.0 };
    pub(crate) const PI: Self = Self { hi: 2.0 * HALF_PI[0], lo: 2.0 * HALF_PI[1] };

    /// hi + lo for |hi| ≥ |lo|. What is not finite, or zero with its sign, has no low part.
    fn quick(hi: f64, lo: f64) -> Self {
        let s = hi + lo;
        if s.is_finite() && s != 0.0 { Self { hi: s, lo: lo - (s - hi) } } else { Self { hi: s, lo: 0.0 } }
    }

    /// a + b, exactly.
    pub(crate) fn sum(a: f64, b: f64) -> Self {
        let (hi, lo) = two_sum(a, b);
        if hi.is_finite() { Self { hi, lo } } else { Self { hi, lo: 0.0 } }
    }

    /// a · b, exactly.
    pub(crate) fn product(a: f64, b: f64) -> Self {
        let hi = a * b;
        if hi.is_finite() && hi != 0.0 { Self { hi, lo: a.mul_add(b, -hi) } } else { Self { hi, lo: 0.0 } }
    }

    /// The nearest f64.
    pub(crate) fn to_f64(self) -> f64 {
        self.hi
    }

    /// hi and lo.
    pub(crate) fn parts(self) -> [f64; 2] {
        [self.hi, self.lo]
    }

    pub(crate) fn is_nan(self) -> bool {
        self.hi.is_nan()
    }

    pub(crate) fn is_finite(self) -> bool {
        self.hi.is_finite()
    }

    fn is_negative(self) -> bool {
        self.hi.is_sign_negative()
    }

    pub(crate) fn abs(self) -> Self {
        if self.is_negative() { -self } else { self }
    }

    /// √x: one Newton step from the f64 root.
    pub(crate) fn sqrt(self) -> Self {
        let root = self.hi.sqrt();
        if root == 0.0 || !root.is_finite() {
            return root.into();
        }
        let rest = self - Self::product(root, root);
        Self::quick(root, rest.hi / (2.0 * root))
    }

    /// x · 2^k, exactly as far as the range goes; ∞ has no low part (which may be −∞).
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

    /// (sin x, cos x). From 2⁴⁰ on only the first part counts.
    fn sin_cos(self) -> (Self, Self) {
        let (r, k) = if self.hi.abs() < (1_u64 << 40) as f64 {
            let k = (self.hi / HALF_PI[0]).round();
            (self.reduced(k, HALF_PI), k)
        } else {
            let ([hi, lo], k) = crate::program::elementary::reduced(self.hi.abs());
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
        // e^x may be infinite where sinh is not: halved before.
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

    /// x^y for real y: e^(y ln x); a negative base only with a whole exponent.
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
    pub(crate) fn call1(self, function: Function1) -> Self {
        match function {
            Function1::Exp => self.exp(),
            Function1::Log => self.log(),
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
            Function1::LogTail | Function1::Hazard => function.value(self.to_f64()).into(),
        }
    }

    /// The value of an elementary function of two arguments, in the order of [`Function2`].
    pub(crate) fn call2(self, function: Function2, other: Self) -> Self {
        match function {
            Function2::Atan2 => self.atan2(other),
            Function2::Pow => self.pow(other),
        }
    }
}

impl From<f64> for DoubleDouble {
    fn from(x: f64) -> Self {
        Self { hi: x, lo: 0.0 }
    }
}

impl Neg for DoubleDouble {
    type Output = Self;
    fn neg(self) -> Self {
        Self { hi: -self.hi, lo: -self.lo }
    }
}

impl Add for DoubleDouble {
    type Output = Self;
    fn add(self, b: Self) -> Self {
        let (high, low) = (Self::sum(self.hi, b.hi), Self::sum(self.lo, b.lo));
        let first = Self::quick(high.hi, high.lo + low.hi);
        Self::quick(first.hi, first.lo + low.lo)
    }
}

impl Sub for DoubleDouble {
    type Output = Self;
    fn sub(self, b: Self) -> Self {
        self + -b
    }
}

impl Mul for DoubleDouble {
    type Output = Self;
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
    fn partial_cmp(&self, b: &Self) -> Option<Ordering> {
        match self.hi.partial_cmp(&b.hi) {
            Some(Ordering::Equal) => self.lo.partial_cmp(&b.lo),
            order => order,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{DoubleDouble, Function1, Function2};

    fn from(x: f64) -> DoubleDouble {
        x.into()
    }

    /// A decimal number such as `-1.25e-3`, digit by digit.
    fn decimal(text: &str) -> DoubleDouble {
        let (mantissa, exponent) = text.split_once('e').unwrap_or((text, "0"));
        let (negative, digits) = mantissa.strip_prefix('-').map_or((false, mantissa), |rest| (true, rest));
        let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
        let all = whole.chars().chain(fraction.chars()).map(|c| f64::from(c.to_digit(10).unwrap()));
        let number = all.fold(DoubleDouble::ZERO, |n, digit| n * from(10.0) + from(digit));
        let places = exponent.parse::<i32>().unwrap() - fraction.len() as i32;
        let tens = (0..places.abs()).fold(DoubleDouble::ONE, |t, _| t * from(10.0));
        let value = if places < 0 { number / tens } else { number * tens };
        if negative { -value } else { value }
    }

    #[track_caller]
    fn close(found: DoubleDouble, expected: DoubleDouble, what: &str) {
        let error = ((found - expected) / expected).abs().to_f64();
        let error = if expected == DoubleDouble::ZERO { found.abs().to_f64() } else { error };
        assert!(error <= 1e-28, "{what}: {found:?} instead of {expected:?}, error {error:e}");
    }

    #[test]
    fn known_values() {
        use Function1::*;
        let (tiny, small) = (2_f64.powi(-20), 2_f64.powi(-10));
        let table = [
            (Exp, 1.0, "2.7182818284590452353602874713526625"),
            (Exp, -30.0, "9.3576229688401746049158322233787067e-14"),
            (Exp, 0.125, "1.1331484530668263168290072278117939"),
            (Log, 2.0, "0.69314718055994530941723212145817657"),
            (Log, 10.0, "2.3025850929940456840179914546843642"),
            (Log, 1.0 + tiny, "9.5367386165918823390841551496333614e-7"),
            (Sin, 1.0, "0.84147098480789650665250232163029900"),
            (Cos, 1.0, "0.54030230586813971740093660744297660"),
            (Tan, 1.0, "1.5574077246549022305069748074583602"),
            (Sin, 1000.0, "0.82687954053200256025588742910921814"),
            (Cos, 1e6, "0.93675212753314478693853253507491878"),
            (Atan, 0.5, "0.46364760900080611621425623146121440"),
            (Asin, 0.5, "0.52359877559829887307710723054658381"),
            (Acos, 0.5, "1.0471975511965977461542144610931676"),
            (Atan, 1e300, "1.5707963267948966192313216916397514"),
            (Acos, -1.0, "3.1415926535897932384626433832795028841972"),
            (Erf, 0.5, "0.52049987781304653768274665389196453"),
            (Erf, 1.0, "0.84270079294971486934122063508260926"),
            (Erf, -3.0, "-0.99997790950300141455862722387041768"),
            (Erf, 6.0, "0.99999999999999997848026328750108688"),
            (Sinh, 1.0, "1.1752011936438014568823818505956008"),
            (Sinh, small, "9.7656265522043650406675150063853807e-4"),
            (Sinh, -5.0, "-74.203210577788758977009471996064566"),
            (Cosh, 1.0, "1.5430806348152437784779056207570617"),
            (Tanh, 1.0, "0.76159415595576488811945828260479359"),
            (Tanh, small, "9.7656218955926021858407527014677176e-4"),
            (Tanh, 5.0, "0.99990920426259513121099044753447302"),
        ];
        for (function, x, expected) in table {
            close(from(x).call1(function), decimal(expected), &format!("{} {x}", function.name()));
        }
        close(from(2.0).sqrt(), decimal("1.4142135623730950488016887242096981"), "sqrt");
        let pow = |x: f64, y: f64| from(x).call2(Function2::Pow, from(y));
        close(pow(10.0, -7.25), decimal("5.6234132519034908039495103977648123e-8"), "pow");
        close(pow(3.0, 100.5), decimal("8.9266005098672602579375861848449120e47"), "pow");
        close(pow(-2.0, 3.0), from(-8.0), "pow");
        let atan2 = |y: f64, x: f64| from(y).call2(Function2::Atan2, from(x));
        close(atan2(1.0, -3.0), decimal("2.8198420991931510450612387689208416"), "atan2");
        close(atan2(-5.0, 0.0), decimal("-1.5707963267948966192313216916397514"), "atan2");
    }

    #[test]
    fn identities() {
        let one = DoubleDouble::ONE;
        for i in 1..400 {
            let t = from(f64::from(i)) / from(61.0);
            let what = format!("{i}/61");
            close(t * t / t, t, &what);
            close(t.sqrt() * t.sqrt(), t, &what);
            close(t.exp() * (-t).exp(), one, &what);
            close(t.exp().log(), t, &what);
            close(t.log().exp(), t, &what);
            let (sin, cos) = t.sin_cos();
            close(sin * sin + cos * cos, one, &what);
            close((sin + sin) * cos, (t + t).sin_cos().0, &what);
            close((sin / cos).atan().call1(Function1::Tan), sin / cos, &what);
            close(t.sinh() * t.cosh() + t.sinh() * t.cosh(), (t + t).sinh(), &what);
            close(t.tanh() * t.cosh(), t.sinh(), &what);
            let part = t / from(7.0);
            if part <= one {
                close(part.asin().sin_cos().0, part, &what);
                close(part.acos().sin_cos().1, part, &what);
            }
            close(part.pow(t) * part.pow(-t), one, &what);
        }
    }

    /// Where a result is small against its operands it keeps its own digits: ln(1 + t) = t − t²/2 + t³/3 for t = 1e-12 to t⁴.
    #[test]
    fn small_differences() {
        let t = from(2_f64.powi(-45));
        let series = t - t * t / from(2.0) + t * t * t / from(3.0);
        close((DoubleDouble::ONE + t).log(), series, "ln(1 + t)");
        assert_eq!(DoubleDouble::sum(1.0, 1e-30) - DoubleDouble::ONE, from(1e-30));
    }

    #[test]
    fn special_values_are_those_of_f64() {
        let numbers =
            [0.0, -0.0, 1.0, -1.0, 2.5, -3.0, 1e308, -1e308, 1e-308, f64::INFINITY, f64::NEG_INFINITY, f64::NAN];
        let same = |found: DoubleDouble, expected: f64, what: String| {
            let near = (found.to_f64() - expected).abs() <= 4.0 * f64::EPSILON * expected.abs();
            let alike = found.to_f64().to_bits() == expected.to_bits() || (found.is_nan() && expected.is_nan());
            assert!(near || alike, "{what}: {found:?} instead of {expected:e}");
            assert!(found.is_finite() || found.lo == 0.0, "{what}: {found:?}");
        };
        for x in numbers {
            for function in Function1::ALL {
                same(from(x).call1(function), function.value(x), format!("{} {x:e}", function.name()));
            }
            same(from(x).sqrt(), x.sqrt(), format!("sqrt {x:e}"));
            for y in numbers {
                let (a, b) = (from(x), from(y));
                same(a + b, x + y, format!("{x:e} + {y:e}"));
                same(a - b, x - y, format!("{x:e} - {y:e}"));
                same(a * b, x * y, format!("{x:e} * {y:e}"));
                same(a / b, x / y, format!("{x:e} / {y:e}"));
                assert_eq!(a.partial_cmp(&b), x.partial_cmp(&y));
                for function in Function2::ALL {
                    same(a.call2(function, b), function.value(x, y), format!("{} {x:e} {y:e}", function.name()));
                }
            }
        }
    }
}
