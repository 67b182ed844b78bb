//! Documents whose programs once were not what was proved: a wrong sign by contraction, rows without pixels, powers at 0.
#![allow(clippy::unwrap_used, missing_docs)]

use isophote_symbolic::interpreter::{self, Pixels, Slices, Window};
use isophote_symbolic::{Bindings, Lanes, Lowering, Method, Model, ParameterId, Precision, Program, ValueKind};

const HEAD: &str = "name = \"proved\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n";

struct Ramp;
impl Pixels for Ramp {
    fn at(&self, _: usize, x: usize, y: usize) -> f64 {
        (3 * x + 5 * y) as f64
    }
}

fn sums(program: &Program, parameters: &[f64], constants: &[f64]) -> Vec<f64> {
    let bindings = Bindings { parameters, entry: parameters, constants, saturation: &[255.0], shift: &[] };
    let window = Window { x: 0, y: 0, width: 24, height: 24, slices: Slices::ONE };
    interpreter::run(program, Precision::F64, Lanes::Two, &bindings, &Ramp, window, None).outputs
}

fn all(model: &Model) -> Vec<ParameterId> {
    (0..model.parameters().len() as u32).map(ParameterId).collect()
}

/// The formula is NaN above and below the disc, where no pixel takes part.
#[test]
fn rows_without_pixels_leave_no_trace() {
    for domain in ["(x - bx)^2 + (y - by)^2 < r^2", "(x - bx)^2 + (y - by)^2 <= r^2", "g > 0 or g > 1"] {
        let text = format!(
            "{HEAD}[parameters]\nbx = {{ start = 12.0 }}\nby = {{ start = 12.0 }}\nv1 = {{ start = 9.0 }}\n[constants]\nr = 8.0\n\
             [definitions]\ng = \"sqrt(r^2 - (y - by)^2)\"\n[model]\nintensity = \"v1*g*exp(-((x - bx)/5)^2)\"\ndomain = \"{domain}\"\n"
        );
        let model = Model::from_toml(&text).unwrap();
        for fma in [false, true] {
            let program = model.objective(&all(&model), Method::LevenbergMarquardt).unwrap();
            let program = program.program(Lowering { fma, drop_saturated: true }).unwrap();
            let found = sums(&program, &[12.2, 12.3, 9.0], &[8.0]);
            assert!(found.iter().all(|sum| sum.is_finite()), "{domain}: {found:?}");
        }
    }
}

/// d/da aᵇ and d²/da² aᵇ at a = 0, b a constant of the session.
#[test]
fn powers_have_their_derivatives_at_zero() {
    let text = format!(
        "{HEAD}[parameters]\na = {{ start = 0.5 }}\nc = {{ start = 1.0 }}\n[constants]\nb = 2.5\n[model]\nintensity = \"c * (a * x)^b\"\n"
    );
    let model = Model::from_toml(&text).unwrap();
    let program = model.objective(&all(&model), Method::Newton).unwrap().program(Lowering::default()).unwrap();
    // F, a, c, aa, ac, cc.
    let at = |b: f64| sums(&program, &[0.0, 1.5], &[b]);
    let sum = |f: fn(f64, f64) -> f64| -> f64 {
        (0..24).flat_map(|y| (0..24).map(move |x| f(f64::from(x), f64::from(y)))).sum()
    };
    let near = |found: f64, expected: f64, what: &str| {
        assert!((found - expected).abs() <= 1e-9 * expected.abs(), "{what}: {found} {expected}");
    };
    // r = φ − c a x: F_a = −2 Σ φ c x, F_aa = 2 Σ (c x)².
    let one = at(1.0);
    near(one[1], sum(|x, y| -2.0 * (3.0 * x + 5.0 * y) * 1.5 * x), "gradient, b = 1");
    near(one[3], sum(|x, _| 2.0 * (1.5 * x).powi(2)), "curvature, b = 1");
    // r = φ − c a² x²: F_a = 0, F_aa = −2 Σ φ 2 c x².
    let two = at(2.0);
    near(two[1], 0.0, "gradient, b = 2");
    near(two[3], sum(|x, y| -2.0 * (3.0 * x + 5.0 * y) * 2.0 * 1.5 * x * x), "curvature, b = 2");
    assert!(at(3.0).iter().all(|sum| sum.is_finite()));
}

/// Derivatives by a negative base, for whole exponents that only the session knows; by a free one they have no value there.
#[test]
fn powers_of_negative_bases_have_their_derivatives() {
    let text = format!(
        "{HEAD}[parameters]\na = {{ start = 0.5 }}\n[constants]\nb = 2.5\n[model]\nintensity = \"(a * (x + 1))^b\"\n"
    );
    let model = Model::from_toml(&text).unwrap();
    let program = model.objective(&all(&model), Method::Newton).unwrap().program(Lowering::default()).unwrap();
    for (a, b) in [(-0.25_f64, 1), (-0.25, 2), (-0.25, 3), (-0.5, 4), (-0.5, -1), (-0.5, -2)] {
        let found = sums(&program, &[a], &[f64::from(b)]);
        let (mut expected, mut terms) = ([0.0; 3], [0.0; 3]);
        for (x, y) in (0..24).flat_map(|y| (0..24).map(move |x| (x, y))) {
            let width = f64::from(x + 1);
            let power = |less: i32| width.powi(b) * a.powi(b - less);
            let (residual, slope) = (f64::from(3 * x + 5 * y) - power(0), f64::from(b) * power(1));
            let bend = f64::from(b * (b - 1)) * power(2);
            let pixel = [residual * residual, -2.0 * residual * slope, 2.0 * (slope * slope - residual * bend)];
            (0..3).for_each(|i| {
                expected[i] += pixel[i];
                terms[i] += pixel[i].abs();
            });
        }
        for ((found, expected), terms) in found.iter().zip(expected).zip(terms) {
            assert!((found - expected).abs() <= 1e-11 * terms, "a = {a}, b = {b}: {found} {expected}");
        }
    }
    let free = text.replace("b = 2.5\n", "").replace("[constants]\n", "b = { start = 2.5 }\n");
    let model = Model::from_toml(&free).unwrap();
    let program = model.objective(&all(&model), Method::Newton).unwrap().program(Lowering::default()).unwrap();
    let found = sums(&program, &[-0.25, 2.0], &[]);
    assert!(found[0].is_finite() && found[1].is_finite() && found[2].is_nan(), "{found:?}");
}

/// The exponent is free: its derivatives vanish with the base.
#[test]
fn a_free_exponent_is_finite_at_zero() {
    let text = format!(
        "{HEAD}[parameters]\na = {{ start = 0.5 }}\nb = {{ start = 2.5 }}\n[model]\nintensity = \"(a * x)^b\"\n"
    );
    let model = Model::from_toml(&text).unwrap();
    let program = model.objective(&all(&model), Method::Newton).unwrap().program(Lowering::default()).unwrap();
    for b in [2.0, 3.0] {
        let found = sums(&program, &[0.0, b], &[]);
        assert!(found.iter().all(|sum| sum.is_finite()), "{b}: {found:?}");
    }
}

/// Every program of a document whose minuend is a factor as well has the value that its formulas have without contraction.
#[test]
fn contracted_values_are_the_values() {
    let text = format!(
        "{HEAD}[parameters]\nbx = {{ start = 12.0 }}\nby = {{ start = 11.0 }}\nw = {{ start = 50.0, min = 1.0 }}\nv0 = {{ start = 110.0 }}\n\
         v1 = {{ start = 0.4 }}\n[definitions]\nf = \"exp(-((x - bx)^2 + (y - by)^2)/w)\"\nlevel = \"v0 + v1*y\"\nlost = \"f*v0 + f*v1*y\"\n\
         [model]\nintensity = \"level - lost\"\n"
    );
    let model = Model::from_toml(&text).unwrap();
    let objective = model.value_objective(ValueKind::Entry).unwrap();
    let of = |fma: bool| {
        sums(&objective.program(Lowering { fma, drop_saturated: false }).unwrap(), &[12.3, 10.7, 60.0, 120.0, 0.5], &[])
            [0]
    };
    assert!((of(true) - of(false)).abs() <= 1e-9 * of(false), "{} {}", of(true), of(false));
}

/// Formulas that have a value far from where targets are put in a check: on a chord about a parameter, near the origin, at
/// parameters whose powers f64 holds.
#[test]
fn formulas_that_are_finite_in_few_places_are_proved() {
    let few = [
        ("a * sqrt(32.5 - (y - b)^2)", "domain = \"(x - a)^2 + (y - b)^2 < 26.5\"\n"),
        ("a + b * asin(0.15 * x)", "noise = \"0.5 + intensity^2\"\nloss = \"tukey(4)\"\n"),
        ("a + b * acos(x) / sqrt(y)", "noise = \"0.7 + 0.4 * max(x, 0)\"\nsaturated = \"censored\"\n"),
        ("a + x * sinh(b^3)", "loss = \"huber(1.5)\"\n"),
    ];
    for (intensity, further) in few {
        let parameters = "[parameters]\na = { start = 1.0 }\nb = { start = 1.0, min = 0.0 }\n";
        let text = format!("{HEAD}{parameters}[model]\nintensity = \"{intensity}\"\n{further}");
        for summand in Model::from_toml(&text).unwrap().summands() {
            for (fma, method) in [(false, Method::Newton), (true, Method::GaussNewton)] {
                let derived = summand.objective(&all(summand.model()), method);
                let program = derived.and_then(|objective| objective.program(Lowering { fma, drop_saturated: false }));
                assert!(program.is_ok(), "{intensity}, {method:?}: {program:?}");
            }
        }
    }
}

/// A root of a negative number at every pixel, and its mean over a pixel, which exact arithmetic cannot follow: the
/// document's fault, and said so.
#[test]
fn formulas_without_a_value_are_told() {
    let formulas = "intensity = \"a * sqrt(-32.5 - (y - b)^2)\"\nquadrature = 2\n";
    let text = format!("{HEAD}[parameters]\na = {{ start = 1.0 }}\nb = {{ start = 1.0 }}\n[model]\n{formulas}");
    let model = Model::from_toml(&text).unwrap();
    let refused = model.objective(&all(&model), Method::Newton).map(drop);
    let codes: Vec<String> = refused.err().into_iter().flatten().map(|fault| fault.code).collect();
    assert_eq!(codes, ["undefined"]);
}

/// What is shown of a curve reads its predictor, and is what the formula says.
#[test]
fn a_picture_of_a_curve_is_proved() {
    let text = "name = \"curve\"\ncoordinates = [\"i\"]\nchannels = [\"x\", \"y\"]\n[parameters]\na = { start = 1.0 }\n\
                [model]\nobserved = \"y\"\nintensity = \"a * (1 - exp(-x))\"\n";
    let model = Model::from_toml(text).unwrap();
    assert!(model.rendering(Lowering::default()).is_ok());
}

/// An angle so large that f64 and double-double are on different sides of a loss' threshold (a random document).
#[test]
fn a_threshold_that_rounding_decides_is_no_fault() {
    let text = r#"
name = "random"
coordinates = ["x"]
channels = ["phi", "u"]
[parameters]
p0 = { start = 1.0 }
p1 = { start = 1.0, min = 0.0 }
p2 = { start = 1.0, min = 0.0 }
[definitions]
d0 = "([sqrt(exp((-0.25) * p1)), [x, p2, p2][1]]' * [[p2 * x, x], [x, (4.65 + x)]] * [sqrt(exp((-0.25) * p1)), [x, p2, p2][1]])"
d1 = "([p2, ([d0, 4.19]' * [[p1, d0], [d0, x]] * [d0, 4.19])]' * [[(-p1), (x + p0)], [(x + p0), acos(p0)]] * [p2, ([d0, 4.19]' * [[p1, d0], [d0, x]] * [d0, 4.19])])"
[model]
observed = "phi"
intensity = "(p0 + p1 * if(p1 >= p0, (if(p1 >= p0, d1, p2) - d0), p2 * d1) * ((x + (5.97 / (p2))) / (cos(d1 * d1))))"
noise = "(0.5 + (intensity)^2)"
loss = "tukey(4)"
"#;
    let model = Model::from_toml(text).unwrap();
    let objective = model.objective(&[ParameterId(1), ParameterId(2)], Method::GaussNewton);
    assert!(objective.and_then(|objective| objective.program(Lowering::default())).is_ok());
}

/// d − d has no value where d has none. A comparison with it is one with what is left, in every program.
#[test]
fn what_cancels_in_a_condition_decides_nothing() {
    let text = format!(
        "{HEAD}[parameters]\nbx = {{ start = 12.0 }}\nv1 = {{ start = 9.0 }}\n[definitions]\nd = \"sqrt(30 - (x - bx)^2)\"\n\
         [model]\nintensity = \"v1*if(x > -(d - y) + d, 1 + y, x)\"\n"
    );
    let model = Model::from_toml(&text).unwrap();
    for fma in [false, true] {
        assert!(model.rendering(Lowering { fma, drop_saturated: false }).is_ok());
    }
    assert_eq!(model.predicted(&[23.0, 2.0], &[12.0, 9.0], &[]), 27.0);
    assert_eq!(model.predicted(&[1.0, 2.0], &[12.0, 9.0], &[]), 9.0);
}
