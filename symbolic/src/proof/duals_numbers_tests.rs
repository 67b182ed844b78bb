//! Hyper-dual numbers over any arithmetic.

use isophote_elementary::{DoubleDouble, Function1, Function2, Two, derivatives, derivatives2};

use super::grammar::PARAMETERS;
use crate::proof::evaluate::Number;
use crate::proof::weighed::Weighed;

/// Extends a program's arithmetic for the reference: may rounding decide which of two numbers is larger?
pub trait Scalar: Number {
    fn is_near(self, _other: Self) -> bool {
        false
    }
}
impl Scalar for DoubleDouble {}

impl Scalar for Weighed {
    fn is_near(self, other: Self) -> bool {
        let far = (self.value - other.value).abs() > 1e-9 * (self.terms + other.terms);
        !far
    }
}

const PAIRS: usize = PARAMETERS * (PARAMETERS + 1) / 2;

/// Value, gradient and upper Hessian.
#[derive(Clone, Copy)]
pub struct Hyper<N> {
    pub value: N,
    pub gradient: [N; PARAMETERS],
    pub hessian: [N; PAIRS],
    /// Depends on no parameter: its derivatives are exact zeros under any factor.
    pub is_fixed: bool,
}

/// Index of the Hessian's entry i ≤ j.
pub fn pair(i: usize, j: usize) -> usize {
    i * PARAMETERS - i * (i + 1) / 2 + j
}

impl<N: Scalar> Hyper<N> {
    pub fn fixed(value: N) -> Self {
        let zero = N::from(0.0);
        Hyper { value, gradient: [zero; PARAMETERS], hessian: [zero; PAIRS], is_fixed: true }
    }

    pub fn variable(value: f64, i: usize) -> Self {
        let mut x = Hyper::fixed(N::from(value));
        (x.gradient[i], x.is_fixed) = (N::from(1.0), false);
        x
    }

    /// f(self) from f, f′, f″.
    pub fn unary(&self, (value, slope, bend): (N, N, N)) -> Self {
        let mut y = Hyper::fixed(value);
        if self.is_fixed {
            return y;
        }
        y.is_fixed = false;
        for i in 0..PARAMETERS {
            y.gradient[i] = slope * self.gradient[i];
            for j in i..PARAMETERS {
                let k = pair(i, j);
                y.hessian[k] = slope * self.hessian[k] + bend * (self.gradient[i] * self.gradient[j]);
            }
        }
        y
    }

    /// f(self, b).
    pub fn binary(&self, b: &Self, f: &Two<N>) -> Self {
        match (self.is_fixed, b.is_fixed) {
            (_, true) => return self.unary((f.value, f.a, f.aa)),
            (true, _) => return b.unary((f.value, f.b, f.bb)),
            _ => {}
        }
        let mut y = Hyper::fixed(f.value);
        y.is_fixed = false;
        for i in 0..PARAMETERS {
            y.gradient[i] = f.a * self.gradient[i] + f.b * b.gradient[i];
            for j in i..PARAMETERS {
                let k = pair(i, j);
                let mixed = self.gradient[i] * b.gradient[j] + self.gradient[j] * b.gradient[i];
                let own = f.aa * (self.gradient[i] * self.gradient[j]) + f.bb * (b.gradient[i] * b.gradient[j]);
                y.hessian[k] = (f.a * self.hessian[k] + f.b * b.hessian[k]) + (own + f.ab * mixed);
            }
        }
        y
    }

    pub fn scaled(&self, by: f64) -> Self {
        let (by, zero) = (N::from(by), N::from(0.0));
        self.unary((by * self.value, by, zero))
    }

    pub fn add(&self, b: &Self) -> Self {
        let (one, zero) = (N::from(1.0), N::from(0.0));
        self.binary(b, &Two { value: self.value + b.value, a: one, b: one, aa: zero, ab: zero, bb: zero })
    }

    pub fn sub(&self, b: &Self) -> Self {
        self.add(&b.scaled(-1.0))
    }

    pub fn mul(&self, b: &Self) -> Self {
        let (one, zero) = (N::from(1.0), N::from(0.0));
        self.binary(b, &Two { value: self.value * b.value, a: b.value, b: self.value, aa: zero, ab: one, bb: zero })
    }

    pub fn inverse(&self) -> Self {
        let inverse = N::from(1.0) / self.value;
        let square = inverse * inverse;
        self.unary((inverse, -square, N::from(2.0) * square * inverse))
    }

    pub fn sqrt(&self) -> Self {
        let root = self.value.sqrt();
        let slope = N::from(0.5) / root;
        self.unary((root, slope, -(slope / (N::from(2.0) * self.value))))
    }

    /// x^c for a number c and x > 0.
    pub fn real_power(&self, c: f64) -> Self {
        let value = self.value.call2(Function2::Pow, N::from(c));
        let slope = N::from(c) * value / self.value;
        self.unary((value, slope, N::from(c - 1.0) * slope / self.value))
    }

    pub fn whole_power(&self, n: i32) -> Self {
        let power = (1..n.unsigned_abs()).fold(*self, |x, _| x.mul(self));
        if n < 0 { power.inverse() } else { power }
    }

    pub fn call1(&self, function: Function1) -> Self {
        self.unary(derivatives(function, self.value))
    }

    pub fn call2(&self, function: Function2, b: &Self) -> Self {
        self.binary(b, &derivatives2(function, self.value, b.value))
    }
}
