//! Derivatives of the elementary functions in any arithmetic, for forward differentiation. Symbolic differentiation has
//! an independent table, against which this one is compared.

use crate::{Function1, Function2, Number};

/// f, f′, f″.
pub fn derivatives<N: Number>(function: Function1, x: N) -> (N, N, N) {
    let (one, two) = (N::from(1.0), N::from(2.0));
    let f = x.call1(function);
    match function {
        Function1::Exp => (f, f, f),
        Function1::Log | Function1::LogVariance => (f, one / x, -(one / (x * x))),
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
        // As the symbolic derivation writes sinh(x).
        Function1::Cosh => (f, f * x.call1(Function1::Tanh), f),
        Function1::Tanh => {
            let slope = one - f * f;
            (f, slope, -(two * f * slope))
        }
        Function1::Erf | Function1::Erfc => {
            let slope = N::two_over_root_pi() * (-(x * x)).call1(Function1::Exp);
            let slope = if function == Function1::Erf { slope } else { -slope };
            (f, slope, -(two * x * slope))
        }
        Function1::BesselJ0 => (f, -x.call1(Function1::BesselJ1), x.call1(Function1::BesselRatio1) - f),
        Function1::BesselJ1 => {
            let slope = x.call1(Function1::BesselJ0) - x.call1(Function1::BesselRatio1);
            (f, slope, x * x.call1(Function1::BesselRatio2) - f)
        }
        Function1::BesselRatio1 => {
            let ratio = x.call1(Function1::BesselRatio2);
            (f, -(x * ratio), ratio + two * ratio - f)
        }
        Function1::Sinc => {
            let ratio = x.call1(Function1::SincRatio);
            (f, -(x * ratio), two * ratio - f)
        }
        // Only derivatives contain these; they are not differentiated further, and these slopes are undefined at 0.
        Function1::BesselRatio2 | Function1::SincRatio => {
            let is_bessel = function == Function1::BesselRatio2;
            let (lower, n) = if is_bessel { (Function1::BesselRatio1, 4.0) } else { (Function1::Sinc, 3.0) };
            let next = (N::from(n) * f - x.call1(lower)) / x;
            (f, -next, N::from(n + 1.0) * next / x - f)
        }
        Function1::Fraction => (f, one, N::from(0.0)),
        Function1::LogTail => {
            let hazard = x.call1(Function1::Hazard);
            (f, -hazard, -(hazard * (hazard - x)))
        }
        Function1::Hazard => {
            let slope = f * (f - x);
            (f, slope, slope * (f + f - x) - f)
        }
    }
}

/// A function of two arguments, and its five derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Two<N> {
    /// f
    pub value: N,
    /// ∂f/∂a
    pub a: N,
    /// ∂f/∂b
    pub b: N,
    /// ∂²f/∂a²
    pub aa: N,
    /// ∂²f/∂a∂b
    pub ab: N,
    /// ∂²f/∂b²
    pub bb: N,
}

/// The derivatives of a function of two arguments; those of the angle count as 0 at the origin, where they do not
/// exist.
pub fn derivatives2<N: Number>(function: Function2, x: N, y: N) -> Two<N> {
    let (one, two) = (N::from(1.0), N::from(2.0));
    let value = x.call2(function, y);
    match function {
        // angle(x, y) = atan2(first, second)
        Function2::Atan2 => {
            let square = x * x + y * y;
            let none = N::from(0.0);
            if square == none {
                return Two { value, a: none, b: none, aa: none, ab: none, bb: none };
            }
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
