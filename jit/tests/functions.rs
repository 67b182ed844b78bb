//! Elementary functions equal the interpreter bit for bit: every function over special values and random bit patterns, in
//! f32 and f64, fused and not, inlined and called.
#![allow(clippy::unwrap_used)]

mod common;

use common::{Image, Random, agree_with, document, widths};
use isophote_jit::{Kernel, KernelOptions, PixelFormat, Slices, VectorWidth, Window, explain, has_fma};
use isophote_symbolic::{
    Bindings, Function1, Function2, Lowering, Method, Model, ParameterId, Precision, Program, ValueKind,
};

/// Enough tangents that no function of the loop is inlined.
const MANY: &str = "v1 * sum(tan((x + i) / 50), i, 1, 40)";

/// The pixel's function value is an output: dF/dv0 of one pixel at v0 = v1 = 0 is its negative.
fn model(formula: &str, many: bool) -> Model {
    let rest = if many { MANY } else { "v1 * x" };
    document(&format!(
        r#"
        name = "one-function"
        coordinates = ["x", "y"]
        channels = ["r", "g"]
        [parameters]
        v0 = {{ start = 0.0 }}
        v1 = {{ start = 0.0 }}
        [model]
        observed = "{formula}"
        intensity = "v0 + {rest}"
        "#
    ))
}

fn formulas() -> Vec<String> {
    let one = Function1::ALL.iter().map(|f| format!("{}(r)", f.name()));
    let two = Function2::ALL.iter().map(|f| match f {
        Function2::Atan2 => "atan2(r, g)".to_owned(),
        Function2::Pow => "r^g".to_owned(),
    });
    one.chain(two).collect()
}

fn program(model: &Model, fma: bool) -> Program {
    let all = [ParameterId(0), ParameterId(1)];
    let objective = model.objective(&all, Method::GaussNewton).unwrap();
    objective.program(Lowering { fma, drop_saturated: false }).unwrap()
}

/// Numbers at which functions switch their algorithm.
const SPECIAL: [f64; 40] = [
    0.0,
    1.0,
    0.5,
    2.0,
    3.0,
    0.75,
    2.5,
    6.0,
    1e-8,
    1e-20,
    1e-45,
    1e-40,
    1e-310,
    5e-324,
    709.7,
    709.8,
    710.5,
    745.0,
    746.0,
    88.7,
    88.8,
    103.9,
    104.1,
    std::f64::consts::FRAC_PI_4,
    std::f64::consts::FRAC_PI_2,
    std::f64::consts::PI,
    1048575.5,
    1048576.5,
    2e6,
    1e10,
    1e22,
    3e38,
    1e300,
    4503599627370497.0,
    9007199254740993.0,
    std::f64::consts::FRAC_1_SQRT_2,
    std::f64::consts::SQRT_2,
    f64::MAX,
    f64::INFINITY,
    f64::NAN,
];

fn argument(random: &mut Random, precision: Precision) -> f64 {
    let size = match random.below(4) {
        0 => *random.pick(&SPECIAL),
        1 => random.between(-40.0, 40.0),
        2 => random.between(-1.1, 1.1),
        _ if precision == Precision::F32 => f64::from(f32::from_bits(random.next() as u32)),
        _ => f64::from_bits(random.next()),
    };
    if random.below(2) == 0 { size } else { -size }
}

const ROWS: usize = 1500;

/// Each row has two distinct pixels: groups with equal lanes, so that their sum is exact, and a last group of one.
fn compare(formula: &str, fma: bool, precision: Precision, many: bool, seed: u64) {
    widths().into_iter().for_each(|width| compare_at(width, formula, fma, precision, many, seed));
}

fn compare_at(width: VectorWidth, formula: &str, fma: bool, precision: Precision, many: bool, seed: u64) {
    let program = program(&model(formula, many), fma);
    compare_program(&program, width, precision, seed, &format!("{formula}, fused {fma}, many {many}, seed {seed}"));
}

fn compare_program(program: &Program, width: VectorWidth, precision: Precision, seed: u64, context: &str) {
    let formats = vec![PixelFormat::F64; 2];
    let kernel = Kernel::compile(program, &KernelOptions { width, precision, formats, packed: true }).unwrap();
    let mut random = Random(seed);
    let lanes = width.lanes(precision).count();
    let mut numbers = vec![[[0.0; 2]; 2]; ROWS];
    numbers.iter_mut().flatten().flatten().for_each(|number| *number = argument(&mut random, precision));
    // Pairs special values.
    for (i, row) in numbers.iter_mut().enumerate().take(SPECIAL.len()) {
        let pair = [SPECIAL[i], SPECIAL[(7 * i + seed as usize) % SPECIAL.len()]];
        *row = [pair, pair.map(|x| -x)];
    }
    let value = |channel: usize, x: usize, y: usize| numbers[y][x / lanes][channel];
    let image = Image::new(PixelFormat::F64, [lanes + 1, ROWS], 2, [0, 0], value);
    let bindings = Bindings { parameters: &[0.0, 0.0], entry: &[0.0, 0.0], ..Bindings::default() };
    for (y, row) in numbers.iter().enumerate() {
        for (x, width) in [(0, lanes), (lanes, 1)] {
            let window = Window { x, y, width, height: 1, slices: Slices::ONE };
            agree_with(&kernel, &bindings, &image, window, &format!("{context}: {:?}", row[x / lanes]));
        }
    }
}

#[test]
fn inlined_functions_equal_the_interpreter() {
    for (seed, formula) in formulas().iter().enumerate() {
        for precision in [Precision::F32, Precision::F64] {
            for fma in [false, true].into_iter().filter(|fma| !fma || has_fma()) {
                compare(formula, fma, precision, false, seed as u64);
            }
        }
    }
}

#[test]
fn called_functions_equal_the_interpreter() {
    for (seed, formula) in formulas().iter().enumerate() {
        for precision in [Precision::F32, Precision::F64] {
            for fma in [false, true].into_iter().filter(|fma| !fma || has_fma()) {
                compare(formula, fma, precision, true, seed as u64);
            }
        }
    }
}

/// F with ln σ², and χ², with a variance per pixel.
#[test]
fn logarithm_of_the_variance_equals_the_interpreter() {
    let model = document(
        r#"
        name = "variance"
        coordinates = ["x", "y"]
        channels = ["r", "g"]
        [parameters]
        v0 = { start = 0.0 }
        v1 = { start = 0.0 }
        [model]
        observed = "g"
        intensity = "v0 + v1 * x"
        noise = "r"
        "#,
    );
    let report = model.value_objective(ValueKind::Full).unwrap();
    for fma in [false, true].into_iter().filter(|fma| !fma || has_fma()) {
        let program = report.program(Lowering { fma, drop_saturated: false }).unwrap();
        for precision in [Precision::F32, Precision::F64] {
            widths()
                .into_iter()
                .for_each(|width| compare_program(&program, width, precision, 3, &format!("fused {fma}")));
        }
    }
}

fn calls(formula: &str, precision: Precision, many: bool) -> usize {
    let program = program(&model(formula, many), false);
    let options =
        KernelOptions { width: VectorWidth::Bits128, precision, formats: vec![PixelFormat::F64; 2], packed: true };
    explain(&program, &options).unwrap().clif.iter().filter(|line| line.text.contains("call_indirect")).count()
}

#[test]
fn few_functions_are_inlined_and_many_are_called() {
    for precision in [Precision::F32, Precision::F64] {
        for formula in ["exp(r)", "log(r)", "atan2(r, g)", "erf(r)", "r^g", "asin(r) + tanh(r)"] {
            assert_eq!(calls(formula, precision, false), 0, "{formula}");
            // In the loop and in the row's last group.
            assert!(calls(formula, precision, true) >= 2 * 41, "{formula}");
        }
        // Two halves of f32 in two groups: calls for large arguments.
        assert_eq!(calls("sin(r)", precision, false), VectorWidth::Bits128.lanes(precision).count(), "{precision:?}");
    }
}

/// A function of the row and a parameter, with its derivatives.
fn of_rows(formula: &str) -> Model {
    document(&format!(
        r#"
        name = "function-of-rows"
        coordinates = ["x", "y"]
        channels = ["r"]
        [parameters]
        v0 = {{ start = 0.5 }}
        v1 = {{ start = 0.0 }}
        [model]
        intensity = "v1 + x * {formula}"
        "#
    ))
}

#[test]
fn row_functions_equal_the_interpreter_and_are_inlined_at_wide_vectors() {
    let one = Function1::ALL.iter().map(|f| format!("{}(v0 * (y - 9))", f.name()));
    let two = ["atan2(y - 9, v0)", "(1 + y)^v0"].map(str::to_owned);
    for formula in one.chain(two) {
        let program = program(&of_rows(&formula), has_fma());
        let image = Image::new(PixelFormat::F32, [9, 19], 1, [0, 0], |_, x, y| (x * y) as f64 / 7.0);
        for (width, precision) in
            widths().into_iter().flat_map(|width| [Precision::F32, Precision::F64].map(|precision| (width, precision)))
        {
            let options = KernelOptions { width, precision, formats: vec![PixelFormat::F32], packed: true };
            let kernel = Kernel::compile(&program, &options).unwrap();
            for v0 in [0.05, -0.3, 1.7, 1e6, f64::NAN] {
                let bindings = Bindings { parameters: &[v0, 0.25], entry: &[v0, 0.25], ..Bindings::default() };
                agree_with(&kernel, &bindings, &image, Window::whole(9, 19), &format!("{formula}, v0 = {v0}"));
            }
            if width != VectorWidth::Bits128 && formula.starts_with("er") {
                let machine = explain(&program, &options).unwrap().machine;
                assert!(!machine.iter().any(|line| line.text.contains("call")), "{formula}, {width:?}");
            }
        }
    }
}
