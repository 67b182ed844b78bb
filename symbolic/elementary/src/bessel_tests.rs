//! Bessel functions, sinc, erfc and the ratios in derivatives, against 40-digit arithmetic.

use crate::function::Function1;
use crate::{Accuracy, Plain};

const FUNCTIONS: [Function1; 6] = [
    Function1::BesselJ0,
    Function1::BesselJ1,
    Function1::Sinc,
    Function1::Erfc,
    Function1::BesselRatio1,
    Function1::BesselRatio2,
];

/// x, and the functions' values there.
const TABLE: [(f64, [f64; 7]); 13] = [
    (1e-09, [1.0, 5e-10, 1.0, 0.9999999988716208, 0.5, 0.125, 0.3333333333333333]),
    (
        0.001,
        [
            0.9999997500000156,
            0.0004999999375000026,
            0.9999998333333416,
            0.9988716212090307,
            0.4999999375000026,
            0.12499998958333366,
            0.33333330000000116,
        ],
    ),
    (
        0.5,
        [
            0.9384698072408129,
            0.2422684576748739,
            0.958851077208406,
            0.4795001221869535,
            0.4845369153497478,
            0.12241609383473057,
            0.3250740612721331,
        ],
    ),
    (
        1.999,
        [
            0.2244675361180832,
            0.5767890792130258,
            0.45508410152285916,
            0.004698443348629487,
            0.2885388090110184,
            0.08824073915495856,
            0.21779810183263829,
        ],
    ),
    (
        2.5,
        [
            -0.048383776468198,
            0.49709410246427405,
            0.2393888576415826,
            0.0004069520174449589,
            0.1988376409857096,
            0.07136944935033876,
            0.1664851957101626,
        ],
    ),
    (
        5.25,
        [
            -0.09308098963931788,
            -0.34501397857943766,
            -0.16360657017649372,
            1.1310313266887154e-13,
            -0.06571694830084528,
            -0.0013914886879772398,
            -0.024514904214724152,
        ],
    ),
    (
        7.999,
        [
            0.17188537228232045,
            0.2344939012279374,
            0.12370336941540923,
            1.1406723309454422e-29,
            0.02931540207875202,
            -0.0017700451105709444,
            0.004191891225937578,
        ],
    ),
    (
        8.001,
        [
            0.17141609967153276,
            0.23477854371960058,
            0.12363607698221987,
            1.1044766627710609e-29,
            0.02934365000869899,
            -0.0017609472302734875,
            0.004219654334899058,
        ],
    ),
    (
        13.25,
        [
            0.2177656779210489,
            -0.016121474234366946,
            0.047668753790055744,
            2.4107713726371344e-78,
            -0.001216715036555996,
            -0.001254249102138332,
            -0.004144488238315313,
        ],
    ),
    (
        39.0,
        [
            0.11135769795486712,
            0.06405610368868934,
            0.024712702212412507,
            0.0,
            0.0016424641971458807,
            -7.10537603948556e-05,
            -0.00015905998037312607,
        ],
    ),
    (
        41.5,
        [
            -0.12282032421380178,
            0.014468116511452122,
            -0.014760485613866742,
            0.0,
            0.00034862931352896677,
            7.171873005711117e-05,
            0.0004503779872747562,
        ],
    ),
    (
        1000.25,
        [
            0.022846535354858314,
            0.010711720806184072,
            0.0009400736497436333,
            0.0,
            1.0709043545297748e-05,
            -2.2813708987417198e-08,
            -3.39213099173893e-07,
        ],
    ),
    (
        3000000.0,
        [
            -0.00013053162249034237,
            -0.00044177834435523116,
            -2.928300193815826e-07,
            0.0,
            -1.472594481184104e-10,
            1.4503480885716237e-17,
            -5.3084546767482416e-14,
        ],
    ),
];

/// Errors relative to the height of the waves.
#[test]
fn functions_and_their_ratios_are_right_near_and_far() {
    let functions = FUNCTIONS.into_iter().chain([Function1::SincRatio]);
    for (place, function) in functions.enumerate() {
        for machine in [Plain { fused: false }, Plain { fused: true }] {
            for (accuracy, error) in [(Accuracy::Single, 4e-9), (Accuracy::Double, 4e-15)] {
                for (x, values) in TABLE
                    .into_iter()
                    .filter(|(x, _)| accuracy == Accuracy::Double || *x < 9.0 || function != Function1::Erfc)
                {
                    let (found, expected) = (function.value_with(machine, accuracy, x), values[place]);
                    let wave = |start: f64, order: i32| start.min(0.8 / x.sqrt() / x.powi(order));
                    let height = match function {
                        Function1::BesselJ0 => wave(1.0, 0),
                        Function1::BesselJ1 => x.min(wave(1.0, 0)),
                        Function1::BesselRatio1 => wave(0.5, 1),
                        Function1::BesselRatio2 => wave(0.125, 2),
                        Function1::SincRatio => 0.3 / x.max(1.0).powi(2),
                        _ => expected.abs(),
                    };
                    let far = (found - expected).abs();
                    assert!(
                        far <= error * height,
                        "{function:?}({x}), {machine:?}, {accuracy:?}: {found:e}, {expected:e}"
                    );
                    let mirrored = function.value_with(machine, accuracy, -x);
                    let sign = if function == Function1::BesselJ1 { -1.0 } else { 1.0 };
                    assert!(
                        mirrored == sign * found || function == Function1::Erfc,
                        "{function:?}(-{x}): {mirrored:e}"
                    );
                }
            }
        }
    }
}

/// Compares both sides of a seam between two forms.
#[test]
fn functions_are_continuous_at_seams() {
    for (seam, functions) in [(8.0_f64, &FUNCTIONS[..]), (2.0, &[Function1::SincRatio]), (0.25, &[Function1::Erfc])] {
        for function in functions {
            let [below, above] = [seam.next_down(), seam.next_up()].map(|x| function.value(x));
            assert!((below - above).abs() <= 1e-14 * above.abs().max(0.01), "{function:?}: {below:e} {above:e}");
        }
    }
}
