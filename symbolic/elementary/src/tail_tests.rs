//! The tail of the normal distribution against 40-digit arithmetic.

use crate::function::Function1;
use crate::{Accuracy, Plain};

/// z, ln Q(z), φ(z)/Q(z), from 40-digit arithmetic.
const TABLE: [(f64, f64, f64); 13] = [
    (-30.0, 0.0, 1.4736461348785476e-196),
    (-8.0, -6.220960574271786e-16, 5.052271083536895e-15),
    (-3.5, -0.00023265614137680455, 0.000872885753654736),
    (-1.0, -0.17275377902344988, 0.2875999709391784),
    (0.0, -std::f64::consts::LN_2, 0.7978845608028654),
    (0.3, -0.9621028181688507, 0.9981659688584833),
    (1.0, -1.8410216450092636, 1.525135276160981),
    (2.5, -5.08164827727869, 2.822744797663907),
    (5.0, -15.064998393988725, 5.186503967125842),
    (9.0, -43.628149113332114, 9.108523105002869),
    (20.0, -203.91715537109727, 20.04975306852785),
    (100.0, -5005.524208694205, 100.00999800099926),
    (1000.0, -500007.82669481216, 1000.000999998),
];

#[test]
fn tails_are_right_near_and_far() {
    for machine in [Plain { fused: false }, Plain { fused: true }] {
        for (accuracy, error) in [(Accuracy::Single, 2e-9), (Accuracy::Double, 2e-15)] {
            for (z, log_tail, hazard) in TABLE {
                let value = |function: Function1| function.value_with(machine, accuracy, z);
                let found = value(Function1::LogTail);
                assert!((found - log_tail).abs() <= error * log_tail.abs().max(1.0), "{z}: {found:e} {log_tail:e}");
                let (found, allowed) = (value(Function1::Hazard), error * (1.0 + z * z));
                assert!((found - hazard).abs() <= allowed * hazard + 1e-45, "{z}: {found:e} {hazard:e}");
            }
            let far = |function: Function1, z: f64| function.value_with(machine, accuracy, z);
            assert_eq!(far(Function1::Hazard, f64::INFINITY), f64::INFINITY);
            assert_eq!(far(Function1::Hazard, 1e200), 1e200);
            assert_eq!(far(Function1::LogTail, f64::INFINITY), f64::NEG_INFINITY);
            assert_eq!(far(Function1::LogTail, f64::NEG_INFINITY), 0.0);
            assert!(far(Function1::Hazard, f64::NEG_INFINITY) < 1e-45);
            assert!(far(Function1::LogTail, f64::NAN).is_nan() && far(Function1::Hazard, f64::NAN).is_nan());
        }
    }
}
