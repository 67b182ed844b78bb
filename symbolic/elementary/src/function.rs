//! The functions: the one table of their names.

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
    /// ln Q(z), Q the upper tail of the normal distribution; no word of the language.
    LogTail,
    /// φ(z)/Q(z); no word of the language.
    Hazard,
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
    /// The functions of the language, in the order of the numeric value.
    pub const ALL: [Function1; 12] = {
        use Function1::*;
        [Exp, Log, Sin, Cos, Tan, Asin, Acos, Atan, Sinh, Cosh, Tanh, Erf]
    };

    /// Those and the ones that a likelihood needs, in the order of the numeric value.
    pub const EVERY: [Function1; 14] = {
        use Function1::*;
        [Exp, Log, Sin, Cos, Tan, Asin, Acos, Atan, Sinh, Cosh, Tanh, Erf, LogTail, Hazard]
    };

    /// The name, in the formula language if it is a word of it.
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
            Function1::LogTail => "log_tail",
            Function1::Hazard => "hazard",
        }
    }

    /// The function of that name.
    pub fn named(name: &str) -> Option<Function1> {
        Function1::ALL.into_iter().find(|f| f.name() == name)
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
}
