//! Hyper-dual numbers over any arithmetic, and an arithmetic that keeps the sum of the absolute terms beside its value.

use std::ops::{Add, Div, Mul, Neg, Sub};

use crate::double_double::DoubleDouble;
use crate::evaluate::Number;
use crate::function::{Function1, Function2};

/// What the reference asks of an arithmetic beyond a program's: may rounding decide which of the two is larger?
pub trait Scalar: Number {
    fn is_near(self, _other: Self) -> bool {
        false
    }
}
impl Scalar for DoubleDouble {}

/// A value, and the sum of the absolute values of the terms that it was made of, each scaled by how it acts on the result.
#[derive(Clone, Copy, Debug)]
pub struct Weighed {
    pub value: f64,
    pub terms: f64,
}

impl Scalar for Weighed {
    fn is_near(self, other: Self) -> bool {
        let far = (self.value - other.value).abs() > 1e-9 * (self.terms + other.terms);
        !far
    }
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

impl Number for Weighed {
    fn to_f64(self) -> f64 {
        self.value
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
}

/// f, f′, f″.
pub fn derivatives<N: Number>(function: Function1, x: N) -> (N, N, N) {
    let (one, two) = (N::from(1.0), N::from(2.0));
    let f = x.call1(function);
    match function {
        Function1::Exp => (f, f, f),
        Function1::Log => (f, one / x, -(one / (x * x))),
        Function1::Sin => (f, x.call1(Function1::Cos), -f),
        Function1::Cos => (f, -x.call1(Function1::Sin), -f),
        Function1::Tan => (f, one + f * f, two * f * (one + f * f)),
        Function1::Asin | Function1::Acos => {
            let square = one - x * x;
            let slope = one / square.sqrt();
            let slope = if function == Function1::Asin { slope } else { -slope };
            (f, slope, x * slope / square)
        }
        Function1::Atan => {
            let slope = one / (one + x * x);
            (f, slope, -(two * x * slope * slope))
        }
        Function1::Sinh => (f, x.call1(Function1::Cosh), f),
        Function1::Cosh => (f, x.call1(Function1::Sinh), f),
        Function1::Tanh => {
            let slope = one - f * f;
            (f, slope, -(two * f * slope))
        }
        Function1::Erf => {
            let pi = (-one).call1(Function1::Acos);
            let slope = two / pi.sqrt() * (-(x * x)).call1(Function1::Exp);
            (f, slope, -(two * x * slope))
        }
    }
}

/// A function of two arguments, and its five derivatives.
pub struct Two<N> {
    pub value: N,
    pub a: N,
    pub b: N,
    pub aa: N,
    pub ab: N,
    pub bb: N,
}

pub fn derivatives2<N: Number>(function: Function2, x: N, y: N) -> Two<N> {
    let (one, two) = (N::from(1.0), N::from(2.0));
    let value = x.call2(function, y);
    match function {
        // angle(x, y) = atan2(first, second)
        Function2::Atan2 => {
            let square = x * x + y * y;
            let mixed = (x * x - y * y) / (square * square);
            let bend = two * x * y / (square * square);
            Two { value, a: y / square, b: -(x / square), aa: -bend, ab: mixed, bb: bend }
        }
        Function2::Pow => {
            let log = x.call1(Function1::Log);
            let by = value / x;
            Two {
                value,
                a: y * by,
                b: value * log,
                aa: y * (y - one) * by / x,
                ab: by * (one + y * log),
                bb: value * log * log,
            }
        }
    }
}

pub const PARAMETERS: usize = 6;
const PAIRS: usize = PARAMETERS * (PARAMETERS + 1) / 2;

/// Value, gradient and upper Hessian.
#[derive(Clone, Copy)]
pub struct Hyper<N> {
    pub value: N,
    pub gradient: [N; PARAMETERS],
    pub hessian: [N; PAIRS],
    /// No parameter is in it: its derivatives are exact zeros, whatever they are multiplied by.
    pub is_fixed: bool,
}

/// Where the Hessian's entry i ≤ j is kept.
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
