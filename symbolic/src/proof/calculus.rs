//! Derivatives of the elementary functions in any arithmetic: the table that forward differentiation uses. [`crate::derive::jet`]
//! has its own, over nodes; the two are compared.

use isophote_elementary::{Function1, Function2};

use crate::proof::evaluate::Number;

/// f, f′, f″.
pub(crate) fn derivatives<N: Number>(function: Function1, x: N) -> (N, N, N) {
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
            let slope = N::two_over_root_pi() * (-(x * x)).call1(Function1::Exp);
            (f, slope, -(two * x * slope))
        }
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
pub(crate) struct Two<N> {
    pub value: N,
    pub a: N,
    pub b: N,
    pub aa: N,
    pub ab: N,
    pub bb: N,
}

pub(crate) fn derivatives2<N: Number>(function: Function2, x: N, y: N) -> Two<N> {
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
