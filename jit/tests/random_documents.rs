//! Native code equals the interpreter on documents that nobody thought of: formulas by a generator that knows the
//! language's grammar, and nothing of the compiler. The seed of a failing document is in its message.
#![allow(clippy::unwrap_used)]

mod common;

use common::{Image, Random, agree, lowerings};
use isophote_jit::{PixelFormat, Slices, Window};
use isophote_symbolic::{Bindings, Method, Model, ParameterId, Precision, ValueKind};

const PARAMETERS: [&str; 4] = ["p", "q", "u", "v"];

/// A formula of at most that depth.
fn formula(random: &mut Random, depth: usize) -> String {
    if depth == 0 || random.below(8) == 0 {
        return match random.below(8) {
            0 | 1 => "x".into(),
            2 => "y".into(),
            3..=5 => (*random.pick(&PARAMETERS)).into(),
            _ => format!("{:.2}", random.between(0.1, 9.0)),
        };
    }
    let mut sub = || formula(random, depth - 1);
    let (a, b) = (sub(), sub());
    match random.below(20) {
        0..=3 => format!("({a} + {b})"),
        4..=6 => format!("({a} - {b})"),
        7..=10 => format!("({a} * {b})"),
        11 => format!("({a} / {b})"),
        12 => format!("({a})^{}", random.pick(&["2", "3", "-1", "0.5"])),
        13 => format!("sqrt(abs({a}))"),
        14 => format!("min({a}, {b})"),
        15 => format!("max({a}, {b})"),
        16 => format!("abs({a})"),
        17 => format!("if({}, {a}, {b})", condition(random, depth - 1)),
        18 => format!("{}({a})", random.pick(&["exp", "log", "sin", "cos", "atan", "tanh", "erf"])),
        _ => format!("-({a})"),
    }
}

fn condition(random: &mut Random, depth: usize) -> String {
    let comparison = format!(
        "{} {} {}",
        formula(random, depth.min(2)),
        random.pick(&["<", "<=", ">", ">=", "==", "!="]),
        formula(random, depth.min(2))
    );
    match random.below(6) {
        0 => format!("({comparison} and {} < {})", formula(random, 1), formula(random, 1)),
        1 => format!("({comparison} or {} < {})", formula(random, 1), formula(random, 1)),
        2 => format!("(not {comparison})"),
        _ => comparison,
    }
}

fn domain(random: &mut Random) -> String {
    match random.below(6) {
        0 | 1 => String::new(),
        2 => "domain = \"(x - p)^2 + 0.2 * (x - p) * (y - q) + (y - q)^2 <= u * 40\"".into(),
        3 => "domain = \"x >= p - u and x <= p + 4 * u\"".into(),
        4 => format!("domain = \"{} <= {}\"", formula(random, 2), formula(random, 2)),
        _ => format!("domain = \"{}\"", condition(random, 2)),
    }
}

fn document(random: &mut Random) -> String {
    let parameters: String = PARAMETERS.iter().map(|p| format!("{p} = {{ start = 1.0 }}\n")).collect();
    let observed = random.pick(&["r", "r - 0.25 * g", "max(r, g)"]);
    let noise = *random.pick(&["", "", "noise = \"1.5 + abs(v) * 0.1 + x * 0.01\"\n"]);
    format!(
        "name = \"random\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"r\", \"g\"]\n[parameters]\n{parameters}[model]\n\
         observed = \"{observed}\"\nintensity = \"v + u * ({})\"\n{}\n{noise}",
        formula(random, 4),
        domain(random)
    )
}

#[test]
fn random_documents_agree() {
    let (first, count) = (1000, 120);
    let (mut ran, mut finite) = (0, 0);
    for seed in first..first + count {
        let mut random = Random(seed);
        let text = document(&mut random);
        let Ok(model) = Model::from_toml(&text) else { continue };
        let lowering = *random.pick(&lowerings());
        let subset: Vec<ParameterId> = (0..1 + random.below(PARAMETERS.len())).map(|i| ParameterId(i as u32)).collect();
        let method = *random.pick(&[Method::Newton, Method::GaussNewton]);
        let value = *random.pick(&[ValueKind::Entry, ValueKind::Full]);
        let programs = [model.objective(&subset, method), model.value_objective(value)];
        for program in programs.into_iter().filter_map(|o| o.ok()?.program(lowering).ok()) {
            let format = *random.pick(&PixelFormat::ALL);
            let gaps = *random.pick(&[[0, 0], [2, 1]]);
            let image = Image::new(format, [19, 9], 2, gaps, |_, _, _| random.between(0.0, 255.0));
            let values: Vec<f64> = (0..4).map(|_| random.between(-2.0, 12.0)).collect();
            let entry: Vec<f64> = (0..4).map(|_| random.between(-2.0, 12.0)).collect();
            let bindings =
                Bindings { parameters: &values, entry: &entry, saturation: &[240.0, 200.0], ..Bindings::default() };
            let window = Window {
                x: random.below(5),
                y: random.below(3),
                width: 5 + random.below(9),
                height: 4,
                slices: Slices::ONE,
            };
            for precision in [Precision::F32, Precision::F64] {
                let outcome = agree(&program, precision, &bindings, &image, window, &format!("seed {seed}\n{text}"));
                ran += 1;
                finite += u64::from(outcome.pixels > 0 && outcome.outputs[0].is_finite());
            }
        }
    }
    assert!(ran > count * 4 * 6 / 10, "only {ran} of {} cases were valid documents", count * 4);
    assert!(finite > ran * 6 / 10, "only {finite} of {ran} cases had pixels and a finite sum");
}
