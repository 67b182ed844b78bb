//! `cargo bench -p isophote-benches --bench first_light`: cost of a pass per pixel, time from a document to running kernels,
//! and time of one tracked frame. Medians with minimum and maximum; wall time of one thread.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use isophote_benches::{text, time};
use isophote_jit::{Kernel, KernelOptions, PixelFormat, PlaneView, Window, has_fma};
use isophote_symbolic::{Bindings, Lowering, Method, Model, Precision};
use isophote_tracker::{Compiled, Frame, InTurn, Plane, Tracker, TrackerOptions};

const WIDTH: usize = 640;
const HEIGHT: usize = 480;

/// The spot of the figures: s ≤ 1 covers half of the frame.
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

fn picture(model: &Model, parameters: &[f64]) -> Vec<f32> {
    let program = model.rendering(Lowering { fma: has_fma(), drop_saturated: false }).unwrap();
    let options = KernelOptions { precision: Precision::F32, formats: vec![PixelFormat::F32], packed: true };
    let mut plane = vec![0.0; WIDTH * HEIGHT];
    let bindings = Bindings { parameters, entry: parameters, ..Bindings::default() };
    Kernel::compile(&program, &options).unwrap().render(&bindings, Window::whole(WIDTH, HEIGHT), &mut plane).unwrap();
    plane
}

fn passes() {
    let model = Model::from_toml(&text("thesis-spot")).unwrap();
    let parameters = values(&model);
    let pixels = picture(&model, &parameters);
    let f32_bytes: Vec<u8> = pixels.iter().flat_map(|p| p.to_le_bytes()).collect();
    let u8_bytes: Vec<u8> = pixels.iter().map(|p| p.round() as u8).collect();
    println!("thesis-spot, {WIDTH}x{HEIGHT}, one pass; ns per pixel of the domain: median (min to max)");
    for subset in ["bx,by", "a1,a2,a3", "bx,by,a1,a2,a3", "bx,by,a1,a2,a3,v0,v1", "bx,by,a1,a2,a3,v0,v1,k1,k2"] {
        let ids: Vec<_> = subset.split(',').map(|n| model.parameter(n).unwrap()).collect();
        let objective = model.objective(&ids, Method::Newton).unwrap();
        for drop_saturated in [false, true] {
            let lowering = Lowering { fma: has_fma(), drop_saturated };
            let program = objective.program(lowering).unwrap();
            let cost = objective.cost(lowering).unwrap();
            for (format, bytes, precision) in [
                (PixelFormat::F32, &f32_bytes, Precision::F32),
                (PixelFormat::U8, &u8_bytes, Precision::F32),
                (PixelFormat::U8, &u8_bytes, Precision::F64),
            ] {
                let options = KernelOptions { precision, formats: vec![format], packed: true };
                let kernel = Kernel::compile(&program, &options).unwrap();
                let size = format.bytes_per_pixel();
                let plane = PlaneView::new(format, bytes, WIDTH, HEIGHT, WIDTH * size, size).unwrap();
                let bindings = Bindings {
                    parameters: &parameters,
                    entry: &parameters,
                    saturation: &[255.0],
                    ..Bindings::default()
                };
                let window = Window::whole(WIDTH, HEIGHT);
                let count = kernel.sums(&bindings, &[plane], window).unwrap().pixels as f64;
                let [median, min, max] =
                    time(60, || drop(black_box(kernel.sums(&bindings, &[plane], window).unwrap())))
                        .map(|us| us * 1e3 / count);
                println!(
                    "{subset:27} {format:?} in {precision:?}{:12} {median:6.2} ({min:.2} to {max:.2})  {} flops, {} sums, {count} px",
                    if drop_saturated { ", saturation" } else { "" },
                    cost.flops_per_pixel,
                    cost.accumulators
                );
            }
        }
    }
}

fn compile() {
    println!(
        "\ndocument to running kernels (all stages, both saturation variants, u8), ms: first, then median (min to max)"
    );
    for name in ["thesis-spot", "spot", "rational-spot", "gaussian", "dark-disc"] {
        let text = text(name);
        let build = || {
            let compiled = Compiled::new(Arc::new(Model::from_toml(&text).unwrap()), Precision::F32).unwrap();
            compiled.warm(PixelFormat::U8, &InTurn).unwrap();
        };
        let start = Instant::now();
        build();
        let first = start.elapsed().as_secs_f64() * 1e3;
        let [median, min, max] = time(20, build).map(|us| us / 1e3);
        println!("{name:14} {first:6.1}, {median:6.1} ({min:.1} to {max:.1})");
    }
}

fn frames() {
    println!("\none tracked frame, 640x480 u8, semi-axes 60x42 px, warm start, us: median (min to max)");
    let model = Model::from_toml(&text("spot")).unwrap();
    let mut parameters = values(&model);
    for (name, value) in [("a1", 1.0 / 3600.0), ("a3", 1.0 / 1764.0)] {
        parameters[model.parameter(name).unwrap().index()] = value;
    }
    let bytes: Vec<u8> = picture(&model, &parameters)
        .iter()
        .enumerate()
        .map(|(i, p)| (p + ((i * 7919) % 5) as f32 - 2.0).round() as u8)
        .collect();
    let frame = Frame::new(&[WIDTH, HEIGHT], vec![Plane::owned(PixelFormat::U8, bytes, WIDTH)]).unwrap();
    let compiled = Arc::new(Compiled::new(Arc::new(model), Precision::F32).unwrap());
    let mut tracker = Tracker::new(compiled, TrackerOptions::default()).unwrap();
    let [median, min, max] = time(200, || drop(black_box(tracker.track(&frame))));
    println!("spot {median:.0} ({min:.0} to {max:.0})");
}

fn main() {
    passes();
    compile();
    frames();
}
