//! The functions and their names.

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
    /// 1 − erf
    Erfc,
    /// Bessel's J0
    BesselJ0,
    /// Bessel's J1
    BesselJ1,
    /// sin(x)/x, 1 at 0
    Sinc,
    /// ln Q(z), Q the upper tail of the normal distribution; not in the formula language.
    LogTail,
    /// φ(z)/Q(z); not in the formula language.
    Hazard,
    /// J1(x)/x; not in the formula language.
    BesselRatio1,
    /// J2(x)/x²; not in the formula language.
    BesselRatio2,
    /// (sin(x)/x − cos x)/x², which is −sinc′(x)/x; not in the formula language.
    SincRatio,
    /// x − ⌊x⌋, 0 at ±∞: the position in a table's cell; not in the formula language.
    Fraction,
    /// ln x of a pixel's variance, for sums: in lanes of f32 to a unit in the last place; not in the formula language.
    LogVariance,
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
    /// The functions of the formula language, in the order of the numeric value.
    pub const ALL: [Function1; 16] = {
        use Function1::*;
        [Exp, Log, Sin, Cos, Tan, Asin, Acos, Atan, Sinh, Cosh, Tanh, Erf, Erfc, BesselJ0, BesselJ1, Sinc]
    };

    /// All functions, with those for likelihoods and derivatives, in the order of the numeric value.
    pub const EVERY: [Function1; 23] = {
        use Function1::*;
        let mut every = [Exp; 23];
        every.split_at_mut(16).0.copy_from_slice(&Function1::ALL);
        let others = [LogTail, Hazard, BesselRatio1, BesselRatio2, SincRatio, Fraction, LogVariance];
        every.split_at_mut(16).1.copy_from_slice(&others);
        every
    };

    /// The name; that of the formula language for its functions.
    pub fn name(self) -> &'static str {
        match self {
            Function1::Exp => "exp",
            Function1::Log | Function1::LogVariance => "log",
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
            Function1::Erfc => "erfc",
            Function1::BesselJ0 => "bessel_j0",
            Function1::BesselJ1 => "bessel_j1",
            Function1::Sinc => "sinc",
            Function1::LogTail => "log_tail",
            Function1::Hazard => "hazard",
            Function1::BesselRatio1 => "bessel_ratio1",
            Function1::BesselRatio2 => "bessel_ratio2",
            Function1::SincRatio => "sinc_ratio",
            Function1::Fraction => "fraction",
        }
    }

    /// True when lanes of f32 are not widened to f64.
    pub fn is_single(self) -> bool {
        self == Function1::LogVariance
    }

    /// The function of the formula language with that name.
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
