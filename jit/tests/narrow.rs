//! Narrow windows, which loop across rows: sizes around the switch between loops, at every edge of the image, with masks, saturated
//! pixels, empty rows, several channels and slices. Machine code and interpreter agree.
#![allow(clippy::unwrap_used)]

mod common;

use common::{Image, Random, agree, document, lowerings, programs, shipped};
use isophote_jit::{PixelFormat, Slices, Window};
use isophote_symbolic::{Bindings, Lowering, Model, Precision, Summation};

const PX: usize = Summation::NARROW_PX_MAX;
const ROWS: usize = Summation::NARROW_ROWS_MIN;

/// An ellipse with bounds per row, and a row truth value that pixels read.
const OF_ROWS: &str = r#"
name = "rows"
coordinates = ["x", "y"]
channels = ["r", "g"]
[parameters]
bx = { start = 10.0 }
by = { start = 7.0 }
v1 = { start = 1.0 }
[model]
observed = "r - 0.5 * g"
intensity = "piecewise(y < by, v1 * (x - bx)^2, v1 + sin((x - bx) / 5))"
domain = "(x - bx)^2 / 4 + (y - by)^2 <= 40"
"#;

/// Slices of volumes, and a mask.
const STACKED: &str = r#"
name = "stacked"
coordinates = ["x", "y", "z", "t"]
channels = ["phi"]
[parameters]
bx = { start = 10.0 }
v1 = { start = 1.0 }
[model]
intensity = "v1 * exp(-((x - bx) / 9)^2) * (y + z + 2 * t)"
domain = "abs(x - bx) + sin(y + z) <= 11 or x < 3"
"#;

/// More sums than registers, a mask, and a function with a rare call.
const MANY: &str = r#"
name = "many"
coordinates = ["x", "y"]
channels = ["r", "g"]
[parameters]
bx = { start = 10.0 }
by = { start = 7.0 }
w = { start = 1.0 }
h = { start = 1.0 }
v0 = { start = 1.0 }
v1 = { start = 1.0 }
c1 = { start = 1.0 }
c2 = { start = 1.0 }
c3 = { start = 1.0 }
[model]
observed = "r - 0.5 * g"
intensity = "v0 + v1 / (1 + ((x - bx) / (9 + w))^2 + ((y - by) / (9 + h))^2) + max(c1 * x, c2 * y) + if(x < by, c3 * x * y, sin(c3 * x))"
domain = "abs(x - bx) + 4 * abs(sin(y - by)) <= 9 or x + 7 * y < 30"
"#;

fn values(model: &Model, [width, height]: [usize; 2]) -> Vec<f64> {
    let value = |name: &str| match name {
        "bx" => width as f64 / 2.0 + 0.3,
        "by" => height as f64 / 2.0 - 0.4,
        "a1" => 5.0 / (width * width) as f64,
        "a3" => 5.0 / (height * height) as f64,
        "a2" => 1e-3 / (width * height) as f64,
        "v0" => 20.0,
        "v1" => 150.0,
        _ => -0.4,
    };
    model.parameters().iter().map(|p| value(&p.name)).collect()
}

/// Runs all programs of a model over windows of an image; returns the number of used pixels.
fn run(model: &Model, format: PixelFormat, size: [usize; 4], windows: &[Window], lowering: Lowering) -> u64 {
    let mut random = Random((size[0] * size[1]) as u64);
    let pixel = |_: usize, _: [usize; 4]| if random.below(9) == 0 { 250.0 } else { random.between(0.0, 249.0) };
    let image = Image::stack(format, size, model.channels().len(), [0, 3, 5, 0], pixel);
    let values = values(model, [size[0], size[1]]);
    let bindings = Bindings { parameters: &values, entry: &values, saturation: &[250.0, 250.0], ..Bindings::default() };
    let mut pixels = 0;
    for (name, program) in programs(model, lowering).into_iter().skip(1) {
        for window in windows {
            pixels += agree(&program, Precision::F32, &bindings, &image, *window, &name).pixels;
        }
    }
    pixels
}

#[test]
fn sizes_around_the_switch_of_loops_agree() {
    let model = shipped("thesis-spot");
    let sizes = [1, 2, 7, 8, 9, 15, 16, 17, 24, 31, PX - 1, PX, PX + 1, 2 * PX - 1, 2 * PX, 2 * PX + 1];
    for (i, lowering) in lowerings().into_iter().enumerate() {
        for (j, width) in sizes.into_iter().enumerate() {
            for height in [ROWS - 1, ROWS, ROWS + 1, 4 * ROWS, 4 * ROWS + 1] {
                let format = PixelFormat::ALL[(i + j) % PixelFormat::ALL.len()];
                let windows = [Window::whole(width, height)];
                let pixels = run(&model, format, [width, height, 1, 1], &windows, lowering);
                assert!(pixels > 0 || width < 7, "{width} × {height}");
            }
        }
    }
}

#[test]
fn many_sums_agree_at_every_width() {
    let model = document(MANY);
    for (i, lowering) in lowerings().into_iter().enumerate() {
        for (j, width) in [1, 2, 3, 4, 5, 6, 7, 8, 15, 16, 17, 18, 23, 2 * PX - 3, 2 * PX].into_iter().enumerate() {
            let format = PixelFormat::ALL[(i + j) % PixelFormat::ALL.len()];
            let windows =
                [Window::whole(width, ROWS + 3), Window { x: width / 3, ..Window::whole(width - width / 3, ROWS) }];
            assert!(run(&model, format, [width, ROWS + 3, 1, 1], &windows, lowering) > 0, "{width}");
        }
    }
}

#[test]
fn windows_at_every_edge_agree() {
    for model in [document(OF_ROWS), shipped("thesis-spot"), shipped("gaussian")] {
        let at = |x, y, width, height| Window { x, y, width, height, slices: Slices::ONE };
        let windows = [
            at(0, 0, 19, 11),
            at(21, 0, 19, 13),
            at(0, 12, 23, 18),
            at(17, 12, 23, 18),
            at(9, 3, 22, 24),
            at(19, 2, 1, 20),
        ];
        for lowering in lowerings() {
            for format in [PixelFormat::U8, PixelFormat::F32] {
                assert!(run(&model, format, [40, 30, 1, 1], &windows, lowering) > 0);
            }
        }
    }
}

#[test]
fn rows_of_several_slices_agree() {
    let model = document(STACKED);
    let window = |first, count| Window { x: 2, y: 1, width: 21, height: 3, slices: Slices { first, count } };
    let windows = [window([0, 0], [3, 2]), window([1, 1], [2, 1]), window([0, 0], [3, 1]), window([2, 0], [1, 2])];
    for lowering in lowerings() {
        assert!(run(&model, PixelFormat::U16, [25, 5, 3, 2], &windows, lowering) > 0);
    }
}
