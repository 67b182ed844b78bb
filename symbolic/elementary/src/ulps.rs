//! Measures errors in units in the last place, for the tests and examples/elementary.rs.

use crate::double_double::DoubleDouble;
use crate::function::{Function1, Function2};

/// Test arguments from a seed (SplitMix64).
#[derive(Debug)]
pub struct Arguments(pub u64);

impl Arguments {
    /// Any bits.
    #[allow(clippy::should_implement_trait)] // it never ends
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Any bits, or a number of ordinary size, in (−1, 1), or near 1.
    pub fn argument(&mut self) -> f64 {
        let unit = (self.next() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0;
        match self.next() % 8 {
            0 | 1 => f64::from_bits(self.next()),
            2 => unit * 800.0,
            3 => unit * 30.0,
            4 => unit * 4.0,
            5 => unit,
            6 => 1.0 + unit * 0.5,
            _ => unit * 2.0_f64.powi((self.next() % 64) as i32 - 32),
        }
    }
}

/// The exact value, as a sum of two numbers, to about 28 digits.
pub fn exact1(function: Function1, x: f64) -> [f64; 2] {
    let exact = DoubleDouble::from(x).call1(function).parts();
    // Functions that are 0 at 0 are odd; double-double sums lose the sign.
    if x == 0.0 && exact[0] == 0.0 { [x, 0.0] } else { exact }
}

/// The exact value of a function of two arguments.
pub fn exact2(function: Function2, a: f64, b: f64) -> [f64; 2] {
    DoubleDouble::from(a).call2(function, b.into()).parts()
}

/// Converts an error from units of the exact value's last place to those of the function's scale: for a Bessel function
/// the height of its waves, √(2/πx), at most 1.
pub fn allowed_for(function: Function1, x: f64, exact: [f64; 2], error: f64) -> f64 {
    let height = match function {
        Function1::BesselJ1 if x.abs() < 1.0 => return error,
        Function1::BesselJ0 | Function1::BesselJ1 => (std::f64::consts::FRAC_2_PI / x.abs()).sqrt().min(1.0),
        _ => return error,
    };
    if exact[0] == 0.0 { error } else { error * (exact[0].abs() / height).min(1.0) }
}

/// 2^(⌊log₂ |x|⌋ − digits), at least the smallest number.
fn unit(x: f64, digits: i32, lowest: i32) -> f64 {
    let exponent = (x.to_bits() >> 52 & 0x7ff) as i32 - 1023;
    let exponent = (exponent - digits).max(lowest);
    if exponent < -1022 { libm::ldexp(1.0, exponent) } else { f64::from_bits(((exponent + 1023) as u64) << 52) }
}

/// The error of an f32: 0 for the right NaN, infinity or sign of zero, infinite for a wrong one.
pub fn error_single(value: f32, exact: [f64; 2]) -> f64 {
    // −0 + 0 would be 0.
    let rounded = if exact[0] == 0.0 { exact[0] as f32 } else { (exact[0] + exact[1]) as f32 };
    match special(f64::from(value), f64::from(rounded)) {
        Some(error) => error,
        None => ((f64::from(value) - exact[0]) - exact[1]).abs() / unit(exact[0], 23, -149),
    }
}

/// The error of an f64.
pub fn error_double(value: f64, exact: [f64; 2]) -> f64 {
    match special(value, exact[0]) {
        Some(error) => error,
        None => {
            // The smallest unit would give a quotient of two subnormals; scaled, both are normal.
            let scale = if exact[0].abs() < 1e-200 { libm::ldexp(1.0, 400) } else { 1.0 };
            let difference = (value * scale - exact[0] * scale) - exact[1] * scale;
            difference.abs() / (unit(exact[0], 52, -1074) * scale)
        }
    }
}

fn special(value: f64, exact: f64) -> Option<f64> {
    let wrong = |right: bool| Some(if right { 0.0 } else { f64::INFINITY });
    if exact.is_nan() || value.is_nan() {
        return wrong(exact.is_nan() && value.is_nan());
    }
    if exact.is_infinite() || value.is_infinite() {
        return wrong(exact == value);
    }
    if exact == 0.0 && value == 0.0 {
        return wrong(exact.is_sign_negative() == value.is_sign_negative());
    }
    None
}
