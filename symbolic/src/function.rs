//! Elementary functions: the one table of their names and values.
//!
//! What comes in: a number. What goes out: the value that interpreter and native code share bit for bit: f64 by the
//! portable `libm`; f32 by computing in f64 and rounding once.

/// Functions of one argument.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
#[repr(u8)]
#[allow(missing_docs)]
pub enum Function1 {
    Exp,
    Log,
    Sin,
    Cos,
    Tan,
    Asin,
    Acos,
    Atan,
    Sinh,
    Cosh,
    Tanh,
    Erf,
}

/// Functions of two arguments.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
#[repr(u8)]
#[allow(missing_docs)]
pub enum Function2 {
    /// `atan2(y, x)`
    Atan2,
    /// `pow(base, exponent)`: real powers only; integer powers are multiplications.
    Pow,
}

impl Function1 {
    /// Every function, in the order of the numeric value; `table()[f as usize]` is its code.
    pub const ALL: [Function1; 12] = {
        use Function1::*;
        [Exp, Log, Sin, Cos, Tan, Asin, Acos, Atan, Sinh, Cosh, Tanh, Erf]
    };

    /// The name in the formula language.
    pub fn name(self) -> &'static str {
        match self {
            Function1::Exp => "exp",
            Function1::Log => "log",
            Function1::Sin => "sin",
            Function1::Cos => "cos",
            Function1::Tan => "tan",
            Function1::Asin => "asin",
            Function1::Acos => "acos",
            Function1::Atan => "atan",
            Function1::Sinh => "sinh",
            Function1::Cosh => "cosh",
            Function1::Tanh => "tanh",
            Function1::Erf => "erf",
        }
    }

    /// The function of that name.
    pub fn named(name: &str) -> Option<Function1> {
        Function1::ALL.into_iter().find(|f| f.name() == name)
    }

    /// The value in f64.
    pub fn value(self, x: f64) -> f64 {
        match self {
            Function1::Exp => libm::exp(x),
            Function1::Log => libm::log(x),
            Function1::Sin => libm::sin(x),
            Function1::Cos => libm::cos(x),
            Function1::Tan => libm::tan(x),
            Function1::Asin => libm::asin(x),
            Function1::Acos => libm::acos(x),
            Function1::Atan => libm::atan(x),
            Function1::Sinh => libm::sinh(x),
            Function1::Cosh => libm::cosh(x),
            Function1::Tanh => libm::tanh(x),
            Function1::Erf => libm::erf(x),
        }
    }
}

impl Function2 {
    /// Every function, in the order of the numeric value.
    pub const ALL: [Function2; 2] = [Function2::Atan2, Function2::Pow];

    /// The name in the formula language.
    pub fn name(self) -> &'static str {
        match self {
            Function2::Atan2 => "atan2",
            Function2::Pow => "pow",
        }
    }

    /// The value in f64.
    pub fn value(self, x: f64, y: f64) -> f64 {
        match self {
            Function2::Atan2 => libm::atan2(x, y),
            Function2::Pow => libm::pow(x, y),
        }
    }
}
