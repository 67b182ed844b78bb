//! Several channels in one loop: the sums of all of them at once are those of each by itself, whatever is at its limit or is no
//! number.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use isophote_symbolic::interpreter::{self, Outcome, Pixels, Slices, Window};
use isophote_symbolic::{
    Bindings, Lanes, Lowering, Method, Model, Objective, ParameterId, Precision, Summand, ValueKind,
};

const WINDOW: Window = Window { x: 300, y: 195, width: 41, height: 35, slices: Slices::ONE };
const LIMIT: f64 = 200.0;

/// A spot of another height in each channel, with noise; here and there a pixel is no number in one of them.
struct Picture;

impl Pixels for Picture {
    fn at(&self, channel: usize, x: usize, y: usize) -> f64 {
        let (dx, dy) = (x as f64 - 319.3, y as f64 - 212.8);
        let f = (1.0 - dx * dx / 180.0 - dy * dy / 90.0).max(0.0);
        let number = x * 7919 + y * 104_729 + channel * 31;
        match number % 211 {
            0 => f64::NAN,
            rest => 20.0 + (300.0 - 130.0 * channel as f64) * f + (rest % 97) as f64 / 24.0,
        }
    }
}

fn shipped(name: &str) -> Model {
    let path = format!("{}/../models/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    Model::from_toml(&std::fs::read_to_string(path).unwrap()).unwrap()
}

/// Two lights in three channels, with all that goes into F of a pixel; LIKELIHOOD stands for further keys.
fn two_lights(likelihood: &str) -> Model {
    let text = r#"
name = "two-lights"
coordinates = ["x", "y"]
channels = ["r", "g", "b"]
[parameters]
x1 = { start = 318.0 }
x2 = { start = 322.0 }
w = { start = 9.0, min = 0 }
v1 = { start = 150.0 }
v2 = { start = 90.0 }
v0 = { start = 20.0 }
[constants]
gain = 0.05
mix = 0.2
[definitions]
"light(at)" = "exp(-((x - at)^2 + (y - 213)^2) / w^2)"
[model]
observed = "[r, g, b]"
intensity = "[v0 + v1*light(x1) + mix*v2*light(x2), v0 + mix*v1*light(x1) + v2*light(x2), v0 + mix*(v1*light(x1) + v2*light(x2))]"
LIKELIHOOD
"#;
    Model::from_toml(&text.replace("LIKELIHOOD", likelihood)).unwrap()
}

fn parameters(model: &Model) -> Vec<f64> {
    let made_up = |name: &str| match name {
        "tx" | "ty" => 5.0,
        "tz" => 1500.0,
        "m1" | "m2" | "m3" => 0.1,
        "blur" => 0.8,
        "w" => 8.0,
        _ if name.starts_with(['x', 'X']) => 318.0,
        _ if name.starts_with('y') => 211.0,
        _ if name.starts_with('v') => 60.0,
        _ if name.ends_with('2') => 0.0007,
        _ => 0.009,
    };
    model.parameters().iter().enumerate().map(|(i, p)| made_up(&p.name) * (1.0 + 0.01 * i as f64)).collect()
}

fn summed(model: &Model, objective: &Objective, drop_saturated: bool) -> Outcome {
    let program = objective.program(Lowering { fma: false, drop_saturated }).unwrap();
    let parameters = parameters(model);
    let entry: Vec<f64> = parameters.iter().map(|p| p * 1.003).collect();
    let constants: Vec<f64> = model.constants().iter().map(|constant| constant.value).collect();
    let bindings =
        Bindings { parameters: &parameters, entry: &entry, constants: &constants, saturation: &[LIMIT; 3], shift: &[] };
    interpreter::run(&program, Precision::F64, Lanes::Two, &bindings, &Picture, WINDOW, None)
}

/// The joint loop against the loops of the channels, added up.
fn is_the_sum(model: &Model, what: &str, derive: &dyn Fn(&Summand) -> Objective) {
    let summands = model.summands();
    let joint = Summand::joint(&summands).unwrap();
    assert_eq!(joint.entries(), 3);
    let together = summed(model, &derive(&joint), true);
    let seen = summands.iter().filter(|summand| !summand.is_clipped());
    let apart: Vec<Outcome> = seen.map(|summand| summed(model, &derive(summand).skipping_nan(), true)).collect();
    let (sums, counts) = together.outputs.split_at(together.outputs.len() - 2);
    for (i, sum) in sums.iter().enumerate() {
        let each = apart.iter().map(|outcome| outcome.outputs[i]);
        let (wanted, scale) = each.fold((0.0, 0.0), |(sum, scale), x| (sum + x, scale + x.abs()));
        assert!((sum - wanted).abs() <= 1e-9 * scale, "{}, {what}, {i}: {sum} {wanted}", model.name());
    }
    let of = |count: fn(&Outcome) -> u64| apart.iter().map(count).sum::<u64>() as f64;
    assert_eq!(counts, [of(|outcome| outcome.pixels), of(|outcome| outcome.saturated)], "{} {what}", model.name());
    assert!(counts[1] > 20.0 && counts[0] > 500.0, "{counts:?}");
}

#[test]
fn channels_in_one_loop_sum_what_each_does_by_itself() {
    let noise = r#"noise = "1 + gain * max(intensity, 0)""#;
    let models = [
        shipped("three-spots-raw"),
        shipped("three-spots-pose-raw"),
        two_lights(""),
        two_lights(&format!("{noise}\nsaturated = \"censored\"")),
        two_lights(&format!("{noise}\nloss = \"huber(2)\"\nquadrature = 2")),
    ];
    for model in &models {
        let last = model.stages().last().unwrap().parameters.clone();
        let gauss_newton = |summand: &Summand| summand.objective(&last, Method::GaussNewton).unwrap();
        is_the_sum(model, "derivatives", &gauss_newton);
        is_the_sum(model, "opening", &|summand| gauss_newton(summand).opening().unwrap());
        is_the_sum(model, "closing", &|summand| gauss_newton(summand).closing().unwrap());
        is_the_sum(model, "value", &|summand| summand.value_objective(ValueKind::Entry).unwrap());
        is_the_sum(model, "report", &|summand| summand.value_objective(ValueKind::Full).unwrap());
    }
    let newton = |summand: &Summand| summand.objective(&[ParameterId(0), ParameterId(4)], Method::Newton).unwrap();
    is_the_sum(&models[2], "newton", &newton);
    is_the_sum(&models[3], "newton", &newton);
}

/// Where channels have nothing in common, or what one shows enters another, each keeps a loop of its own.
#[test]
fn channels_that_share_nothing_stay_apart() {
    let joint = |model: &Model| Summand::joint(&model.summands()).is_some();
    assert!(!joint(&shipped("spot")) && !joint(&shipped("three-spots")) && !joint(&shipped("three-spots-pose")));
    assert!(joint(&two_lights("")) && !joint(&two_lights("noise = \"1 + gain * max(r, 0)\"")));
}

/// What one loop saves, in operations a pixel.
#[test]
fn what_several_channels_share_is_worked_out_once() {
    let lowering = Lowering { fma: true, drop_saturated: true };
    for name in ["three-spots-raw", "three-spots-pose-raw"] {
        let model = shipped(name);
        let summands = model.summands();
        let last = model.stages().last().unwrap().parameters.clone();
        let flops = |summand: &Summand| {
            let objective = summand.objective(&last, Method::GaussNewton).unwrap();
            let all = [Ok(objective.clone()), objective.opening(), objective.closing()];
            all.map(|objective| objective.unwrap().cost(lowering).unwrap().flops_per_pixel)
        };
        let together = flops(&Summand::joint(&summands).unwrap());
        let seen = summands.iter().filter(|summand| !summand.is_clipped());
        let apart = seen.map(flops);
        let apart = apart.fold([0; 3], |sum, each| [sum[0] + each[0], sum[1] + each[1], sum[2] + each[2]]);
        println!("{name}: {together:?} flops a pixel (a step's, opening, closing) in one loop, {apart:?} in three");
        assert!(together.iter().zip(apart).all(|(together, apart)| 5 * together < 3 * apart), "{together:?} {apart:?}");
    }
}
