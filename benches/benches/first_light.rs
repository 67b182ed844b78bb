//! `cargo bench -p isophote-benches --bench first_light [-- FILTER]`: times with statistics and changes since the last
//! run: a pass per pixel, a document to running kernels, a tracked frame.
#![allow(missing_docs, clippy::unwrap_used)]

use std::sync::Arc;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use isophote_benches::speed::frame::{HEIGHT, WIDTH, bytes, picture, truth};
use isophote_benches::text;
use isophote_jit::{Kernel, KernelOptions, PixelFormat, PlaneView, VectorWidth, Window, has_fma};
use isophote_machine::Threads;
use isophote_symbolic::{Bindings, Estimator, Lowering, Method, Model, Precision, Start};
use isophote_tracker::{Compiled, Frame, Plane, Tracker, TrackerOptions};

const SIZE: [usize; 2] = [WIDTH, HEIGHT];
const SUBSETS: [&str; 5] =
    ["bx,by", "a1,a2,a3", "bx,by,a1,a2,a3", "bx,by,a1,a2,a3,v0,v1", "bx,by,a1,a2,a3,v0,v1,k1,k2"];

/// One pass of thesis-spot; the throughput counts pixels of the domain.
fn passes(criterion: &mut Criterion) {
    let model = Model::from_toml(&text("thesis-spot")).unwrap();
    let parameters = truth(&model);
    let pixels = picture(&model, &parameters, SIZE);
    let single = bytes(&pixels);
    let byte: Vec<u8> = pixels.iter().map(|p| p.round() as u8).collect();
    let mut group = criterion.benchmark_group("pass");
    for subset in SUBSETS {
        let ids: Vec<_> = subset.split(',').map(|n| model.parameter(n).unwrap()).collect();
        let objective = model.objective(&ids, Method::Newton).unwrap();
        for drop_saturated in [false, true] {
            let program = objective.program(Lowering { fma: has_fma(), drop_saturated }).unwrap();
            for (format, bytes, precision) in [
                (PixelFormat::F32, &single, Precision::F32),
                (PixelFormat::U8, &byte, Precision::F32),
                (PixelFormat::U8, &byte, Precision::F64),
            ] {
                let kernel = Kernel::compile(
                    &program,
                    &KernelOptions { width: VectorWidth::Bits128, precision, formats: vec![format], packed: true },
                )
                .unwrap();
                let size = format.bytes_per_pixel();
                let plane = PlaneView::new(format, bytes, WIDTH, HEIGHT, WIDTH * size, size).unwrap();
                let bindings = Bindings {
                    parameters: &parameters,
                    entry: &parameters,
                    saturation: &[255.0],
                    ..Bindings::default()
                };
                let window = Window::whole(WIDTH, HEIGHT);
                let pass = || kernel.sums(&bindings, &[plane], window).unwrap();
                group.throughput(Throughput::Elements(pass().pixels));
                let control = if drop_saturated { ", saturation" } else { "" };
                group.bench_function(format!("{subset} {format:?} in {precision:?}{control}"), |b| b.iter(pass));
            }
        }
    }
}

/// One pass of each stage of models with elementary functions, u8 in f32 lanes, at their starting values, centred.
fn functions(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("functions");
    let bytes: Vec<u8> = (0..WIDTH * HEIGHT).map(|i| (i * 31 % 200) as u8).collect();
    let plane = PlaneView::new(PixelFormat::U8, &bytes, WIDTH, HEIGHT, WIDTH, 1).unwrap();
    for name in ["gaussian", "gaussian-pixel", "moffat", "dark-disc"] {
        let model = Model::from_toml(&text(name)).unwrap();
        let parameters: Vec<f64> = model
            .parameters()
            .iter()
            .zip(truth(&model))
            .map(|(p, truth)| match p.start {
                Start::Number(number) => number,
                Start::Estimator(Estimator::Size(_)) => 120.0,
                _ => truth,
            })
            .collect();
        for (number, stage) in model.stages().iter().enumerate() {
            let objective = model.objective(&stage.parameters, Method::GaussNewton).unwrap();
            let program = objective.program(Lowering { fma: has_fma(), drop_saturated: false }).unwrap();
            let options = KernelOptions {
                width: VectorWidth::Bits128,
                precision: Precision::F32,
                formats: vec![PixelFormat::U8],
                packed: true,
            };
            let kernel = Kernel::compile(&program, &options).unwrap();
            let bindings = Bindings { parameters: &parameters, entry: &parameters, ..Bindings::default() };
            let pass = || kernel.sums(&bindings, &[plane], Window::whole(WIDTH, HEIGHT)).unwrap();
            group.throughput(Throughput::Elements(pass().pixels));
            group.bench_function(format!("{name}, stage {}", number + 1), |b| b.iter(pass));
        }
    }
}

/// A document to the running kernels of all its stages, with and without saturation control, for u8.
fn compile(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("compile");
    for name in ["thesis-spot", "spot", "rational-spot", "gaussian", "dark-disc"] {
        let text = text(name);
        group.bench_function(name, |b| {
            b.iter(|| {
                let model = Arc::new(Model::from_toml(&text).unwrap());
                let compiled = Compiled::with_cache(model, Precision::F32, Arc::default(), &Threads).unwrap();
                compiled.warm(PixelFormat::U8, &Threads).unwrap();
                compiled
            });
        });
    }
}

/// One frame of 640 × 480 u8 with a spot of 60 × 42 px, tracked from the last one.
fn frames(criterion: &mut Criterion) {
    let model = Model::from_toml(&text("spot")).unwrap();
    let mut parameters = truth(&model);
    for (name, semi_axis) in [("a1", 60.0_f64), ("a3", 42.0)] {
        parameters[model.parameter(name).unwrap().index()] = semi_axis.powi(-2);
    }
    let noisy = |(i, p): (usize, &f32)| (p + ((i * 7919) % 5) as f32 - 2.0).round() as u8;
    let bytes: Vec<u8> = picture(&model, &parameters, SIZE).iter().enumerate().map(noisy).collect();
    let frame = Frame::new(&SIZE, vec![Plane::owned(PixelFormat::U8, bytes, WIDTH)]).unwrap();
    let compiled = Arc::new(Compiled::new(Arc::new(model), Precision::F32).unwrap());
    let mut tracker = Tracker::new(compiled, TrackerOptions::default()).unwrap();
    criterion.bench_function("frame/spot", |b| b.iter(|| tracker.track(&frame)));
}

criterion_group!(first_light, passes, functions, compile, frames);
criterion_main!(first_light);
