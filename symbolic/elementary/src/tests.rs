//! Compares every function with the referee: f32 on a stride of bit patterns, f64 on samples, special values, large
//! angles; and applies the same checks to slightly wrong functions.
#![allow(clippy::unwrap_used)]

use crate::ulps::{Arguments, allowed_for, error_double, error_single, exact1, exact2};
use crate::{Accuracy, Function1, Function2, Plain};

const MACHINES: [Plain; 2] = [Plain { fused: false }, Plain { fused: true }];
/// Limit of docs/elementary.md, in units in the last place.
const ULPS_MAX: f64 = 2.0;

/// The limits of docs/elementary.md with those of less exact functions.
fn ulps_max(function: Function1) -> f64 {
    match function {
        Function1::Erfc => 5.0,
        Function1::BesselJ0 | Function1::BesselJ1 => 80.0,
        _ => ULPS_MAX,
    }
}

/// The worst error and its argument.
type Worst = (f64, f64);

fn worst(errors: impl Iterator<Item = Worst>) -> Worst {
    errors.fold((0.0, 0.0), |worst, one| if one.0 > worst.0 { one } else { worst })
}

/// The worst error of an f32 function over bit patterns `stride` apart.
fn worst_single(function: Function1, value: impl Fn(f64) -> f64, stride: usize) -> Worst {
    let special = [
        0.0_f32,
        0.5,
        0.75,
        1.0,
        6.0,
        88.72,
        103.97,
        std::f32::consts::FRAC_PI_4,
        1_048_576.0,
        f32::INFINITY,
        f32::MIN_POSITIVE,
    ];
    let near = special.iter().flat_map(|x| (0..9).map(|i| x.to_bits().wrapping_add(i).wrapping_sub(4)));
    let near = near.flat_map(|bits| [bits, bits | 1 << 31]);
    let all = (0..=u32::MAX).step_by(stride).chain(near);
    worst(all.map(|bits| {
        let x = f64::from(f32::from_bits(bits));
        let exact = exact1(function, x);
        (allowed_for(function, x, exact, error_single(value(x) as f32, exact)), x)
    }))
}

fn worst_double(function: Function1, value: impl Fn(f64) -> f64, samples: usize) -> Worst {
    let mut random = Arguments(function as u64);
    worst((0..samples).map(|_| {
        let x = random.argument();
        let exact = exact1(function, x);
        (allowed_for(function, x, exact, error_double(value(x), exact)), x)
    }))
}

#[test]
fn singles_are_right() {
    for function in Function1::ALL {
        for machine in MACHINES {
            let value = |x: f64| function.value_with(machine, Accuracy::Single, x);
            let (error, at) = worst_single(function, value, 1_048_573);
            assert!(error <= 0.6, "{function:?} {machine:?}: {error} at {at:e}");
        }
    }
}

#[test]
fn doubles_are_right() {
    for function in Function1::ALL {
        for machine in MACHINES {
            let value = |x: f64| function.value_with(machine, Accuracy::Double, x);
            let (error, at) = worst_double(function, value, 4000);
            assert!(error <= ulps_max(function), "{function:?} {machine:?}: {error} at {at:e}");
        }
    }
}

#[test]
fn functions_of_two_arguments_are_right() {
    for (function, machine) in Function2::ALL.into_iter().flat_map(|f| MACHINES.map(|machine| (f, machine))) {
        let mut random = Arguments(7);
        for _ in 0..4000 {
            let [a, b] = [random.argument(), random.argument()];
            let error = error_double(function.value_with(machine, Accuracy::Double, a, b), exact2(function, a, b));
            assert!(error <= ULPS_MAX, "{function:?} {machine:?} of {a:e}, {b:e}: {error}");
            let [a, b] = [a, b].map(|x| f64::from(x as f32));
            let single = function.value_with(machine, Accuracy::Single, a, b) as f32;
            let error = error_single(single, exact2(function, a, b));
            assert!(error <= 0.6, "{function:?} {machine:?} of the f32 {a:e}, {b:e}: {error}");
        }
    }
}

/// Coefficients of e^x, sin x and erf x that are wrong by a few units in the last place of f32.
#[test]
fn a_planted_fault_is_caught() {
    let off = 4.0 * f64::from(f32::EPSILON);
    let exp = |x: f64| Function1::Exp.value_with(MACHINES[0], Accuracy::Single, x) * (1.0 + off);
    assert!(worst_single(Function1::Exp, exp, 1_048_573).0 > ULPS_MAX);
    let sin = |x: f64| Function1::Sin.value(x) + off * x.powi(3).clamp(-1.0, 1.0);
    assert!(worst_single(Function1::Sin, sin, 1_048_573).0 > ULPS_MAX);
    // The single form in place of the double one.
    for function in Function1::ALL {
        let short = |x: f64| function.value_with(MACHINES[0], Accuracy::Single, x);
        assert!(worst_double(function, short, 1000).0 > ulps_max(function), "{function:?}");
    }
    // The wrong sign of a zero, a number for NaN, and a finite number for an infinite one.
    assert!(error_double(0.0, [-0.0, 0.0]).is_infinite());
    assert!(error_single(1.0, [f64::NAN, 0.0]).is_infinite());
    assert!(error_single(f32::MAX, [1e39, 0.0]).is_infinite());
}

/// sin, cos, tan of large arguments, from 400-digit arithmetic.
const LARGE: [(f64, [f64; 3]); 6] = [
    (2097152.5, [0.9221693097510237, 0.38678645807902895, 2.38418199626473]),
    (10000000000.0, [-0.4875060250875107, 0.873119622676856, -0.5583496378112418]),
    (1e+22, [-0.8522008497671888, 0.523214785395139, -1.6287782256068988]),
    (5.319372648326541e+255, [1.0, -4.687165924254628e-19, -2.133485385753704e+18]),
    (1.7976931348623157e+308, [0.004961954789184062, -0.9999876894265599, -0.004962015874444895]),
    (-3.4028234663852886e+38, [0.5218765233336585, 0.8530210398303042, 0.6117979498342481]),
];

#[test]
fn large_angles_are_right() {
    for (x, expected) in LARGE {
        for (function, expected) in [Function1::Sin, Function1::Cos, Function1::Tan].into_iter().zip(expected) {
            let value = function.value(x);
            assert!(error_double(value, [expected, 0.0]) <= 1.0, "{function:?} {x:e}: {value:e}, {expected:e}");
        }
    }
}

const INF: f64 = f64::INFINITY;
const NAN: f64 = f64::NAN;

/// C99, Annex F.
#[test]
fn special_values_are_right() {
    use Function1::*;
    let rows = [
        (Exp, vec![(0.0, 1.0), (-0.0, 1.0), (INF, INF), (-INF, 0.0), (710.0, INF), (-746.0, 0.0)]),
        (Log, vec![(0.0, -INF), (-0.0, -INF), (1.0, 0.0), (INF, INF), (-INF, NAN), (-1.0, NAN)]),
        (Sin, vec![(0.0, 0.0), (-0.0, -0.0), (INF, NAN), (-INF, NAN)]),
        (Cos, vec![(0.0, 1.0), (-0.0, 1.0), (INF, NAN), (-INF, NAN)]),
        (Tan, vec![(0.0, 0.0), (-0.0, -0.0), (INF, NAN), (-INF, NAN)]),
        (Asin, vec![(0.0, 0.0), (-0.0, -0.0), (1.5, NAN), (-INF, NAN)]),
        (Acos, vec![(1.0, 0.0), (1.5, NAN), (-INF, NAN)]),
        (Atan, vec![(0.0, 0.0), (-0.0, -0.0), (INF, std::f64::consts::FRAC_PI_2)]),
        (Sinh, vec![(0.0, 0.0), (-0.0, -0.0), (INF, INF), (-INF, -INF), (711.0, INF)]),
        (Cosh, vec![(0.0, 1.0), (INF, INF), (-INF, INF), (-711.0, INF)]),
        (Tanh, vec![(0.0, 0.0), (-0.0, -0.0), (INF, 1.0), (-INF, -1.0), (800.0, 1.0)]),
        (Erf, vec![(0.0, 0.0), (-0.0, -0.0), (INF, 1.0), (-INF, -1.0), (9.0, 1.0)]),
        (Erfc, vec![(0.0, 1.0), (-0.0, 1.0), (INF, 0.0), (-INF, 2.0), (30.0, 0.0), (-9.0, 2.0)]),
        (BesselJ0, vec![(0.0, 1.0), (-0.0, 1.0), (INF, 0.0), (-INF, 0.0)]),
        (BesselJ1, vec![(0.0, 0.0), (-0.0, -0.0), (INF, 0.0), (-INF, -0.0)]),
        (Sinc, vec![(0.0, 1.0), (-0.0, 1.0), (INF, 0.0), (-INF, 0.0)]),
        (BesselRatio1, vec![(0.0, 0.5), (INF, 0.0)]),
        (BesselRatio2, vec![(0.0, 0.125), (-INF, 0.0)]),
        (SincRatio, vec![(0.0, 1.0 / 3.0), (INF, 0.0)]),
    ];
    for (function, pairs) in rows {
        for (x, expected) in pairs.into_iter().chain([(NAN, NAN), (-NAN, NAN)]) {
            check(&format!("{function:?}({x})"), expected, |machine, accuracy| {
                function.value_with(machine, accuracy, x)
            });
        }
    }
}

fn check(what: &str, expected: f64, value: impl Fn(Plain, Accuracy) -> f64) {
    for machine in MACHINES {
        let (long, short) = (value(machine, Accuracy::Double), value(machine, Accuracy::Single) as f32);
        assert_eq!(error_double(long, [expected, 0.0]), 0.0, "{what}, {machine:?}: {long}, not {expected}");
        let expected = f64::from(expected as f32);
        assert_eq!(error_single(short, [expected, 0.0]), 0.0, "{what}, {machine:?}: {short}, not {expected}");
    }
}

#[test]
fn special_pairs_are_those_of_the_standard() {
    let numbers = [
        0.0,
        -0.0,
        1.0,
        -1.0,
        0.5,
        -0.5,
        2.0,
        -2.0,
        3.0,
        -3.0,
        2.5,
        -2.5,
        1e300,
        -1e300,
        1e-300,
        -1e-300,
        INF,
        -INF,
        NAN,
        9_007_199_254_740_991.0,
        9_007_199_254_740_992.0,
        4_503_599_627_370_495.5,
        -4_503_599_627_370_497.0,
    ];
    for (a, b) in numbers.iter().flat_map(|a| numbers.map(|b| (*a, b))) {
        for machine in MACHINES {
            // Except the angle of the origin, which is 0 on either side of −0.
            let angle = if a == 0.0 && b == 0.0 { a } else { libm::atan2(a, b) };
            for (function, expected) in [(Function2::Pow, libm::pow(a, b)), (Function2::Atan2, angle)] {
                let value = function.value_with(machine, Accuracy::Double, a, b);
                // libm is itself within 1 unit.
                let error = error_double(value, [expected, 0.0]);
                assert!(error <= 1.5, "{function:?}({a}, {b}), {machine:?}: {value}, not {expected}");
            }
        }
    }
}

/// The worst error of the variance's logarithm in f32, in units in the last place, over normal numbers `stride` bit
/// patterns apart.
fn worst_of_variance(machine: Plain, stride: usize) -> Worst {
    let near_one = (0.7_f32.to_bits()..1.42_f32.to_bits()).step_by(stride / 64 + 1);
    let all = (f32::MIN_POSITIVE.to_bits()..=f32::MAX.to_bits()).step_by(stride).chain(near_one);
    worst(all.map(|bits| {
        let x = f64::from(f32::from_bits(bits));
        let value = Function1::LogVariance.value_with(machine, Accuracy::Single, x) as f32;
        (error_single(value, exact1(Function1::Log, x)), x)
    }))
}

#[test]
fn variance_logarithms_are_right() {
    for machine in MACHINES {
        let (error, at) = worst_of_variance(machine, 65_521);
        assert!(error <= 1.0, "{machine:?}: {error} at {at:e}");
        let single = |x: f32| Function1::LogVariance.value_with(machine, Accuracy::Single, x.into());
        assert!(
            [0.0, -0.0, -1.0, 1e-40, f32::INFINITY, f32::NEG_INFINITY, f32::NAN].map(single).iter().all(|y| y.is_nan())
        );
        for x in [0.0, -1.0, 1e-310, 0.3, 1.0, 7.0, f64::MAX, f64::INFINITY, f64::NAN] {
            let [log, of_variance] = [Function1::Log, Function1::LogVariance]
                .map(|function| function.value_with(machine, Accuracy::Double, x).to_bits());
            assert_eq!(log, of_variance, "{x}");
        }
    }
}
