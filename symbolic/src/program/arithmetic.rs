//! The arithmetic in which an operation is worked out, and the cells that hold values.

use crate::program::Comparison;
use crate::program::elementary::{Accuracy, Plain};
use crate::program::function::{Function1, Function2};

/// Numbers, and what is done with them.
pub(crate) trait Arithmetic: Copy {
    type Number: Copy;
    fn constant(self, x: f64) -> Self::Number;
    fn neg(self, a: Self::Number) -> Self::Number;
    fn abs(self, a: Self::Number) -> Self::Number;
    fn sqrt(self, a: Self::Number) -> Self::Number;
    fn add(self, a: Self::Number, b: Self::Number) -> Self::Number;
    fn sub(self, a: Self::Number, b: Self::Number) -> Self::Number;
    fn mul(self, a: Self::Number, b: Self::Number) -> Self::Number;
    fn div(self, a: Self::Number, b: Self::Number) -> Self::Number;
    /// a · b + c, with one rounding where there is rounding.
    fn fma(self, a: Self::Number, b: Self::Number, c: Self::Number) -> Self::Number;
    fn call1(self, function: Function1, a: Self::Number) -> Self::Number;
    fn call2(self, function: Function2, a: Self::Number, b: Self::Number) -> Self::Number;
    fn holds(self, comparison: Comparison, a: Self::Number, b: Self::Number) -> bool;
}

/// A value: a number or a truth value.
#[derive(Clone, Copy)]
pub(crate) enum Cell<N> {
    Number(N),
    Truth(bool),
}

impl<N: Copy> Cell<N> {
    pub fn number(self, m: impl Arithmetic<Number = N>) -> N {
        match self {
            Cell::Number(x) => x,
            Cell::Truth(b) => m.constant(f64::from(u8::from(b))),
        }
    }
    pub fn truth(self) -> bool {
        matches!(self, Cell::Truth(true))
    }
    /// The same in another arithmetic.
    pub fn map<M>(self, to: impl FnOnce(N) -> M) -> Cell<M> {
        match self {
            Cell::Number(x) => Cell::Number(to(x)),
            Cell::Truth(b) => Cell::Truth(b),
        }
    }
}

/// True when the comparison holds.
pub(crate) fn holds<N: PartialOrd>(comparison: Comparison, a: N, b: N) -> bool {
    match comparison {
        Comparison::Lt => a < b,
        Comparison::Le => a <= b,
        Comparison::Eq => a == b,
        Comparison::Ne => a != b,
    }
}

/// The f32 of a lane; elementary functions are computed in f64 on `Plain` and rounded once.
#[derive(Clone, Copy)]
pub(crate) struct Single(pub Plain);
/// An f64: of a lane, or, on a machine that fuses nothing, of every other level.
#[derive(Clone, Copy)]
pub(crate) struct Double(pub Plain);

macro_rules! native {
    ($name:ident, $type:ty, $accuracy:expr) => {
        impl Arithmetic for $name {
            type Number = $type;
            fn constant(self, x: f64) -> $type {
                x as $type
            }
            fn neg(self, a: $type) -> $type {
                -a
            }
            fn abs(self, a: $type) -> $type {
                a.abs()
            }
            fn sqrt(self, a: $type) -> $type {
                a.sqrt()
            }
            fn add(self, a: $type, b: $type) -> $type {
                a + b
            }
            fn sub(self, a: $type, b: $type) -> $type {
                a - b
            }
            fn mul(self, a: $type, b: $type) -> $type {
                a * b
            }
            fn div(self, a: $type, b: $type) -> $type {
                a / b
            }
            fn fma(self, a: $type, b: $type, c: $type) -> $type {
                a.mul_add(b, c)
            }
            fn call1(self, f: Function1, a: $type) -> $type {
                f.value_with(self.0, $accuracy, f64::from(a)) as $type
            }
            fn call2(self, f: Function2, a: $type, b: $type) -> $type {
                f.value_with(self.0, $accuracy, f64::from(a), f64::from(b)) as $type
            }
            fn holds(self, comparison: Comparison, a: $type, b: $type) -> bool {
                holds(comparison, a, b)
            }
        }
    };
}
native!(Single, f32, Accuracy::Single);
native!(Double, f64, Accuracy::Double);
