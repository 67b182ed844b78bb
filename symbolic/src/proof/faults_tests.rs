//! Plants faults in a program of every kind (one wrong instruction, bound, mask or output), and runs the check on them.
//!
//! The interpreter separates harmless changes (a branch that no parameters take, a factor that is 1) from faults, on
//! pictures that the check does not use: the check must catch every change of a sum or pixel there.

use isophote_elementary::Function1;

use crate::graph::budget::Budget;
use crate::graph::random::Random;
use crate::objective::Objective;
use crate::program::interpreter::{Outcome, Pixels, Slices, Window, run};
use crate::program::{
    AccumulatorId, Bindings, ChannelId, CoordinateId, InputId, Instruction, Lanes, Literal, LoopNest, Op, Opcode,
    Precision, Sink, TotalId, Value,
};
use crate::proof::plane::{self, Shown};
use crate::{Lowering, Method, Model, ParameterId, Prediction, Summand, ValueKind};

/// A target, row values that may be NaN outside of the domain, two channels, a variance that depends on parameters.
const DOCUMENT: &str = r#"
name = "planted"
coordinates = ["x", "y"]
channels = ["p", "q"]
[parameters]
bx = { start = "centroid.x" }
by = { start = "centroid.y" }
a = { start = "extent.xx", min = 0 }
v0 = { start = "background" }
v1 = { start = "amplitude", min = 0 }
[constants]
r = 9.0
[definitions]
s = "a * ((x - bx)^2 + (y - by)^2)"
f = "PROFILE"
lost = "f * v0"
[roles]
centre = ["bx", "by"]
[model]
observed = "OBSERVED"
intensity = "v0 - lost + v1 * f"
LIKELIHOOD
"#;

const NOISE: &str = "noise = \"4 + 0.05 * max(intensity, 0)\"";

struct Case {
    profile: &'static str,
    observed: &'static str,
    likelihood: String,
}

fn cases() -> Vec<Case> {
    let case = |profile, observed, likelihood: &str| Case { profile, observed, likelihood: likelihood.into() };
    vec![
        case("exp(-s)", "p", "domain = \"s <= 2\""),
        case("1 / (2 + s)^2", "p - 0.5 * q", &format!("domain = \"s < 1 or (x - bx)^2 < 4\"\n{NOISE}")),
        case("if(s < 0.5, 1 - s^2, tanh(s) / s)", "p", &format!("{NOISE}\nloss = \"huber(1.5)\"")),
        case(
            "sqrt(r^2 - (y - by)^2) / r * exp(-((x - bx) / 5)^2)",
            "max(p, q)",
            "domain = \"(x - bx)^2 + (y - by)^2 < r^2\"\nloss = \"tukey(40)\"",
        ),
        case("exp(-s)", "p", &format!("saturated = \"censored\"\n{NOISE}")),
        case("exp(-s)", "q", "saturated = \"predicted\"\ndomain = \"s <= 2\""),
    ]
}

impl Case {
    fn model(&self) -> Model {
        let text = DOCUMENT.replace("PROFILE", self.profile).replace("OBSERVED", self.observed);
        let text = text.replace("LIKELIHOOD", &self.likelihood);
        Model::from_toml(&text).unwrap_or_else(|faults| panic!("{}\n{text}", faults[0].render("planted")))
    }
}

/// A target on a slope, with pixels at their limit.
struct Scene(u64);
impl Pixels for Scene {
    fn at(&self, channel: usize, x: usize, y: usize) -> f64 {
        let noise = Random(self.0 * 7919 + (channel * 1000 + y * 40 + x) as u64).signed();
        let far = (x as f64 - 12.3).powi(2) + (y as f64 - 9.6).powi(2);
        (30.0 + 100.0 * (-far / 60.0).exp() + 5.0 * channel as f64 + 25.0 * noise).max(0.0)
    }
}

/// Runs a program on a few scenes.
fn outcomes(program: &LoopNest) -> Vec<(Outcome, Vec<f32>)> {
    let run_in = |seed: u64| {
        let mut random = Random(seed);
        let mut near = |x: f64, by: f64| x * (1.0 + by * random.signed());
        let size = [0.012, 0.05, 0.4][seed as usize % 3];
        let parameters = [near(12.0, 0.05), near(9.5, 0.05), near(size, 0.2), near(25.0, 0.3), near(110.0, 0.3)];
        let entry = parameters.map(|p| near(p, 0.02));
        let saturation = [near(118.0, 0.1), near(112.0, 0.1)];
        let shift = [near(0.3, 0.5), near(-0.2, 0.5)];
        let bindings = Bindings {
            parameters: &parameters,
            entry: &entry,
            constants: &[9.0, 0.02],
            saturation: &saturation,
            shift: &shift,
        };
        let window = Window { x: 0, y: 0, width: 27, height: 24, slices: Slices::ONE };
        let mut plane = vec![0.0; 27 * 24];
        let is_plane = matches!(program.sink, Sink::Plane(_));
        let outcome = run(
            program,
            Precision::F64,
            Lanes::Two,
            &bindings,
            &Scene(seed),
            window,
            is_plane.then_some(&mut plane[..]),
        );
        (outcome, plane)
    };
    (0..4).map(run_in).collect()
}

/// True for differences beyond rounding.
fn differ(a: &[(Outcome, Vec<f32>)], b: &[(Outcome, Vec<f32>)]) -> bool {
    let far = |x: f64, y: f64, scale: f64| x.is_nan() != y.is_nan() || (x - y).abs() > 1e-6 * scale.max(x.abs());
    a.iter().zip(b).any(|((a, plane_a), (b, plane_b))| {
        let scale = 1e-6 * a.outputs.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        a.pixels != b.pixels
            || a.saturated != b.saturated
            || a.outputs.len() != b.outputs.len()
            || a.outputs.iter().zip(&b.outputs).any(|(x, y)| far(*x, *y, scale))
            || plane_a.iter().zip(plane_b).any(|(x, y)| far(f64::from(*x), f64::from(*y), 1e-3))
    })
}

/// Wrong replacements of an operation.
fn wrong(program: &LoopNest, op: Op) -> Vec<Op> {
    let inputs = program.inputs.len() as u32;
    let (sums, totals) = match &program.sink {
        Sink::Sums { accumulators, totals, .. } => (accumulators.len() as u32, totals.len() as u32),
        Sink::Plane(_) => (0, 0),
    };
    let to = |code: Opcode, operands: &[usize]| {
        let at = |i: usize| op.operands().nth(operands[i]).unwrap();
        match operands.len() {
            0 => code.of([]),
            1 => code.of([at(0)]),
            2 => code.of([at(0), at(1)]),
            _ => code.of([at(0), at(1), at(2)]),
        }
    };
    let number = |x: f64| Opcode::Const(Literal::new(x)).of([]);
    let (a, b, c) = (0, 1, 2);
    let all = match op.code {
        Opcode::Const(x) => vec![number(1.5 * x.get() + 0.25), number(-x.get())],
        Opcode::Input(i) => [1, 2].map(|k| to(Opcode::Input(InputId((i.0 + k) % inputs)), &[])).to_vec(),
        Opcode::Outer(_) => vec![number(3.0), to(Opcode::Outer(CoordinateId(1)), &[])],
        Opcode::Channel(c) => vec![to(Opcode::Channel(ChannelId(1 - c.0)), &[])],
        Opcode::Add => vec![to(Opcode::Sub, &[a, b]), to(Opcode::Add, &[a, a]), to(Opcode::Mul, &[a, b])],
        Opcode::Sub => vec![to(Opcode::Add, &[a, b]), to(Opcode::Sub, &[b, a])],
        Opcode::Mul => vec![to(Opcode::Mul, &[a, a]), to(Opcode::Mul, &[b, b]), to(Opcode::Div, &[a, b])],
        Opcode::Div => vec![to(Opcode::Div, &[b, a]), to(Opcode::Mul, &[a, b])],
        Opcode::Fma => vec![
            to(Opcode::Fma, &[a, a, c]),
            to(Opcode::Fma, &[a, b, a]),
            to(Opcode::Mul, &[a, b]),
            to(Opcode::Add, &[a, c]),
        ],
        Opcode::Neg => vec![to(Opcode::Abs, &[a]), to(Opcode::Add, &[a, a])],
        Opcode::Abs => vec![to(Opcode::Neg, &[a]), to(Opcode::Mul, &[a, a])],
        Opcode::Sqrt => vec![to(Opcode::Abs, &[a]), to(Opcode::Mul, &[a, a])],
        Opcode::Call1(f) => {
            let other = if f == Function1::Exp { Function1::Tanh } else { Function1::Exp };
            vec![to(Opcode::Call1(other), &[a]), to(Opcode::Neg, &[a])]
        }
        Opcode::Compare(comparison) => vec![to(Opcode::Compare(comparison), &[b, a])],
        Opcode::And => vec![to(Opcode::Or, &[a, b]), to(Opcode::And, &[a, a])],
        Opcode::Or => vec![to(Opcode::And, &[a, b]), to(Opcode::Or, &[b, b])],
        Opcode::Select => vec![to(Opcode::Select, &[a, c, b]), to(Opcode::Select, &[a, b, b])],
        Opcode::RowTotal(i) => {
            vec![to(Opcode::RowTotal(AccumulatorId((i.0 + 1) % sums)), &[]), to(Opcode::RowCount, &[])]
        }
        Opcode::RowCount => vec![number(1.0)],
        Opcode::PassTotal(i) => {
            vec![to(Opcode::PassTotal(TotalId((i.0 + 1) % totals)), &[]), to(Opcode::PassCount, &[])]
        }
        _ => Vec::new(),
    };
    all.into_iter().filter(|new| *new != op).collect()
}

/// All programs with one fault each, and its description.
fn planted(program: &LoopNest) -> Vec<(String, LoopNest)> {
    let mut all = Vec::new();
    let mut plant = |what: String, change: &dyn Fn(&mut LoopNest)| {
        let mut changed = program.clone();
        change(&mut changed);
        if changed.check().is_ok() && changed != *program {
            all.push((what, changed));
        }
    };
    for (i, Instruction { op, .. }) in program.instructions.iter().enumerate() {
        for new in wrong(program, *op) {
            plant(format!("v{i}: {op:?} became {new:?}"), &|program| program.instructions[i].op = new);
        }
    }
    plant("no bounds".into(), &|program| program.pixel_set.bounds = None);
    plant("bounds turned".into(), &|program| {
        program.pixel_set.bounds = program.pixel_set.bounds.map(|(lo, hi)| (hi, lo));
    });
    plant("no mask".into(), &|program| program.pixel_set.mask = None);
    plant("saturated pixels taken".into(), &|program| program.pixel_set.saturated = None);
    let truth = (0..program.instructions.len() as u32)
        .map(Value)
        .find(|v| program.is_truth(*v) && program.instruction(*v).level == crate::program::Level::Pixel);
    if let Some(truth) = truth {
        plant("another mask".into(), &|program| program.pixel_set.mask = Some(truth));
        plant("other pixels saturated".into(), &|program| program.pixel_set.saturated = Some(truth));
    }
    for i in 1..program.sink.outputs().len() {
        plant(format!("outputs {i} and before exchanged"), &|program| {
            if let Sink::Sums { outputs, .. } = &mut program.sink {
                outputs.swap(i - 1, i);
            }
        });
    }
    plant("an output missing".into(), &|program| {
        if let Sink::Sums { outputs, .. } = &mut program.sink {
            outputs.pop();
        }
    });
    all
}

/// Counts for one kind of program.
#[derive(Default, Debug)]
struct Tally {
    caught: usize,
    /// Uncaught faults that change a sum or a pixel of a scene.
    missed: Vec<String>,
    /// Number of uncaught faults that change nothing there.
    silent: usize,
}

impl Tally {
    fn plant(&mut self, program: &LoopNest, passes: &dyn Fn(&LoopNest) -> bool, what: &str) {
        assert!(passes(program), "{what}\n{program}");
        let mut sound = None;
        for (fault, changed) in planted(program) {
            if !passes(&changed) {
                self.caught += 1;
            } else if differ(sound.get_or_insert_with(|| outcomes(program)), &outcomes(&changed)) {
                self.missed.push(format!("{what}: {fault}\n{changed}"));
            } else {
                self.silent += 1;
            }
        }
    }

    fn sums(&mut self, objective: &Objective, what: &str) {
        for (fma, drop_saturated) in [(false, false), (true, false), (false, true), (true, true)] {
            let lowering = Lowering { fma, drop_saturated };
            let program = objective.program(lowering).unwrap();
            let dropped = if drop_saturated && !objective.is_joint() { objective.channels() } else { Vec::new() };
            let passes = |program: &LoopNest| objective.referee().check(program, &dropped).is_some();
            self.plant(&program, &passes, &format!("{what}, {lowering:?}"));
        }
    }

    /// Asserts that every fault that matters is caught, and nine in ten of all.
    fn all_caught(&self, kind: &str, least: usize) {
        let Tally { caught, missed, silent } = self;
        let first = missed.first().map_or("", String::as_str);
        assert!(missed.is_empty(), "{kind}: {} missed; {first}", missed.len());
        assert!(*caught >= least && caught > &(9 * silent), "{kind}: {caught} caught, {silent} without effect");
    }
}

/// Runs each case, and each of its summands.
fn each(mut of: impl FnMut(&Summand, &str)) {
    for case in cases() {
        for summand in case.model().summands() {
            let likelihood = case.likelihood.replace('\n', ", ");
            of(&summand, &format!("{} {likelihood} {}", case.profile, summand.is_clipped()));
        }
    }
}

#[test]
fn every_fault_in_a_value_is_caught() {
    let mut tally = Tally::default();
    each(|summand, what| {
        for kind in [ValueKind::Entry, ValueKind::Full] {
            tally.sums(&summand.value_objective(kind).unwrap(), &format!("{what} {kind:?}"));
        }
    });
    tally.all_caught("value", 500);
}

#[test]
fn every_fault_in_derivatives_is_caught() {
    for method in [Method::GaussNewton, Method::Newton] {
        let mut tally = Tally::default();
        each(|summand, what| {
            let some: Vec<ParameterId> = [0, 2, 4].map(ParameterId).to_vec();
            tally.sums(&summand.objective(&some, method).unwrap(), what);
        });
        tally.all_caught(method.name(), 1000);
    }
}

/// Two channels in one loop: weights of each, shared directions, limits, counts.
#[test]
fn every_fault_in_a_loop_of_several_channels_is_caught() {
    let likelihoods = ["domain = \"s <= 2\"".into(), format!("{NOISE}\nsaturated = \"censored\"")];
    let mut tally = Tally::default();
    for likelihood in likelihoods {
        let text =
            DOCUMENT.replace("PROFILE", "exp(-s)").replace("OBSERVED", "[p, q]").replace("LIKELIHOOD", &likelihood);
        let text = text.replace("\"v0 - lost + v1 * f\"", "\"[v0 - lost + v1 * f, 0.3 * (v0 - lost) + 0.6 * v1 * f]\"");
        let model = Model::from_toml(&text).unwrap();
        let joint = Summand::joint(&model.summands()).unwrap();
        let some: Vec<ParameterId> = [0, 2, 4].map(ParameterId).to_vec();
        let steps = joint.objective(&some, Method::GaussNewton).unwrap();
        for objective in [&steps, &steps.closing().unwrap(), &joint.value_objective(ValueKind::Full).unwrap()] {
            tally.sums(objective, &likelihood);
        }
    }
    tally.all_caught("joint", 500);
}

#[test]
fn every_fault_in_sums_without_nan_pixels_is_caught() {
    let mut tally = Tally::default();
    each(|summand, what| {
        let all: Vec<ParameterId> = [1, 3].map(ParameterId).to_vec();
        let objective = summand.objective(&all, Method::GaussNewton).unwrap().skipping_nan();
        tally.sums(&objective, what);
    });
    tally.all_caught("skipping NaN", 500);
}

/// Plainer forms have graphs of their own, which must leave out NaN pixels as well.
#[test]
fn plainer_forms_leave_nan_pixels_out() {
    each(|summand, what| {
        let all: Vec<ParameterId> = [1, 3].map(ParameterId).to_vec();
        let objective = summand.objective(&all, Method::GaussNewton).unwrap().skipping_nan();
        let program = objective.plainer(Lowering { fma: true, drop_saturated: false }, &Budget::after(0)).unwrap();
        assert!(program.pixel_set().mask.is_some(), "{what}\n{program}");
    });
}

#[test]
fn every_fault_in_a_plane_is_caught() {
    let mut tally = Tally::default();
    each(|summand, what| {
        let (formulas, entry) = (&summand.model().formulas, summand.first());
        for fma in [false, true] {
            let lowering = Lowering { fma, drop_saturated: false };
            let mut graph = (*formulas.graph).clone();
            let variance = entry.noise.unwrap_or_else(|| graph.number(1.0));
            let mut planes = vec![(
                summand.rendering(lowering).unwrap(),
                Shown { summand, graph: &graph, value: entry.shown, domain: None, is_shifted: true },
            )];
            for (prediction, value, domain) in [
                (Prediction::Intensity, entry.intensity, formulas.domain),
                (Prediction::Unbounded, entry.intensity, None),
                (Prediction::Variance, variance, None),
            ] {
                let program = summand.prediction(prediction, lowering).unwrap().unwrap();
                planes.push((program, Shown { summand, graph: &graph, value, domain, is_shifted: false }));
            }
            for (program, shown) in planes {
                let passes = |program: &LoopNest| plane::proved(&shown, program.clone()).is_some();
                tally.plant(&program, &passes, &format!("{what} {:?} {lowering:?}", shown.value));
            }
        }
    });
    tally.all_caught("plane", 300);
}
