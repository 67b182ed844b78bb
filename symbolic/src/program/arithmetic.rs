//! Number types in which operations are evaluated, and the cells that hold values.

use std::ops::{Add, Div, Mul, Neg, Sub};

pub(crate) use isophote_elementary::Number;
use isophote_elementary::{Accuracy, Function1, Function2, Lookup, Plain, Tables};

/// Ordered comparisons: false when an operand is NaN, except `Ne`, which is true then.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Comparison {
    /// <
    Lt,
    /// ≤
    Le,
    /// =
    Eq,
    /// ≠
    Ne,
}

/// One lane of f32; elementary functions run in f64, with fused multiply-add if `FUSED`, and round once.
#[derive(Clone, Copy, PartialEq, PartialOrd)]
pub(crate) struct Single<const FUSED: bool>(f32);
/// One lane of f64.
#[derive(Clone, Copy, PartialEq, PartialOrd)]
pub(crate) struct Double<const FUSED: bool>(f64);

macro_rules! lane {
    ($name:ident, $type:ty, $accuracy:expr, $($operator:ident $function:ident)*) => {
        impl<const FUSED: bool> From<f64> for $name<FUSED> {
            fn from(x: f64) -> Self {
                $name(x as $type)
            }
        }
        impl<const FUSED: bool> From<$name<FUSED>> for f64 {
            fn from(x: $name<FUSED>) -> f64 {
                x.0 as f64
            }
        }
        impl<const FUSED: bool> Neg for $name<FUSED> {
            type Output = Self;
            fn neg(self) -> Self {
                $name(-self.0)
            }
        }
        $(impl<const FUSED: bool> $operator for $name<FUSED> {
            type Output = Self;
            fn $function(self, b: Self) -> Self {
                $name(self.0.$function(b.0))
            }
        })*
        impl<const FUSED: bool> Number for $name<FUSED> {
            fn abs(self) -> Self {
                $name(self.0.abs())
            }
            fn sqrt(self) -> Self {
                $name(self.0.sqrt())
            }
            fn fma(self, b: Self, c: Self) -> Self {
                $name(self.0.mul_add(b.0, c.0))
            }
            fn call1(self, function: Function1) -> Self {
                Self::from(function.value_with(Plain { fused: FUSED }, $accuracy, self.into()))
            }
            fn call2(self, function: Function2, other: Self) -> Self {
                Self::from(function.value_with(Plain { fused: FUSED }, $accuracy, self.into(), other.into()))
            }
            fn look_up(self, other: Self, tables: &Tables, lookup: Lookup) -> Self {
                Self::from(tables.look_up(lookup, self.into(), other.into()))
            }
        }
    };
}
lane!(Single, f32, Accuracy::Single, Add add Sub sub Mul mul Div div);
lane!(Double, f64, Accuracy::Double, Add add Sub sub Mul mul Div div);

/// A value: a number or a truth value.
#[derive(Clone, Copy)]
pub(crate) enum Cell<N> {
    Number(N),
    Truth(bool),
}

impl<N: Number> Cell<N> {
    pub fn number(self) -> N {
        match self {
            Cell::Number(x) => x,
            Cell::Truth(b) => N::from(f64::from(u8::from(b))),
        }
    }
    pub fn truth(self) -> bool {
        matches!(self, Cell::Truth(true))
    }
    /// Converts the number to another type.
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
