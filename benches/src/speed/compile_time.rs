//! Time from a document's text to its kernels: for several documents, and in detail for the thesis' spot, all three
//! stages, warm and in a fresh process.

use std::hint::black_box;
use std::process::Command;
use std::sync::Arc;
use std::time::Instant;

use isophote_jit::{Kernel, KernelCache, KernelOptions, PixelFormat, VectorWidth, fastest_width, has_fma};
use isophote_machine::Threads;
use isophote_symbolic::{Lowering, Model, Precision};
use isophote_tracker::{Compiled, InTurn, Workers};

use crate::text;

/// The argument that makes the benchmark print [`cold_here`] and exit.
pub const COLD: &str = "first-call-ever";
/// Warm runs.
pub const RUNS: usize = 200;
/// Fresh processes.
pub const PROCESSES: usize = 20;

/// Documents compiled from text to all kernels, and goals in milliseconds on two threads.
const DOCUMENTS: [(&str, f64); 3] = [("thesis-spot", 8.0), ("spot", 15.0), ("three-spots-pose", 60.0)];
/// Rounds; in each, every document is compiled once per width on two threads, and once on one.
const ROUNDS: usize = 60;

/// A document at a vector width.
#[derive(Clone, Copy, Debug)]
pub struct Text {
    /// A shipped document.
    pub document: &'static str,
    /// Vector width of its kernels.
    pub width: VectorWidth,
    /// Two threads, as in the service.
    pub two: CompileTime,
    /// One thread.
    pub one: CompileTime,
    /// Goal on two threads, median, milliseconds.
    pub asked_ms: f64,
}

/// Milliseconds.
#[derive(Clone, Copy, Debug)]
pub struct CompileTime {
    /// Median.
    pub median_ms: f64,
    /// 99th percentile.
    pub p99_ms: f64,
}

impl CompileTime {
    fn of(mut all: Vec<f64>) -> CompileTime {
        all.sort_by(f64::total_cmp);
        CompileTime { median_ms: all[all.len() / 2], p99_ms: all[all.len() * 99 / 100] }
    }
}

fn all(document: &str, width: VectorWidth, workers: &dyn Workers) {
    let model = Arc::new(Model::from_toml(document).unwrap());
    let cache = Arc::new(KernelCache::of_width(width));
    let compiled = Compiled::with_cache(model, Precision::F32, cache, workers).unwrap();
    compiled.warm(PixelFormat::U8, workers).unwrap();
    black_box(compiled);
}

fn milliseconds(f: impl FnOnce()) -> f64 {
    let start = Instant::now();
    f();
    start.elapsed().as_secs_f64() * 1e3
}

/// Text to all kernels for the first time in this process, ms.
pub fn cold_here() -> f64 {
    let document = text("thesis-spot");
    milliseconds(|| all(&document, VectorWidth::Bits128, &Threads))
}

/// The same, each time in a fresh process.
pub fn cold() -> CompileTime {
    let program = std::env::current_exe().unwrap();
    let once = |_| -> f64 {
        let run = Command::new(&program).arg(COLD).output().unwrap();
        String::from_utf8(run.stdout).unwrap().trim().parse().unwrap()
    };
    CompileTime::of((0..PROCESSES).map(once).collect())
}

/// Text to all kernels, warm, of each document at 128 bits and at the fastest width here.
pub fn texts() -> Vec<Text> {
    let begin = Instant::now();
    let mut widths = vec![VectorWidth::Bits128, fastest_width(&|| begin.elapsed().as_nanos() as u64)];
    widths.dedup();
    let cases: Vec<_> = DOCUMENTS.iter().flat_map(|one| widths.iter().map(move |width| (one, *width))).collect();
    let documents: Vec<String> = cases.iter().map(|((name, _), _)| text(name)).collect();
    let mut took: Vec<[Vec<f64>; 2]> = vec![Default::default(); cases.len()];
    for round in 0..=ROUNDS {
        for ((document, (_, width)), [two, one]) in documents.iter().zip(&cases).zip(&mut took) {
            let now =
                [&Threads as &dyn Workers, &InTurn].map(|workers| milliseconds(|| all(document, *width, workers)));
            // The first round warms the process.
            if round > 0 {
                two.push(now[0]);
                one.push(now[1]);
            }
        }
    }
    let line = |((&(document, asked_ms), width), [two, one]): (_, [Vec<f64>; 2])| Text {
        document,
        width,
        two: CompileTime::of(two),
        one: CompileTime::of(one),
        asked_ms,
    };
    cases.into_iter().zip(took).map(line).collect()
}

/// Warm times of the thesis' spot, by step.
pub fn warm() -> Vec<(&'static str, CompileTime)> {
    let document = text("thesis-spot");
    let model = Arc::new(Model::from_toml(&document).unwrap());
    let options = KernelOptions {
        width: VectorWidth::Bits128,
        precision: Precision::F32,
        formats: vec![PixelFormat::U8],
        packed: true,
    };
    let plain = || {
        let model = Model::from_toml(&document).unwrap();
        for stage in model.stages() {
            let lowering = Lowering { fma: has_fma(), drop_saturated: false };
            let program = model.objective(&stage.parameters, stage.method).unwrap().program(lowering).unwrap();
            black_box(Kernel::compile(&program, &options).unwrap());
        }
    };
    let narrow = VectorWidth::Bits128;
    let mut rows: [Vec<f64>; 6] = Default::default();
    all(&document, narrow, &Threads);
    for _ in 0..RUNS {
        rows[0].push(milliseconds(|| all(&document, narrow, &Threads)));
        rows[1].push(milliseconds(|| all(&document, narrow, &InTurn)));
        rows[2].push(milliseconds(|| drop(black_box(Model::from_toml(&document).unwrap()))));
        let mut compiled = None;
        rows[3].push(milliseconds(|| compiled = Some(Compiled::new(model.clone(), Precision::F32).unwrap())));
        rows[4].push(milliseconds(|| compiled.unwrap().warm(PixelFormat::U8, &InTurn).unwrap()));
        rows[5].push(milliseconds(plain));
    }
    let names = [
        "model text to all kernels, with and without saturation, as the service does it: on two threads",
        "the same on one thread",
        "of which reading the text",
        "of which deriving, checking and lowering all programs",
        "of which compiling all kernels",
        "model text to the three stages' kernels, without saturation alone",
    ];
    names.into_iter().zip(rows.map(CompileTime::of)).collect()
}
