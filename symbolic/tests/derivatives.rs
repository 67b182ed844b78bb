//! Derivatives against finite differences of the interpreter's own F (f64), for every shipped model.
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)]

use isophote_symbolic::interpreter::{Outcome, Pixels, Slices, Window, run};
use isophote_symbolic::{
    Bindings, Lanes, Lowering, Method, Model, Objective, ParameterId, Precision, Slopes, Start, ValueKind,
};

struct Pattern;
impl Pixels for Pattern {
    fn at(&self, channel: usize, x: usize, y: usize) -> f64 {
        let (x, y) = (x as f64, y as f64);
        20.0 + 90.0 * (-((x - 17.3).powi(2) + (y - 11.1).powi(2)) / 60.0).exp()
            + ((x * 7.0 + y * 13.0) % 5.0)
            + channel as f64
    }
    fn at_place(&self, channel: usize, [x, y, z, w]: [usize; 4]) -> f64 {
        self.at(channel, x, y) * (1.0 - 0.1 * (z as f64 - 3.3).abs()) + ((3 * z + 5 * w) % 7) as f64
    }
}

/// A plausible value for a parameter by its start.
fn value(i: usize, start: Start, name: &str) -> f64 {
    match start {
        Start::Number(x) => x,
        Start::Estimator(e) => match e.name() {
            "centroid.x" => 16.6,
            "centroid.y" => 11.7,
            "extent.xx" => 0.011,
            "extent.xy" => 0.0013,
            "extent.yy" => 0.009,
            "centroid.z" => 3.4,
            "extent.zz" => 0.04,
            "extent.xz" => 0.0007,
            "extent.yz" => -0.0005,
            "size.x" | "size.y" => 8.0,
            "size.z" => 4.0,
            "background" => 19.0,
            "amplitude" => 80.0,
            // A metre away, seen near the window's middle by f = 600 px about (319.5, 239.5).
            "pose.x" => -504.0,
            "pose.y" => -381.0,
            "pose.z" => 1000.0,
            "pose.rx" => 0.02,
            "pose.ry" => -0.015,
            "pose.rz" => 0.01,
            _ => panic!("{i} {name}"),
        },
    }
}

fn outcome(model: &Model, program: &isophote_symbolic::Program, p: &[f64], entry: &[f64]) -> Outcome {
    let constants: Vec<f64> = model.constants().iter().map(|c| c.value).collect();
    let saturation = vec![f64::INFINITY; model.channels().len()];
    let bindings = Bindings { parameters: p, entry, constants: &constants, saturation: &saturation, shift: &[] };
    let coordinates = model.coordinates().len();
    let height = if coordinates == 1 { 1 } else { 24 };
    let count = [if coordinates > 2 { 7 } else { 1 }, if coordinates > 3 { 3 } else { 1 }];
    run(
        program,
        Precision::F64,
        Lanes::Two,
        &bindings,
        &Pattern,
        Window { x: 0, y: 0, width: 37, height, slices: Slices { first: [0, 0], count } },
        None,
    )
}

fn check(model: &Model, subset: &[ParameterId], method: Method) {
    let lowering = Lowering { fma: true, drop_saturated: false };
    let value_program = model.value_objective(ValueKind::Full).unwrap().program(lowering).unwrap();
    let program = model.objective(subset, method).unwrap().program(lowering).unwrap();
    // A little off: at round numbers a place of a pixel may lie on a rim, where differences see half of a kink.
    let p: Vec<f64> = plausible(model).into_iter().map(|value| 1.000_3 * value).collect();
    let found = outcome(model, &program, &p, &p);
    let n = subset.len();
    let f = |p: &[f64], entry: &[f64]| outcome(model, &value_program, p, entry).outputs[0];
    let gradient_at = |q: &[f64]| outcome(model, &program, q, &p).outputs[1..=n].to_vec();
    let close = |a: f64, b: f64, scale: f64, what: &str| {
        assert!((a - b).abs() <= 2e-5 * scale.abs().max(1e-9), "{}: {what}: {a} against {b}\n{program}", model.name());
    };
    if !model.has_noise() {
        close(found.outputs[0], f(&p, &p), f(&p, &p), "F");
    }
    let mut k = 1 + n;
    for (i, u) in subset.iter().enumerate() {
        let h = 1e-6 * p[u.index()].abs().max(1e-3);
        let mut q = p.clone();
        q[u.index()] += h;
        let (up, g_up) = (f(&q, &p), gradient_at(&q));
        q[u.index()] -= 2.0 * h;
        let (down, g_down) = (f(&q, &p), gradient_at(&q));
        if !model.has_noise() || method == Method::Newton {
            let scale = (up - down).abs() / (2.0 * h) + f(&p, &p) * 1e-10 / h;
            close(found.outputs[1 + i], (up - down) / (2.0 * h), scale, &format!("gradient {i}"));
        }
        for j in i..n {
            if method == Method::Newton {
                let numeric = (g_up[j] - g_down[j]) / (2.0 * h);
                let scale = numeric.abs() + (g_up[j].abs() + found.outputs[1 + j].abs()) * 1e-9 / h;
                close(found.outputs[k], numeric, scale, &format!("hessian {i} {j}"));
            }
            k += 1;
        }
    }
}

const EXTRA: [&str; 6] = [
    r#"
name = "profile"
coordinates = ["x", "y"]
channels = ["phi"]
[tables.rings]
first = 0.0
step = 1.3
values = [1.0, 0.93, 0.7, 0.45, 0.3, 0.34, 0.21, 0.1, 0.02, 0.0]
[parameters]
bx = { start = 16.2 }
by = { start = 10.9 }
c = { start = 1.31, min = 0 }
v1 = { start = 70.0 }
[definitions]
s = "sqrt((x - bx)^2 + (y - by)^2 + 0.1) / c"
[model]
intensity = '20 + v1 * table("rings", s)'
"#,
    r#"
name = "image"
coordinates = ["x", "y"]
channels = ["phi"]
[tables]
psf = { first = [-7.0, -4.0], step = [2.0, 2.5], values = [[0.0, 0.1, 0.3, 0.2, 0.1, 0.05], [0.1, 0.5, 0.9, 0.6, 0.2, 0.1], [0.1, 0.6, 1.0, 0.4, 0.1, 0.0], [0.0, 0.1, 0.2, 0.1, 0.05, 0.0]] }
[parameters]
bx = { start = 16.2 }
by = { start = 10.9 }
phi0 = { start = 0.31 }
v1 = { start = 70.0 }
[definitions]
u = "cos(phi0)*(x - bx) - sin(phi0)*(y - by)"
v = "sin(phi0)*(x - bx) + cos(phi0)*(y - by)"
[model]
intensity = "20 + v1 * table(psf, u, v)"
"#,
    r#"
name = "functions"
coordinates = ["x", "y"]
channels = ["phi"]
[parameters]
b = { start = 16.2 }
c = { start = 3.1, min = 0 }
d = { start = 0.7 }
[definitions]
r = "sqrt((x - b)^2 + y^2 + c)"
"g(t)" = "t^2 / (1 + t^2)"
[model]
intensity = "30*exp(-r/c) + d*atan2(y + c, x + b) + sin(d*r) + g(d*x/10)*erf(c) + abs(x - b)^1.5 + c^d + tanh(r - 9)*log(r + c)"
"#,
    r#"
name = "waves"
coordinates = ["x", "y"]
channels = ["phi"]
[parameters]
b = { start = 16.0 }
k = { start = 0.7 }
c = { start = 3.1 }
[definitions]
u = "k * (x - b)"
[model]
intensity = "30*bessel_j0(u) + 20*bessel_j1(u + c*y/9) + c*sinc(u) + 7*erfc(u/2 - c) + sinc(c*(y - 11))*bessel_j1(u)/9"
"#,
    r#"
name = "branches"
coordinates = ["x", "y"]
channels = ["phi"]
[parameters]
b = { start = 16.21 }
c = { start = 3.1 }
a = { start = 5.3 }
[definitions]
u = "x - b"
s = "u^2 + (y - 11.3)^2"
[model]
intensity = "if(s < 50, a*sqrt(80 - s), if(u > 0, c*log(s), max(c*u, -a*u))) + piecewise(x < 5, c, x < 9, c^2, 0)"
domain = "x > 2 and not (y == 3)"
"#,
    r#"
name = "weights"
coordinates = ["x", "y"]
channels = ["p", "q"]
[constants]
gain = 0.05
[parameters]
bx = { start = "centroid.x" }
by = { start = "centroid.y" }
w = { start = 7.0, min = 0 }
v0 = { start = "background" }
v1 = { start = "amplitude" }
[definitions]
e = "exp(-((x-bx)^2 + (y-by)^2)/w^2)"
[model]
observed = "0.5*p + 0.5*q"
intensity = "v0 + v1*e"
noise = "4 + gain*max(intensity, 0)"
"#,
];

fn models() -> Vec<Model> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../models");
    let mut paths: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    paths.sort();
    let shipped = paths.iter().map(|p| std::fs::read_to_string(p).unwrap());
    let extra = EXTRA.iter().map(|t| t.to_string());
    let read = |text: String| {
        Model::from_toml(&text)
            .unwrap_or_else(|d| panic!("{}", d.iter().map(|d| d.render("model")).collect::<String>()))
    };
    shipped.chain(extra).map(read).collect()
}

#[test]
fn gradients_and_hessians_agree_with_differences() {
    for model in models() {
        let all: Vec<ParameterId> = (0..model.parameters().len() as u32).map(ParameterId).collect();
        let pair = &all[..2];
        for subset in [pair, &all[..]] {
            for method in [Method::Newton, Method::GaussNewton] {
                // A pose's second derivatives are past the limits; its documents ask for none.
                if method == Method::Newton && subset.len() > 2 && model.name().contains("-pose") {
                    continue;
                }
                check(&model, subset, method);
            }
        }
    }
}

/// Where sums are the same to within rounding, as shares of the largest of their kind.
fn alike(found: &[f64], wanted: &[f64]) -> bool {
    let scale = wanted.iter().fold(1e-9_f64, |most, x| most.max(x.abs()));
    found.len() == wanted.len() && found.iter().zip(wanted).all(|(a, b)| (a - b).abs() <= 1e-9 * scale)
}

/// Of a model's parameters in a picture of [`Pattern`].
fn plausible(model: &Model) -> Vec<f64> {
    let mut p: Vec<f64> = model.parameters().iter().enumerate().map(|(i, q)| value(i, q.start, &q.name)).collect();
    // The red spot of a pose is what the window shows.
    if let (Some(y), Some(red)) = (model.parameter("ty"), model.constant("red_y")) {
        p[y.index()] -= model.constants()[red.index()].value;
    }
    p
}

#[test]
fn loops_of_first_and_last_passes_sum_what_those_of_a_step_do() {
    let lowering = Lowering { fma: true, drop_saturated: false };
    let weighed = models().into_iter().filter(Model::has_noise);
    let models: Vec<Model> = weighed.flat_map(|model| [model.corrected(Slopes::Centre), model]).collect();
    assert!(models.len() > 20, "{} documents say how noisy a pixel is", models.len() / 2);
    for model in models {
        let parameters = &model.stages()[model.stages().len() - 1].parameters;
        let joint = model.objective(parameters, Method::GaussNewton).unwrap();
        let [opening, closing] = [joint.opening().unwrap(), joint.closing().unwrap()];
        let entry = plausible(&model);
        let moved: Vec<f64> = entry.iter().enumerate().map(|(i, u)| u * (1.0 + 1e-4 * (i % 3) as f64)).collect();
        let sums = |objective: &Objective, p: &[f64]| outcome(&model, &objective.program(lowering).unwrap(), p, &entry);
        let count = 1 + parameters.len();
        let (wanted, found) = (sums(&joint, &entry), sums(&opening, &entry));
        assert_eq!(found.pixels, wanted.pixels, "{}", model.name());
        for part in [0..1, 1..count, count..wanted.outputs.len()] {
            assert!(alike(&found.outputs[part.clone()], &wanted.outputs[part]), "{}: opening", model.name());
        }
        let (wanted, found) = (sums(&joint, &moved), sums(&closing, &moved));
        let outputs = count + parameters.len() + 2;
        assert_eq!((found.pixels, found.outputs.len()), (wanted.pixels, outputs), "{}", model.name());
        for part in [0..1, 1..count] {
            assert!(alike(&found.outputs[part.clone()], &wanted.outputs[part]), "{}: closing", model.name());
        }
        // Rows of the upper triangle begin with their diagonal.
        let diagonal = (0..parameters.len()).scan(count, |next, row| {
            let own = *next;
            *next += parameters.len() - row;
            Some(wanted.outputs[own])
        });
        for (found, wanted) in found.outputs[count..].iter().zip(diagonal) {
            assert!(alike(&[*found], &[wanted]), "{}: {found} on the diagonal, not {wanted}", model.name());
        }
        let full = sums(&model.value_objective(ValueKind::Full).unwrap(), &moved);
        assert!(alike(&found.outputs[count + parameters.len()..], &full.outputs), "{}: report", model.name());
        let flops = |objective: &Objective| objective.cost(lowering).unwrap().flops_per_pixel;
        let [joint, opening, closing] = [joint, opening, closing].map(|objective| flops(&objective));
        assert!(opening <= joint, "{}: {opening} flops of {joint}", model.name());
        println!("{}: {joint}, {opening}, {closing}", model.name());
    }
}
