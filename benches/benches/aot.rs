//! `cargo bench -p isophote-benches --bench aot`: the compiler in the process against compilers ahead of time, on the same
//! frames in one run.
//!
//! Contenders take turns: each round runs every contender once, and a ratio is the median of the ratios of the rounds, so that
//! what disturbs the machine for a while disturbs all of them. Wall time of one thread, divided by the pixels of the domain.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use std::hint::black_box;
use std::time::Instant;

use isophote_benches::contenders::{self, Function, Way};
use isophote_benches::foreign::{Compiled, Picture};
use isophote_benches::text;
use isophote_jit::{Kernel, KernelOptions, PixelFormat, PlaneView, Window, has_fma};
use isophote_symbolic::{Bindings, Lowering, Method, Model, Part, PixelType, Precision, Program, Sink};

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
const SUBSETS: [(&str, &str); 4] =
    [("b", "bx,by"), ("a", "a1,a2,a3"), ("a_b", "bx,by,a1,a2,a3"), ("a_b_v", "bx,by,a1,a2,a3,v0,v1")];
const ROUNDS: usize = 60;

fn values(model: &Model) -> Vec<f64> {
    let value = |name: &str| match name {
        "bx" => 320.3,
        "by" => 240.7,
        "a1" => 1.0 / (250.0 * 250.0),
        "a2" => 1e-6,
        "a3" => 1.0 / (196.0 * 196.0),
        "v0" => 20.0,
        "v1" => 150.0,
        "k1" => -0.5,
        _ => -0.3,
    };
    model.parameters().iter().map(|p| value(&p.name)).collect()
}

/// The model's picture with noise that is no noise: a pattern that every run has.
fn picture(model: &Model, parameters: &[f64]) -> Vec<f32> {
    let program = model.rendering(Lowering { fma: has_fma(), drop_saturated: false }).unwrap();
    let options = KernelOptions { precision: Precision::F32, formats: vec![PixelFormat::F32], packed: true };
    let mut plane = vec![0.0; WIDTH * HEIGHT];
    let bindings = Bindings { parameters, entry: parameters, ..Bindings::default() };
    Kernel::compile(&program, &options).unwrap().render(&bindings, Window::whole(WIDTH, HEIGHT), &mut plane).unwrap();
    plane.iter_mut().enumerate().for_each(|(i, p)| *p += ((i * 7919) % 11) as f32 - 5.0);
    plane
}

struct Case {
    name: &'static str,
    jit: Kernel,
    optimised: Program,
    plain: Program,
}

fn cases(model: &Model) -> Vec<Case> {
    let case = |(name, subset): (&'static str, &str)| {
        let ids: Vec<_> = subset.split(',').map(|n| model.parameter(n).unwrap()).collect();
        let optimised = model
            .objective(&ids, Method::Newton)
            .unwrap()
            .program(Lowering { fma: has_fma(), drop_saturated: false })
            .unwrap();
        let plain = model.plain_program(&ids, Method::Newton, Part::Both).unwrap().over_pixels_of(&optimised);
        let options = KernelOptions { precision: Precision::F32, formats: vec![PixelFormat::F32], packed: true };
        Case { name, jit: Kernel::compile(&optimised, &options).unwrap(), optimised, plain }
    };
    SUBSETS.map(case).into_iter().collect()
}

/// One turn: nanoseconds a pixel, and the sums.
type Turn<'a> = Box<dyn Fn() -> (f64, Vec<f64>) + 'a>;

struct Contender<'a> {
    name: String,
    turn: Turn<'a>,
    code_bytes: Option<usize>,
    /// F stands in front of its outputs.
    has_value: bool,
}

fn timed(f: impl Fn() -> (Vec<f64>, u64)) -> (f64, Vec<f64>) {
    let start = Instant::now();
    let (outputs, pixels) = black_box(f());
    (start.elapsed().as_secs_f64() * 1e9 / pixels as f64, outputs)
}

/// What an error of each output is measured by: of F itself, of dF/du √(F Fuu), of Fuv √(Fuu Fvv). Outputs are F, n
/// derivatives and the upper triangle of the Hessian, row by row.
fn scales(outputs: &[f64]) -> Vec<f64> {
    let n = (1..20).find(|n| 1 + n + n * (n + 1) / 2 == outputs.len()).unwrap();
    let mut places = outputs[1 + n..].iter();
    let mut diagonal = Vec::new();
    for i in 0..n {
        diagonal.push(places.next().unwrap().abs());
        places.by_ref().take(n - 1 - i).for_each(drop);
    }
    let value = outputs[0].abs();
    let first = diagonal.iter().map(|d| (d * value).sqrt());
    let second = (0..n).flat_map(|i| (i..n).map(move |j| (i, j))).map(|(i, j)| (diagonal[i] * diagonal[j]).sqrt());
    [value].into_iter().chain(first).chain(second).collect()
}

/// True when both sums say the same.
fn agree(ours: &[f64], theirs: &[f64], scales: &[f64]) -> bool {
    let near = |((a, b), scale): ((&f64, &f64), &f64)| (a - b).abs() <= 1e-4 * scale;
    ours.len() == theirs.len() && ours.iter().zip(theirs).zip(scales).all(near)
}

fn main() {
    let model = Model::from_toml(&text("thesis-spot")).unwrap();
    let truth = values(&model);
    let pixels = picture(&model, &truth);
    // Off the minimum, where the gradient would be a difference of large sums.
    let shifts = [3.0, -2.0, 1.0, 0.95, 1.05, 1.0, 1.0, 1.0, 1.1];
    let shift =
        |(value, shift): (&f64, f64)| if *value > 100.0 && *value != 150.0 { value + shift } else { value * shift };
    let parameters: Vec<f64> = truth.iter().zip(shifts).map(shift).collect();
    // Four bytes a pixel, aligned as the pixels are.
    let bytes: Vec<u8> = pixels.iter().flat_map(|p| p.to_ne_bytes()).collect();
    let cases = cases(&model);
    let ways = contenders::ways();
    let compiled: Vec<(Way, Compiled)> = ways
        .into_iter()
        .map(|way| {
            let functions: Vec<Function> = cases
                .iter()
                .map(|case| Function {
                    name: case.name.into(),
                    program: if way.plain { &case.plain } else { &case.optimised },
                    pixel: PixelType::F32,
                })
                .collect();
            let source = contenders::source(&model, &way, &functions);
            let extension = if way.command[0] == "cc" { "c" } else { "rs" };
            let file = format!("{}.{extension}", way.name.replace([',', ' '], "_"));
            let made = Compiled::new(&contenders::folder(), &file, &source, &way.command).unwrap();
            (way, made)
        })
        .collect();
    let bindings =
        Bindings { parameters: &parameters, entry: &parameters, saturation: &[255.0], ..Bindings::default() };
    let plane = PlaneView::new(PixelFormat::F32, &bytes, WIDTH, HEIGHT, WIDTH * 4, 4).unwrap();
    for case in &cases {
        let mut contenders = vec![Contender {
            name: "isophote's JIT, 128 bits".into(),
            turn: Box::new(|| {
                timed(|| {
                    let sums = case.jit.sums(&bindings, &[plane], Window::whole(WIDTH, HEIGHT)).unwrap();
                    (sums.outputs, sums.pixels)
                })
            }),
            code_bytes: Some(case.jit.code_bytes()),
            has_value: true,
        }];
        for (way, made) in &compiled {
            let program = if way.plain { &case.plain } else { &case.optimised };
            let Sink::Sums { outputs, .. } = program.sink() else { unreachable!() };
            let inputs = program.gather(&bindings);
            let call = format!("call_{}", case.name);
            let function = made.function(&call, inputs.len(), outputs.len(), 4).unwrap();
            let picture = Picture { bytes: &bytes, width: WIDTH, height: HEIGHT };
            contenders.push(Contender {
                name: way.name.into(),
                turn: Box::new(move || timed(|| function.sums(picture, [0, 0, WIDTH, HEIGHT], &inputs).unwrap())),
                code_bytes: made.code_bytes(case.name).or_else(|| made.code_bytes(&call)),
                has_value: !way.plain,
            });
        }
        let expected = (contenders[0].turn)().1;
        for contender in &contenders {
            let sums = (contender.turn)().1;
            let from = usize::from(!contender.has_value);
            let (ours, scales) = (&expected[from..], &scales(&expected)[from..]);
            assert!(agree(ours, &sums, scales), "{}: {sums:?} instead of {ours:?}", contender.name);
            let wrong: Vec<f64> = sums.iter().map(|sum| sum * 1.01).collect();
            assert!(!agree(ours, &wrong, scales), "a planted fault is not noticed");
        }
        let rounds: Vec<Vec<f64>> =
            (0..ROUNDS).map(|_| contenders.iter().map(|contender| (contender.turn)().0).collect()).collect();
        println!("\n{{{}}}: ns a pixel, median (min), code bytes, and how many times the JIT's", case.name);
        for (i, contender) in contenders.iter().enumerate() {
            let median = |mut all: Vec<f64>| {
                all.sort_by(f64::total_cmp);
                (all[all.len() / 2], all[0])
            };
            let (middle, least) = median(rounds.iter().map(|round| round[i]).collect());
            let (ratio, _) = median(rounds.iter().map(|round| round[i] / round[0]).collect());
            let bytes = contender.code_bytes.map_or(String::from("?"), |bytes| bytes.to_string());
            println!("{:32} {middle:7.3} ({least:.3}) {bytes:>6} {ratio:7.2}", contender.name);
        }
    }
}
