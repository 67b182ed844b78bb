//! An arithmetic that carries the sum of the absolute terms with each value, as the scale of rounding errors.

use std::ops::{Add, Div, Mul, Neg, Sub};

use isophote_elementary::{Function1, Function2, Lookup, Tables, derivatives, derivatives2};

use crate::proof::SMALLEST;
use crate::proof::evaluate::Number;

/// A value, and the sum of the absolute values of its terms, each scaled by its effect on the result.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Weighed {
    pub value: f64,
    pub terms: f64,
}

impl PartialEq for Weighed {
    fn eq(&self, b: &Self) -> bool {
        self.value == b.value
    }
}
impl PartialOrd for Weighed {
    fn partial_cmp(&self, b: &Self) -> Option<std::cmp::Ordering> {
        self.value.partial_cmp(&b.value)
    }
}
impl From<f64> for Weighed {
    fn from(x: f64) -> Self {
        Weighed { value: x, terms: x.abs() }
    }
}
impl Neg for Weighed {
    type Output = Self;
    fn neg(self) -> Self {
        Weighed { value: -self.value, ..self }
    }
}
impl Add for Weighed {
    type Output = Self;
    fn add(self, b: Self) -> Self {
        Weighed { value: self.value + b.value, terms: self.terms + b.terms }
    }
}
impl Sub for Weighed {
    type Output = Self;
    fn sub(self, b: Self) -> Self {
        self + -b
    }
}
impl Mul for Weighed {
    type Output = Self;
    fn mul(self, b: Self) -> Self {
        Weighed { value: self.value * b.value, terms: self.terms * b.terms }
    }
}
impl Div for Weighed {
    type Output = Self;
    fn div(self, b: Self) -> Self {
        let inverse = Weighed { value: 1.0 / b.value, terms: b.terms / b.value.abs() / b.value.abs() };
        Weighed { value: self.value / b.value, ..self * inverse }
    }
}

impl Weighed {
    /// Magnitude of the value, at least the rounding error of its terms.
    fn size(self) -> f64 {
        self.value.abs().max(f64::EPSILON * self.terms).max(SMALLEST)
    }
    /// Ratio of the terms to the size: the degree of cancellation.
    fn cancelled(self) -> f64 {
        (self.terms / self.size()).max(1.0)
    }
}

impl Number for Weighed {
    fn alone(self) -> Self {
        Weighed { terms: self.size(), ..self }
    }
    /// To first order: a program that reads a number unchanged does not expand its terms.
    fn made_of(self, a: Self, b: Option<Self>) -> Self {
        let cancelled = a.cancelled() + b.map_or(0.0, Weighed::cancelled);
        Weighed { terms: self.terms * cancelled, ..self }
    }
    fn abs(self) -> Self {
        Weighed { value: self.value.abs(), ..self }
    }
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        Weighed { value: root, terms: self.terms / root }
    }
    fn call1(self, function: Function1) -> Self {
        let (value, slope, _) = derivatives(function, self.value);
        Weighed { value, terms: slope.abs() * self.terms + value.abs() }
    }
    fn call2(self, function: Function2, other: Self) -> Self {
        let two = derivatives2(function, self.value, other.value);
        let terms = two.a.abs() * self.terms + two.b.abs() * other.terms + two.value.abs();
        Weighed { value: two.value, terms }
    }
    fn look_up(self, other: Self, tables: &Tables, lookup: Lookup) -> Self {
        tables.look_up(lookup, self.value, other.value).into()
    }
}
