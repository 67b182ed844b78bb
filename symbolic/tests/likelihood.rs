//! Robust losses, censored pixels, Gauss points and several observed values: what is derived is right, by the check that
//! every program passes and by finite differences of F.
#![allow(clippy::unwrap_used)]

use isophote_elementary::Function1;
use isophote_symbolic::interpreter::{self, Pixels, Slices, Window};
use isophote_symbolic::{
    Bindings, Lanes, Lowering, Method, Model, ParameterId, Precision, Program, Saturated, Summand, ValueKind,
};

/// A spot; LIKELIHOOD stands for further keys of `[model]`.
const SPOT: &str = r#"
name = "spot"
coordinates = ["x", "y"]
channels = ["phi"]
[parameters]
bx = { start = "centroid.x" }
by = { start = "centroid.y" }
a1 = { start = "extent.xx", min = 0 }
a2 = { start = "extent.xy" }
a3 = { start = "extent.yy", min = 0 }
v0 = { start = "background" }
v1 = { start = "amplitude", min = 0 }
[constants]
gain = 0.05
read_noise = 0.75
[definitions]
s = "a1 * (x - bx)^2 + 2 * a2 * (x - bx) * (y - by) + a3 * (y - by)^2"
f = "if(s <= 1, (1 - s)^2 * (1 + s/2), 0)"
[model]
intensity = "v0 + v1 * f"
domain = "s <= 2.2"
LIKELIHOOD
"#;

const NOISE: &str = r#"noise = "read_noise^2 + gain * max(intensity, 0)""#;

fn spot(likelihood: &str) -> Model {
    Model::from_toml(&SPOT.replace("LIKELIHOOD", likelihood)).unwrap()
}

fn every(model: &Model) -> Vec<ParameterId> {
    (0..model.parameters().len() as u32).map(ParameterId).collect()
}

/// A picture with a spot, in each channel at another height.
struct Picture;

impl Pixels for Picture {
    fn at(&self, channel: usize, x: usize, y: usize) -> f64 {
        let (dx, dy) = (x as f64 - 20.3, y as f64 - 16.8);
        let s = dx * dx / 130.0 + dy * dy / 80.0;
        let f = if s <= 1.0 { (1.0 - s).powi(2) * (1.0 + s / 2.0) } else { 0.0 };
        let noise = ((x * 7919 + y * 104_729 + channel * 31) % 97) as f64 / 24.0 - 2.0;
        // One pixel in forty is far off.
        let outlier = if (x * 31 + y * 17).is_multiple_of(40) { 60.0 } else { 0.0 };
        (20.0 + (300.0 - 80.0 * channel as f64) * f + noise + outlier).round().min(255.0)
    }
}

const WINDOW: Window = Window { x: 0, y: 0, width: 41, height: 33, slices: Slices::ONE };
const POINT: [f64; 7] = [20.1, 17.0, 0.0081, 0.0004, 0.0118, 21.0, 280.0];

fn sums(program: &isophote_symbolic::Program, parameters: &[f64], entry: &[f64]) -> interpreter::Outcome {
    let bindings = Bindings { parameters, entry, constants: &[0.05, 0.75, 0.02], saturation: &[254.5; 3], shift: &[] };
    interpreter::run(program, Precision::F64, Lanes::Two, &bindings, &Picture, WINDOW, None)
}

/// The gradient and, of Newton's method, the Hessian of each summand against differences of its F.
fn agrees_with_differences(model: &Model, method: Method) {
    let free = every(model);
    let start = &POINT[..free.len()];
    for summand in model.summands() {
        let lowering = Lowering { fma: false, drop_saturated: !summand.is_clipped() };
        let objective = summand.objective(&free, method).unwrap();
        let proof = objective.proof().unwrap();
        assert!(proof.exact || proof.error.unwrap() < 1e-11, "{proof:?}");
        let kind = if method == Method::Newton { ValueKind::Full } else { ValueKind::Entry };
        let value = summand.value_objective(kind).unwrap().program(lowering).unwrap();
        let program = objective.program(lowering).unwrap();
        let here = sums(&program, start, start);
        assert!(here.pixels > 40, "{} pixels", here.pixels);
        let at = |i: usize, h: f64, program| {
            let mut moved = start.to_vec();
            moved[i] += h;
            // With ln σ² in F the variances are those of the parameters themselves.
            sums(program, &moved, start).outputs
        };
        for (i, value_of) in start.iter().enumerate() {
            let h = 1e-4 * value_of;
            let (up, down) = (at(i, h, &value)[0], at(i, -h, &value)[0]);
            let (difference, gradient) = ((up - down) / (2.0 * h), here.outputs[1 + i]);
            let scale = here.outputs[1 + free.len() + (0..i).map(|k| free.len() - k).sum::<usize>()].abs().sqrt();
            // The rim moves over pixel centres, so that F is not smooth to all digits.
            assert!(
                (difference - gradient).abs() <= 2e-2 * scale + 1e-3 * gradient.abs(),
                "{i}: {difference} {gradient}"
            );
        }
    }
}

#[test]
fn every_likelihood_has_the_derivatives_of_its_f() {
    for likelihood in ["", "loss = \"huber(1.5)\"", "loss = \"tukey(5)\"", "saturated = \"censored\""] {
        for more in ["", "saturated = \"censored\"", "quadrature = 2"] {
            if likelihood == more && !more.is_empty() {
                continue;
            }
            let model = spot(&format!("{NOISE}\n{likelihood}\n{more}"));
            let clipped = model.summands().iter().filter(|s| s.is_clipped()).count();
            assert_eq!(clipped, usize::from(model.saturated() == Saturated::Censored));
            for method in [Method::GaussNewton, Method::Newton] {
                agrees_with_differences(&model, method);
            }
        }
    }
}

/// One number for the light of a few pixels, all of them at the limit.
const LEVEL: &str = r#"
name = "level"
coordinates = ["x"]
channels = ["phi"]
[parameters]
v0 = { start = 100 }
[model]
intensity = "v0"
noise = "4"
saturated = "censored"
"#;

/// The sums over the pixels at their limit.
fn at_limits(model: &Model, method: Method) -> Program {
    let clipped = model.summands().into_iter().find(Summand::is_clipped).unwrap();
    clipped.objective(&every(model), method).unwrap().program(Lowering::default()).unwrap()
}

/// F, its slope by the light and the information of one pixel at its limit, z standard deviations above the prediction.
fn at_limit(program: &Program, precision: Precision, z: f64, defects: f64) -> [f64; 3] {
    struct White;
    impl Pixels for White {
        fn at(&self, _: usize, _: usize, _: usize) -> f64 {
            255.0
        }
    }
    let v0 = [254.5 - 2.0 * z];
    let bindings = Bindings { parameters: &v0, entry: &v0, constants: &[defects], saturation: &[254.5], shift: &[] };
    let window = Window { x: 0, y: 0, width: 1, height: 1, slices: Slices::ONE };
    let outcome = interpreter::run(program, precision, Lanes::Two, &bindings, &White, window, None);
    assert_eq!(outcome.pixels, 1);
    outcome.outputs.try_into().unwrap()
}

/// Against −2 ln[(1 − ε) Q + ε] itself, from where light is certain to where it is out of the question.
#[test]
fn a_pixel_at_its_limit_may_be_a_defect() {
    let model = Model::from_toml(LEVEL).unwrap();
    assert_eq!((model.constants()[0].name.as_str(), model.constants()[0].value), ("defects", 1e-3));
    let programs = [Method::GaussNewton, Method::Newton].map(|method| at_limits(&model, method));
    for share in [1e-3, 0.1, 1e-6] {
        for precision in [Precision::F32, Precision::F64] {
            let close = if precision == Precision::F32 { 2e-5 } else { 1e-12 };
            for z in (-160..=800).map(|quarters| 0.25 * f64::from(quarters)) {
                let (q, h) = (Function1::LogTail.value(z).exp(), Function1::Hazard.value(z));
                let light = (1.0 - share) * q / ((1.0 - share) * q + share);
                let expected = [
                    -2.0 * ((1.0 - share) * q + share).ln(),
                    -light * h, // 2 w h/σ, by the light and not by z
                    0.5 * light * h * (h - z),
                ];
                let found = at_limit(&programs[0], precision, z, share);
                assert!(found[2] >= 0.0);
                // The program's z is rounded, and the slopes' scale is 1/σ.
                let allowed = close * (1.0 + expected[0].abs() + z.abs() * light);
                for (found, expected) in found.iter().zip(expected) {
                    assert!((found - expected).abs() <= allowed, "{share} {z}: {found} for {expected}");
                }
                let newton = at_limit(&programs[1], precision, z, share);
                let bend = expected[2] - 0.5 * light * (1.0 - light) * h * h;
                assert!((newton[1] - expected[1]).abs() <= allowed && (newton[2] - bend).abs() <= 8.0 * allowed);
            }
        }
    }
}

/// Without defects a pixel at its limit is censored and nothing else, as far as f32 reaches.
#[test]
fn without_defects_the_tail_stays() {
    let program = at_limits(&Model::from_toml(LEVEL).unwrap(), Method::GaussNewton);
    for z in [-40.0, -2.0, 0.0, 3.0, 40.0, 200.0] {
        let [value, slope, _] = at_limit(&program, Precision::F32, z, 0.0);
        let expected = -2.0 * Function1::LogTail.value(z);
        assert!((value - expected).abs() <= 1e-5 * (1.0 + expected), "{z}: {value} for {expected}");
        let expected = -Function1::Hazard.value(z);
        assert!((slope - expected).abs() <= 1e-5 * (1.0 - expected), "{z}: {slope} for {expected}");
    }
    // A document may say what the word means.
    let own = LEVEL.replace("[model]", "[constants]\ndefects = 0.25\n[model]");
    assert_eq!(Model::from_toml(&own).unwrap().constants()[0].value, 0.25);
    let other = LEVEL.replace("v0", "defects");
    assert!(Model::from_toml(&other).unwrap().constants().is_empty());
    for text in [LEVEL.replace("censored", "dropped"), LEVEL.replace("noise = \"4\"\n", "")] {
        assert!(Model::from_toml(&text).unwrap().constants().is_empty(), "{text}");
    }
    // Nobody is told to remove what he did not write, and a camera without defects is compared with the formulas as well.
    assert!(Model::from_toml(LEVEL).unwrap().unused().is_empty());
    let none = Model::from_toml(&LEVEL.replace("[model]", "[constants]\ndefects = 0.0\n[model]")).unwrap();
    for method in [Method::GaussNewton, Method::Newton] {
        let [value, ..] = at_limit(&at_limits(&none, method), Precision::F64, 3.0, 0.0);
        assert!((value + 2.0 * Function1::LogTail.value(3.0)).abs() < 1e-9, "{value}");
    }
}

/// Three channels that see two lights in different mixtures, and what one number a channel costs and says.
#[test]
fn several_observed_values_are_summed_one_by_one() {
    let text = SPOT
        .replace("channels = [\"phi\"]", "channels = [\"r\", \"g\", \"b\"]")
        .replace("intensity = \"v0 + v1 * f\"", "intensity = \"[v0 + v1 * f, v0 + 0.25 * v1 * f, v0 + 0.1 * v1 * f]\"");
    let model = Model::from_toml(&text.replace("LIKELIHOOD", &format!("{NOISE}\nsaturated = \"censored\""))).unwrap();
    assert_eq!((model.entries(), model.summands().len()), (3, 6));
    let weak = sums_of(&model, 2);
    let strong = sums_of(&model, 0);
    // The weak channel is nowhere at its limit, the strong one is.
    assert!(strong[1].pixels > 20 && weak[1].pixels == 0, "{} {}", strong[1].pixels, weak[1].pixels);
    assert_eq!(strong[0].pixels + strong[0].saturated, weak[0].pixels + weak[0].saturated);
}

/// Of one entry: the sums below the limit, and those at it.
fn sums_of(model: &Model, entry: usize) -> Vec<interpreter::Outcome> {
    let summands = model.summands();
    let pair = summands.chunks(2).nth(entry).unwrap();
    let of = |summand: &Summand| {
        let lowering = Lowering { fma: false, drop_saturated: !summand.is_clipped() };
        let objective = summand.objective(&every(model), Method::GaussNewton).unwrap();
        sums(&objective.program(lowering).unwrap(), &POINT, &POINT)
    };
    pair.iter().map(of).collect()
}

/// A polynomial is added where the model has none of it, and a pixel that is no number is left out.
#[test]
fn variants_have_what_the_model_lacks_and_skip_what_is_blind() {
    let flat = spot(NOISE);
    let sloped = SPOT.replace("v1 = {", "gx = { start = 0.0 }\ngy = { start = 0.0 }\nv1 = {");
    let sloped = sloped.replace("v0 + v1 * f", "v0 + gx * x + gy * (y - by) + v1 * f");
    let sloped = Model::from_toml(&sloped.replace("LIKELIHOOD", NOISE)).unwrap();
    let added =
        |model: &Model, degree| model.with_background(degree, 1.5).0.parameters().len() - model.parameters().len();
    assert_eq!((added(&flat, 0), added(&flat, 1), added(&flat, 2), added(&flat, 3)), (0, 2, 5, 9));
    assert_eq!((added(&sloped, 1), added(&sloped, 2)), (0, 3));

    struct Blinded;
    impl Pixels for Blinded {
        fn at(&self, channel: usize, x: usize, y: usize) -> f64 {
            if x < 18 { f64::NAN } else { Picture.at(channel, x, y) }
        }
    }
    let objective = flat.objective(&every(&flat), Method::GaussNewton).unwrap().skipping_nan();
    let program = objective.program(Lowering { fma: false, drop_saturated: true }).unwrap();
    let bindings =
        Bindings { parameters: &POINT, entry: &POINT, constants: &[0.05, 0.75], saturation: &[254.5], shift: &[] };
    let outcome = interpreter::run(&program, Precision::F64, Lanes::Two, &bindings, &Blinded, WINDOW, None);
    let whole = sums(&program, &POINT, &POINT);
    assert!(outcome.outputs.iter().all(|sum| sum.is_finite()) && outcome.pixels < whole.pixels && outcome.pixels > 100);
}
