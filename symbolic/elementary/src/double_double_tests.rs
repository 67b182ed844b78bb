//! Double-double arithmetic against exact values.

use super::{DoubleDouble, Function1, Function2};

fn from(x: f64) -> DoubleDouble {
    x.into()
}

/// A decimal number such as `-1.25e-3`, digit by digit.
fn decimal(text: &str) -> DoubleDouble {
    let (mantissa, exponent) = text.split_once('e').unwrap_or((text, "0"));
    let (negative, digits) = mantissa.strip_prefix('-').map_or((false, mantissa), |rest| (true, rest));
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    let all = whole.chars().chain(fraction.chars()).map(|c| f64::from(c.to_digit(10).unwrap()));
    let number = all.fold(DoubleDouble::ZERO, |n, digit| n * from(10.0) + from(digit));
    let places = exponent.parse::<i32>().unwrap() - fraction.len() as i32;
    let tens = (0..places.abs()).fold(DoubleDouble::ONE, |t, _| t * from(10.0));
    let value = if places < 0 { number / tens } else { number * tens };
    if negative { -value } else { value }
}

#[track_caller]
fn close(found: DoubleDouble, expected: DoubleDouble, what: &str) {
    let error = ((found - expected) / expected).abs().to_f64();
    let error = if expected == DoubleDouble::ZERO { found.abs().to_f64() } else { error };
    assert!(error <= 1e-28, "{what}: {found:?} instead of {expected:?}, error {error:e}");
}

#[test]
fn known_values() {
    use Function1::*;
    let (tiny, small) = (2_f64.powi(-20), 2_f64.powi(-10));
    let table = [
        (Exp, 1.0, "2.7182818284590452353602874713526625"),
        (Exp, -30.0, "9.3576229688401746049158322233787067e-14"),
        (Exp, 0.125, "1.1331484530668263168290072278117939"),
        (Log, 2.0, "0.69314718055994530941723212145817657"),
        (Log, 10.0, "2.3025850929940456840179914546843642"),
        (Log, 1.0 + tiny, "9.5367386165918823390841551496333614e-7"),
        (Sin, 1.0, "0.84147098480789650665250232163029900"),
        (Cos, 1.0, "0.54030230586813971740093660744297660"),
        (Tan, 1.0, "1.5574077246549022305069748074583602"),
        (Sin, 1000.0, "0.82687954053200256025588742910921814"),
        (Cos, 1e6, "0.93675212753314478693853253507491878"),
        (Atan, 0.5, "0.46364760900080611621425623146121440"),
        (Asin, 0.5, "0.52359877559829887307710723054658381"),
        (Acos, 0.5, "1.0471975511965977461542144610931676"),
        (Atan, 1e300, "1.5707963267948966192313216916397514"),
        (Acos, -1.0, "3.1415926535897932384626433832795028841972"),
        (Erf, 0.5, "0.52049987781304653768274665389196453"),
        (Erf, 1.0, "0.84270079294971486934122063508260926"),
        (Erf, -3.0, "-0.99997790950300141455862722387041768"),
        (Erf, 6.0, "0.99999999999999997848026328750108688"),
        (Sinh, 1.0, "1.1752011936438014568823818505956008"),
        (Sinh, small, "9.7656265522043650406675150063853807e-4"),
        (Sinh, -5.0, "-74.203210577788758977009471996064566"),
        (Cosh, 1.0, "1.5430806348152437784779056207570617"),
        (Tanh, 1.0, "0.76159415595576488811945828260479359"),
        (Tanh, small, "9.7656218955926021858407527014677176e-4"),
        (Tanh, 5.0, "0.99990920426259513121099044753447302"),
        (BesselJ0, 2.5, "-0.048383776468197996327287778851203434"),
        (BesselJ0, 17.75, "-0.059775355999275131874142740881599773"),
        (BesselJ0, 50.5, "0.095519891549700567083692869342294117"),
        (BesselJ1, 0.25, "0.1240259773227269227315749766638174"),
        (BesselJ1, 3.5, "0.1373775273623271857161318971839707"),
        (BesselJ1, 39.5, "0.10851994640114157979732927056484274"),
        (BesselJ1, 100.25, "-0.069620284679609713785481081159312556"),
        (Erfc, 0.5, "0.47950012218695346231725334610803547"),
        (Erfc, 1.75, "0.013328328780817556227788899871312023"),
        (Erfc, 2.5, "0.00040695201744495893956421573997491272"),
        (Erfc, 10.0, "2.0884875837625447570007862949577886e-45"),
        (Erfc, -1.5, "1.9661051464753107270669762616459479"),
        (Sinc, 2.5, "0.23938885764158259762074188087446491"),
    ];
    for (function, x, expected) in table {
        close(from(x).call1(function), decimal(expected), &format!("{} {x}", function.name()));
    }
    close(from(2.0).sqrt(), decimal("1.4142135623730950488016887242096981"), "sqrt");
    let pow = |x: f64, y: f64| from(x).call2(Function2::Pow, from(y));
    close(pow(10.0, -7.25), decimal("5.6234132519034908039495103977648123e-8"), "pow");
    close(pow(3.0, 100.5), decimal("8.9266005098672602579375861848449120e47"), "pow");
    close(pow(-2.0, 3.0), from(-8.0), "pow");
    let atan2 = |y: f64, x: f64| from(y).call2(Function2::Atan2, from(x));
    close(atan2(1.0, -3.0), decimal("2.8198420991931510450612387689208416"), "atan2");
    close(atan2(-5.0, 0.0), decimal("-1.5707963267948966192313216916397514"), "atan2");
}

#[test]
fn identities() {
    let one = DoubleDouble::ONE;
    for i in 1..400 {
        let t = from(f64::from(i)) / from(61.0);
        let what = format!("{i}/61");
        close(t * t / t, t, &what);
        close(t.sqrt() * t.sqrt(), t, &what);
        close(t.exp() * (-t).exp(), one, &what);
        close(t.exp().log(), t, &what);
        close(t.log().exp(), t, &what);
        let (sin, cos) = t.sin_cos();
        close(sin * sin + cos * cos, one, &what);
        close((sin + sin) * cos, (t + t).sin_cos().0, &what);
        close((sin / cos).atan().call1(Function1::Tan), sin / cos, &what);
        close(t.sinh() * t.cosh() + t.sinh() * t.cosh(), (t + t).sinh(), &what);
        close(t.tanh() * t.cosh(), t.sinh(), &what);
        let part = t / from(7.0);
        if part <= one {
            close(part.asin().sin_cos().0, part, &what);
            close(part.acos().sin_cos().1, part, &what);
        }
        close(part.pow(t) * part.pow(-t), one, &what);
    }
}

/// A result that is small against its operands keeps its own digits: ln(1 + t) = t − t²/2 + t³/3 for t = 2⁻⁴⁵, to t⁴.
#[test]
fn small_differences() {
    let t = from(2_f64.powi(-45));
    let series = t - t * t / from(2.0) + t * t * t / from(3.0);
    close((DoubleDouble::ONE + t).log(), series, "ln(1 + t)");
    assert_eq!(DoubleDouble::sum(1.0, 1e-30) - DoubleDouble::ONE, from(1e-30));
}

#[test]
fn special_values_are_those_of_f64() {
    let numbers = [0.0, -0.0, 1.0, -1.0, 2.5, -3.0, 1e308, -1e308, 1e-308, f64::INFINITY, f64::NEG_INFINITY, f64::NAN];
    let same = |found: DoubleDouble, expected: f64, what: String| {
        let near = (found.to_f64() - expected).abs() <= 4.0 * f64::EPSILON * expected.abs();
        let alike = found.to_f64().to_bits() == expected.to_bits() || (found.is_nan() && expected.is_nan());
        assert!(near || alike, "{what}: {found:?} instead of {expected:e}");
        assert!(found.is_finite() || found.lo == 0.0, "{what}: {found:?}");
    };
    for x in numbers {
        for function in Function1::ALL {
            same(from(x).call1(function), function.value(x), format!("{} {x:e}", function.name()));
        }
        same(from(x).sqrt(), x.sqrt(), format!("sqrt {x:e}"));
        for y in numbers {
            let (a, b) = (from(x), from(y));
            same(a + b, x + y, format!("{x:e} + {y:e}"));
            same(a - b, x - y, format!("{x:e} - {y:e}"));
            same(a * b, x * y, format!("{x:e} * {y:e}"));
            same(a / b, x / y, format!("{x:e} / {y:e}"));
            assert_eq!(a.partial_cmp(&b), x.partial_cmp(&y));
            for function in Function2::ALL {
                same(a.call2(function, b), function.value(x, y), format!("{} {x:e} {y:e}", function.name()));
            }
        }
    }
}
