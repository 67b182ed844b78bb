//! What a pixel of thesis-spot costs with vectors of each width that this machine has:
//! `cargo run -p isophote-jit --example widths`; the code of a kernel is the same in every build. Widths take turns; medians of 61
//! turns (least – most).
#![allow(clippy::print_stdout, clippy::unwrap_used, missing_docs)]

#[path = "../tests/common/mod.rs"]
mod common;

use std::time::Instant;

use common::{shipped, widths};
use isophote_jit::{Kernel, KernelOptions, PixelFormat, PlaneView, Slices, VectorWidth, Window, has_fma};
use isophote_symbolic::{Bindings, Lowering, Method, Model, Precision};

const SIZE: [usize; 2] = [640, 480];
const SUBSETS: [(&str, &str); 4] =
    [("{b}", "bx,by"), ("{a}", "a1,a2,a3"), ("{a, b}", "bx,by,a1,a2,a3"), ("{a, b, v}", "bx,by,a1,a2,a3,v0,v1")];
const TURNS: usize = 61;
/// Pixels between two looks at the clock, at least.
const PIXELS_MIN: usize = 400_000;

/// Where the domain covers half of the picture.
fn truth(name: &str) -> f64 {
    match name {
        "bx" => 320.3,
        "by" => 240.7,
        "a1" => 1.0 / (250.0 * 250.0),
        "a2" => 1e-6,
        "a3" => 1.0 / (196.0 * 196.0),
        "v0" => 20.0,
        "v1" => 150.0,
        "k1" => -0.5,
        _ => -0.3,
    }
}

fn kernel(model: &Model, subset: &str, width: VectorWidth) -> (Kernel, f64) {
    let ids: Vec<_> = subset.split(',').map(|name| model.parameter(name).unwrap()).collect();
    let lowering = Lowering { fma: has_fma(), drop_saturated: false };
    let program = model.objective(&ids, Method::Newton).unwrap().program(lowering).unwrap();
    let options = KernelOptions { precision: Precision::F32, width, formats: vec![PixelFormat::U8], packed: true };
    let compiled_ms = |_| {
        let start = Instant::now();
        drop(Kernel::compile(&program, &options).unwrap());
        start.elapsed().as_secs_f64() * 1e3
    };
    let mut times: Vec<f64> = (0..9).map(compiled_ms).collect();
    times.sort_by(f64::total_cmp);
    (Kernel::compile(&program, &options).unwrap(), times[4])
}

fn main() {
    let model = shipped("thesis-spot");
    let values: Vec<f64> = model.parameters().iter().map(|p| truth(&p.name)).collect();
    let bindings = Bindings { parameters: &values, entry: &values, ..Bindings::default() };
    let pixels: Vec<u8> = (0..SIZE[0] * SIZE[1]).map(|i| (i * 7919 % 251) as u8).collect();
    let plane = PlaneView::new(PixelFormat::U8, &pixels, SIZE[0], SIZE[1], SIZE[0], 1).unwrap();
    println!("| kernel | window, px | bits | ns a pixel | times 128 bits | bytes of code | compiled in, ms |");
    println!("|---|---|---|---|---|---|---|");
    for (name, subset) in SUBSETS {
        let kernels: Vec<_> = widths().into_iter().map(|width| (width, kernel(&model, subset, width))).collect();
        for [width, height] in [SIZE, [96, 96], [24, 24]] {
            let (x, y) = ((SIZE[0] - width) / 2, (SIZE[1] - height) / 2);
            let window = Window { x, y, width, height, slices: Slices::ONE };
            let passes = PIXELS_MIN.div_ceil(window.pixels());
            let mut times = vec![Vec::new(); kernels.len()];
            for _ in 0..TURNS {
                for ((_, (kernel, _)), times) in kernels.iter().zip(&mut times) {
                    let start = Instant::now();
                    let mut counted = 0;
                    for _ in 0..passes {
                        counted += kernel.sums(&bindings, &[plane], window).unwrap().pixels;
                    }
                    times.push(start.elapsed().as_secs_f64() * 1e9 / counted as f64);
                }
            }
            times.iter_mut().for_each(|times| times.sort_by(f64::total_cmp));
            for ((bits, (kernel, compiled_ms)), of) in kernels.iter().zip(&times) {
                let [least, median, most] = [of[0], of[TURNS / 2], of[TURNS - 1]];
                println!(
                    "| {name} | {width} × {height} | {} | {median:.3} ({least:.3} – {most:.3}) | {:.2} | {} | {compiled_ms:.2} |",
                    8 * bits.bytes(),
                    median / times[0][TURNS / 2],
                    kernel.code_bytes(),
                );
            }
        }
    }
}
