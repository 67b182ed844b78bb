//! In which order a narrow window is summed: numbers of which f32 forgets the small ones tell.
#![allow(clippy::unwrap_used)]

use isophote_symbolic::interpreter::{self, Pixels, Window};
use isophote_symbolic::{Bindings, Lanes, Lowering, Method, Model, ParameterId, Precision, Program, Summation};

const TEXT: &str = r#"
name = "level"
coordinates = ["x", "y"]
channels = ["phi"]
[parameters]
v0 = { start = 0.0 }
[model]
intensity = "v0"
"#;

/// 2²⁴, to which an f32 cannot add 1.
const LARGE: f64 = 16_777_216.0;

/// 2²⁴, 1, 1, −2²⁴ in each row, then 0.
struct Picture;

impl Pixels for Picture {
    fn at(&self, _: usize, x: usize, _: usize) -> f64 {
        [LARGE, 1.0, 1.0, -LARGE].get(x).copied().unwrap_or(0.0)
    }
}

fn program() -> Program {
    let model = Model::from_toml(TEXT).unwrap();
    let lowering = Lowering { fma: false, drop_saturated: false };
    model.objective(&[ParameterId(0)], Method::GaussNewton).unwrap().program(lowering).unwrap()
}

/// What the rows' pixels are, added together: the derivative by the level, but for its sign and scale.
fn sum(order: Summation, [width, height]: [usize; 2]) -> f64 {
    let bindings = Bindings { parameters: &[0.0], entry: &[0.0], ..Bindings::default() };
    let program = program();
    let window = Window::whole(width, height);
    let outcome = interpreter::run(&program, Precision::F32, order, &bindings, &Picture, window, None);
    assert_eq!(outcome.pixels, (width * height) as u64);
    let exact = interpreter::run(&program, Precision::F64, Lanes::One, &bindings, &Picture, window, None);
    let at = exact.outputs.iter().position(|x| (x.abs() / (2 * height) as f64 - 1.0).abs() < 1.5 && *x != 0.0).unwrap();
    outcome.outputs[at] / exact.outputs[at] * (2 * height) as f64
}

#[test]
fn columns_of_a_narrow_window_belong_to_the_lanes_in_turn() {
    let narrow = |lanes| Summation { lanes: Lanes::Eight, rows: 8, narrow: Some(lanes) };
    // Each pixel in a lane of its own, one behind the other, those at even and at odd columns.
    assert_eq!(sum(Lanes::Eight.into(), [8, 8]), 16.0);
    assert_eq!(sum(narrow(Lanes::One), [8, 8]), 0.0);
    // 2²⁴ + 1, which is 2²⁴, and 1 − 2²⁴.
    assert_eq!(sum(narrow(Lanes::Two), [8, 8]), 8.0);
}

#[test]
fn a_window_is_narrow_up_to_so_many_columns_and_from_so_many_rows() {
    let order = Summation { lanes: Lanes::Eight, rows: 8, narrow: Some(Lanes::One) };
    let (columns, rows) = (Summation::NARROW_PX_MAX, Summation::NARROW_ROWS_MIN);
    assert_eq!(sum(order, [columns, rows]), 0.0);
    assert_eq!(sum(order, [columns - 1, rows + 1]), 0.0);
    assert_eq!(sum(order, [columns + 1, rows]), 2.0 * rows as f64);
    assert_eq!(sum(order, [columns, rows - 1]), 2.0 * (rows - 1) as f64);
    // Two lanes have twice as many columns.
    let order = Summation { narrow: Some(Lanes::Two), ..order };
    assert_eq!(sum(order, [2 * columns, rows]), rows as f64);
    assert_eq!(sum(order, [2 * columns + 1, rows]), 2.0 * rows as f64);
}
