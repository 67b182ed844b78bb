//! Elementary functions as vector code.
//!
//! A function's value, for an f64 or a vector of them, is within 2 units in the last place of f64 (erfc 5, Bessel
//! functions 80 of the height of their waves), or of f32, where the caller rounds to it. Each function is written once,
//! over a [`Machine`]: [`Plain`] evaluates it and defines its value, the JIT turns it into vector instructions, a
//! [`Counter`] counts them. [`DoubleDouble`] and [`ulps`] measure errors, [`Modular`] tests whether two formulas are
//! the same; [`Table`] holds measured profiles; a [`Number`] is any arithmetic that evaluates formulas, with the
//! functions' [`derivatives`].

#![forbid(unsafe_code)]

mod arithmetic;
mod bessel;
mod calculus;
mod coefficients;
mod counter;
mod double_double;
mod error_function;
mod exponential;
mod function;
mod hyperbolic;
mod inverse;
mod large;
mod logarithm;
mod machine;
mod modular;
mod number;
mod plain;
mod power;
mod sinc;
mod table;
mod tail;
#[cfg(test)]
mod tests;
mod trigonometric;
pub mod ulps;
mod wave_coefficients;

pub use arithmetic::MAGIC;
pub use calculus::{Two, derivatives, derivatives2};
pub use counter::Counter;
pub use double_double::DoubleDouble;
pub use function::{Function1, Function2};
pub use machine::{Accuracy, Machine};
pub use modular::Modular;
pub use number::Number;
pub use plain::Plain;
pub use table::{Axis, Lookup, Table, Tables};

/// The value of a function of one argument.
#[inline(always)]
pub fn call1<M: Machine>(m: &M, function: Function1, accuracy: Accuracy, x: M::Number) -> M::Number {
    match function {
        Function1::Exp => exponential::exp(m, accuracy, x),
        Function1::Log => logarithm::log(m, accuracy, x),
        Function1::Sin => trigonometric::sin(m, accuracy, x),
        Function1::Cos => trigonometric::cos(m, accuracy, x),
        Function1::Tan => trigonometric::tan(m, accuracy, x),
        Function1::Asin => inverse::asin(m, accuracy, x),
        Function1::Acos => inverse::acos(m, accuracy, x),
        Function1::Atan => inverse::atan(m, accuracy, x),
        Function1::Sinh => hyperbolic::sinh(m, accuracy, x),
        Function1::Cosh => hyperbolic::cosh(m, accuracy, x),
        Function1::Tanh => hyperbolic::tanh(m, accuracy, x),
        Function1::Erf => error_function::erf(m, accuracy, x),
        Function1::Erfc => error_function::erfc(m, accuracy, x),
        Function1::BesselJ0 => bessel::j0(m, accuracy, x),
        Function1::BesselJ1 => bessel::j1(m, accuracy, x),
        Function1::Sinc => sinc::sinc(m, accuracy, x),
        Function1::LogTail => tail::log_tail(m, accuracy, x),
        Function1::Hazard => tail::hazard(m, accuracy, x),
        Function1::BesselRatio1 => bessel::ratio1(m, accuracy, x),
        Function1::BesselRatio2 => bessel::ratio2(m, accuracy, x),
        Function1::SincRatio => sinc::ratio(m, accuracy, x),
        Function1::Fraction => arithmetic::fraction(m, x),
        Function1::LogVariance => logarithm::log_variance(m, accuracy, x),
    }
}

/// The value of a function of two arguments, in the order of [`Function2`].
#[inline(always)]
pub fn call2<M: Machine>(m: &M, function: Function2, accuracy: Accuracy, a: M::Number, b: M::Number) -> M::Number {
    match function {
        Function2::Atan2 => inverse::atan2(m, accuracy, a, b),
        Function2::Pow => power::pow(m, accuracy, a, b),
    }
}

impl Function1 {
    /// The value in f64 without fused operations, as on every level but the pixel's.
    pub fn value(self, x: f64) -> f64 {
        self.value_with(Plain { fused: false }, Accuracy::Double, x)
    }

    /// The value on a machine. [`Accuracy::Single`] requires f32 arguments and a result rounded to f32.
    pub fn value_with(self, machine: Plain, accuracy: Accuracy, x: f64) -> f64 {
        match accuracy {
            Accuracy::Single if self.is_single() => {
                call1(&plain::PlainSingle { fused: machine.fused }, self, accuracy, x as f32).into()
            }
            _ => call1(&machine, self, accuracy, x),
        }
    }
}

impl Function2 {
    /// The value in f64, see [`Function1::value`].
    pub fn value(self, x: f64, y: f64) -> f64 {
        self.value_with(Plain { fused: false }, Accuracy::Double, x, y)
    }

    /// The value on a machine, see [`Function1::value_with`].
    pub fn value_with(self, machine: Plain, accuracy: Accuracy, x: f64, y: f64) -> f64 {
        call2(&machine, self, accuracy, x, y)
    }
}
