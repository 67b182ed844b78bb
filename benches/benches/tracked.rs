//! `cargo bench -p isophote-benches --bench tracked [-- DOCUMENT… --frames N]`: what a tracked frame of the shipped `spot` costs, next to one pass of
//! the {a, b, v} kernel of `thesis-spot` over the same pixels at the same width. Predictions are made to be wrong by 0.1 px
//! and by 1 px: the target jumps about a steady course. Frames and passes take turns; medians and 99th percentiles.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use std::sync::Arc;
use std::time::Instant;

use isophote_benches::accuracy::condition::{Condition, condition};
use isophote_benches::accuracy::document::frame;
use isophote_benches::accuracy::light::PROFILE;
use isophote_benches::accuracy::scene::{Beside, Scene};
use isophote_benches::accuracy::sensor::{FULL, GAIN, READ_E, Random};
use isophote_benches::text;
use isophote_jit::{
    Kernel, KernelCache, KernelOptions, PixelFormat, PlaneView, VectorWidth, Window, fastest_width, has_fma,
};
use isophote_symbolic::{Bindings, Lowering, Method, Model, Precision};
use isophote_tracker::{Camera, Compiled, Estimate, Frame, InTurn, TrackState, Tracker, TrackerOptions};

/// Frames; the first ones are not timed.
const FRAMES: usize = 600;
const SETTLING: usize = 40;
/// The domain of `spot`.
const REACH: f64 = 2.2;
const DOCUMENTS: [&str; 2] = ["spot", "spot-plane"];
/// px a frame
const VELOCITY: [f64; 2] = [0.02, 0.013];

/// One pass of thesis-spot over the pixels of the domain of `spot`.
struct Pass {
    kernel: Kernel,
    parameters: Vec<f64>,
}

impl Pass {
    fn new(width: VectorWidth) -> Pass {
        let model = Model::from_toml(&text("thesis-spot")).unwrap();
        let names = ["bx", "by", "a1", "a2", "a3", "v0", "v1"];
        let subset: Vec<_> = names.iter().map(|name| model.parameter(name).unwrap()).collect();
        let program = model.objective(&subset, Method::Newton).unwrap();
        let program = program.program(Lowering { fma: has_fma(), drop_saturated: false }).unwrap();
        let formats = vec![PixelFormat::U8];
        let options = KernelOptions { precision: Precision::F32, width, formats, packed: true };
        Pass { kernel: Kernel::compile(&program, &options).unwrap(), parameters: vec![0.0; model.parameters().len()] }
    }

    /// Microseconds and pixels.
    fn run(&mut self, scene: &Scene, bytes: &[u8]) -> (f64, u64) {
        let side = scene.condition.side_px;
        let [bx, by] = scene.centre;
        let [a1, a2, a3] = scene.shape.map(|entry| entry / REACH);
        self.parameters =
            vec![bx, by, a1, a2, a3, PROFILE[0], PROFILE[1], scene.condition.background, scene.brightness];
        let determinant = a1 * a3 - a2 * a2;
        let [wide, high] = [a3, a1].map(|entry| (entry / determinant).sqrt());
        let first = |at: f64, half: f64| (at - half).floor().max(0.0) as usize;
        let (x, y) = (first(bx, wide), first(by, high));
        let end = |at: f64, half: f64| ((at + half).ceil() as usize + 1).min(side);
        let window = Window { x, y, width: end(bx, wide) - x, height: end(by, high) - y, ..Window::whole(1, 1) };
        let plane = PlaneView::new(PixelFormat::U8, bytes, side, side, side, 1).unwrap();
        let bindings = Bindings { parameters: &self.parameters, entry: &self.parameters, ..Bindings::default() };
        let begin = Instant::now();
        let sums = self.kernel.sums(&bindings, &[plane], window).unwrap();
        (begin.elapsed().as_secs_f64() * 1e6, sums.pixels)
    }
}

fn tracker(document: &str, width: VectorWidth) -> Tracker {
    let cache = Arc::new(KernelCache::of_width(width));
    let model = Arc::new(Model::from_toml(&text(document)).unwrap());
    let compiled = Compiled::with_cache(model, Precision::F32, cache, &InTurn).unwrap();
    compiled.warm(PixelFormat::U8, &InTurn).unwrap();
    let camera = Camera {
        saturation: Some(FULL),
        electrons_per_dn: Some(1.0 / GAIN),
        read_noise_e: Some(READ_E),
        ..Camera::default()
    };
    let [k1, k2] = PROFILE;
    let start = [("k1", k1), ("k2", k2)].map(|(name, value)| (name.to_string(), value)).into();
    Tracker::new(Arc::new(compiled), TrackerOptions { start, camera, ..TrackerOptions::default() }).unwrap()
}

/// A frame that counts, to be found by profilers.
#[inline(never)]
fn settled(tracker: &mut Tracker, image: &Frame) -> Estimate {
    tracker.track(image)
}

fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share) as usize]
}

/// One line of the table.
fn line(document: &str, semi_axes_px: [f64; 2], jump_px: f64, width: VectorWidth, count: usize) -> String {
    let side_px = (2.0 * (1.6 * semi_axes_px[0] + 16.0 + count as f64 * VELOCITY[0])) as usize;
    let what = Condition { side_px, semi_axes_px, ..condition("S0") };
    let mut random = Random::of("tracked", 0);
    let mut scene = Scene::draw(what, &mut random);
    let begin = [0, 1].map(|axis| scene.centre[axis] - VELOCITY[axis] * count as f64 / 2.0);
    let (mut tracker, mut pass) = (tracker(document, width), Pass::new(width));
    let (mut frames, mut passes, mut ratios, mut steps, mut squares) = (vec![], vec![], vec![], vec![], vec![]);
    let (mut sampled, mut pixels) = (None, 0);
    for number in 0..count {
        let turn = random.uniform(0.0, std::f64::consts::TAU);
        let jump = [jump_px * turn.cos(), jump_px * turn.sin()];
        scene.centre = [0, 1].map(|axis| begin[axis] + VELOCITY[axis] * number as f64 + jump[axis]);
        let bytes = random.exposed(&scene.light(&scene.unknowns(Beside::Even)));
        let image = frame(bytes.clone(), side_px);
        let begin = Instant::now();
        let estimate = if number < SETTLING { tracker.track(&image) } else { settled(&mut tracker, &image) };
        let frame_us = begin.elapsed().as_secs_f64() * 1e6;
        // The first of three warms the caches.
        let mut of_pass: Vec<f64> = (0..3)
            .map(|_| pass.run(&scene, &bytes))
            .map(|(us, n)| {
                pixels = n;
                us
            })
            .collect();
        let pass_us = quantile(&mut of_pass, 0.5);
        if number < SETTLING || estimate.state != TrackState::Tracking {
            continue;
        }
        frames.push(frame_us);
        passes.push(pass_us);
        ratios.push(frame_us / pass_us);
        steps.push(estimate.stages.iter().map(|stage| f64::from(stage.passes)).sum());
        sampled = estimate.sampled;
        let error = [0, 1].map(|axis| estimate.parameters[axis] - scene.centre[axis]);
        squares.push(error[0] * error[0] + error[1] * error[1]);
    }
    let sampled = sampled.map_or("–".to_string(), |sampled| format!("{}, {}", sampled.points, sampled.slopes));
    let rmse = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    format!(
        "| {document} | {} × {} | {jump_px} | {} | {pixels} | {:.1} | {:.1} (p99 {:.1}) | **{:.1}** (p99 {:.1}) | {:.1} | {sampled} | {rmse:.4} | {} |",
        semi_axes_px[0],
        semi_axes_px[1],
        8 * width.bytes(),
        quantile(&mut passes, 0.5),
        quantile(&mut frames, 0.5),
        quantile(&mut frames, 0.99),
        quantile(&mut ratios, 0.5),
        quantile(&mut ratios, 0.99),
        quantile(&mut steps, 0.5),
        frames.len(),
    )
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let limit = arguments.iter().position(|argument| argument == "--frames");
    let count = limit.map_or(FRAMES, |at| arguments[at + 1].parse().unwrap());
    let is_wanted = |document: &&str| {
        DOCUMENTS.iter().all(|one| arguments.iter().all(|argument| argument != one))
            || arguments.iter().any(|argument| argument == document)
    };
    println!(
        "| document | semi-axes, px | jumps, px | bits | pixels | a pass, µs | a frame, µs | frame by pass | passes | points, slopes | RMSE, px | frames |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    let begin = Instant::now();
    let mut widths = vec![VectorWidth::Bits128, fastest_width(&|| begin.elapsed().as_nanos() as u64)];
    widths.dedup();
    for width in widths {
        for document in DOCUMENTS.into_iter().filter(is_wanted) {
            for semi_axes_px in [[60.0, 42.0], [18.0, 14.0]] {
                for jump_px in [0.1, 1.0] {
                    println!("{}", line(document, semi_axes_px, jump_px, width, count));
                }
            }
        }
    }
}
