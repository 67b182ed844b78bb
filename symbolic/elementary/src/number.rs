//! Arithmetics that evaluate formulas: sums, products and elementary functions in f64, in double-double, or as residues
//! ([`crate::Modular`]); other crates may add their own.

use std::ops::{Add, Div, Mul, Neg, Sub};

use crate::{DoubleDouble, Function1, Function2, Lookup, Tables};

/// An arithmetic.
pub trait Number:
    Copy
    + PartialOrd
    + From<f64>
    + Neg<Output = Self>
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
{
    /// |x|.
    fn abs(self) -> Self;
    /// √x.
    fn sqrt(self) -> Self;
    /// x · b + c, with one rounding where the arithmetic has it.
    fn fma(self, b: Self, c: Self) -> Self {
        self * b + c
    }
    /// An elementary function.
    fn call1(self, function: Function1) -> Self;
    /// An elementary function of two arguments.
    fn call2(self, function: Function2, other: Self) -> Self;
    /// A table's number, at the position (self, other).
    fn look_up(self, other: Self, tables: &Tables, lookup: Lookup) -> Self;
    /// Drops the record of the terms that the number was made of, if the arithmetic keeps one.
    fn alone(self) -> Self {
        self
    }
    /// Adds the record of these operands to a result that was computed from them alone.
    fn made_of(self, _a: Self, _b: Option<Self>) -> Self {
        self
    }
    /// 2 / √π.
    fn two_over_root_pi() -> Self {
        Self::from(std::f64::consts::FRAC_2_SQRT_PI)
    }
}

impl Number for f64 {
    #[inline]
    fn abs(self) -> f64 {
        f64::abs(self)
    }
    #[inline]
    fn sqrt(self) -> f64 {
        f64::sqrt(self)
    }
    #[inline]
    fn call1(self, function: Function1) -> f64 {
        function.value(self)
    }
    #[inline]
    fn call2(self, function: Function2, other: f64) -> f64 {
        function.value(self, other)
    }
    #[inline]
    fn look_up(self, other: f64, tables: &Tables, lookup: Lookup) -> f64 {
        tables.look_up(lookup, self, other)
    }
}

impl Number for DoubleDouble {
    #[inline]
    fn abs(self) -> Self {
        self.abs()
    }
    #[inline]
    fn sqrt(self) -> Self {
        self.sqrt()
    }
    #[inline]
    fn call1(self, function: Function1) -> Self {
        self.call1(function)
    }
    #[inline]
    fn call2(self, function: Function2, other: Self) -> Self {
        self.call2(function, other)
    }
    #[inline]
    fn look_up(self, other: Self, tables: &Tables, lookup: Lookup) -> Self {
        let [a, b] = [self, other].map(|place| (place - place.call1(Function1::Fraction)).to_f64());
        tables.look_up(lookup, a, b).into()
    }
    #[inline]
    fn two_over_root_pi() -> Self {
        Self::from(2.0) / Self::from(-1.0).call1(Function1::Acos).sqrt()
    }
}
