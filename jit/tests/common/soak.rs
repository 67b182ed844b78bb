//! Long runs: compile, run and drop repeatedly; run while another thread swaps; and the largest programs.
#![allow(dead_code, clippy::unwrap_used)]

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use super::{Image, Random, document, parameters, programs, shipped};
use isophote_jit::{CompileError, Kernel, KernelOptions, PixelFormat, Sums, VectorWidth, Window};
use isophote_symbolic::{Bindings, LIMITS, Lowering, Method, Model, ParameterId, Precision, Program};

/// A program with its inputs.
pub struct Subject {
    pub program: Program,
    pub options: KernelOptions,
    image: Image,
    values: Vec<f64>,
}

impl Subject {
    pub fn new(model: &Model, program: Program) -> Subject {
        let mut random = Random(7);
        let channels = model.channels().len();
        let image = Image::new(PixelFormat::U8, [40, 30], channels, [0, 0], |_, x, y| ((x * 31 + y * 17) % 251) as f64);
        let values = parameters(model, [40, 30], &mut random);
        let options = KernelOptions {
            width: VectorWidth::Bits128,
            precision: Precision::F32,
            formats: vec![PixelFormat::U8; channels],
            packed: true,
        };
        Subject { program, options, image, values }
    }

    pub fn compile(&self) -> Kernel {
        self.try_compile().unwrap()
    }

    pub fn try_compile(&self) -> Result<Kernel, CompileError> {
        Kernel::compile(&self.program, &self.options)
    }

    pub fn run(&self, kernel: &Kernel) -> Sums {
        let bindings = Bindings { parameters: &self.values, entry: &self.values, ..Bindings::default() };
        kernel.sums(&bindings, &self.image.views(), Window::whole(40, 30)).unwrap()
    }
}

/// Three programs of different size.
pub fn subjects() -> Vec<Subject> {
    let lowering = Lowering { fma: false, drop_saturated: false };
    let subject = |(name, at): (&str, usize)| {
        let model = shipped(name);
        let program = programs(&model, lowering).swap_remove(at).1;
        Subject::new(&model, program)
    };
    [("rational-spot", 0), ("thesis-spot", 4), ("gaussian", 4)].map(subject).into()
}

/// Resident memory of the process, KiB.
#[cfg(target_os = "linux")]
pub fn resident_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.split_whitespace().next().unwrap().parse().unwrap()
}

/// Compiles, runs and drops `count` kernels; returns the number of wrong answers.
pub fn cycles(subjects: &[Subject], count: usize) -> usize {
    let expected: Vec<Sums> = subjects.iter().map(|subject| subject.run(&subject.compile())).collect();
    let wrong = |cycle: &usize| {
        let at = cycle % subjects.len();
        subjects[at].run(&subjects[at].compile()) != expected[at]
    };
    (0..count).filter(wrong).count()
}

/// Results of threads that run while another swaps.
#[derive(Debug)]
pub struct Swapping {
    pub answers: u64,
    pub wrong: u64,
    /// Answers of the thread with the fewest.
    pub fewest: u64,
    /// Maximum kernels alive at once: one for each thread that runs, one in the handle, and the next.
    pub most_live: usize,
    /// Kernels alive when all threads are done: the one in the handle.
    pub live: usize,
}

/// Anonymous executable maps, and those that are writable as well.
#[cfg(target_os = "linux")]
pub fn executable_maps() -> (usize, usize) {
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
    let permissions = maps.lines().filter_map(|line| {
        let mut words = line.split_whitespace();
        let (permissions, file) = (words.nth(1)?, words.nth(3));
        Some((permissions.to_owned(), file.is_none()))
    });
    let all: Vec<(String, bool)> = permissions.collect();
    let executable = all.iter().filter(|(p, anonymous)| p.contains('x') && *anonymous).count();
    (executable, all.iter().filter(|(p, _)| p.contains('w') && p.contains('x')).count())
}

/// Three threads run the handle's kernel while this one compiles a new one and swaps it in, `swaps` times. An answer is right
/// if it is the expected one of that kernel's program.
pub fn swapping(subjects: &[Subject], expected: &[Sums], swaps: usize) -> Swapping {
    let fresh = |at: usize| Arc::new((at, subjects[at].compile()));
    let handle = Mutex::new(fresh(0));
    let mut kernels = vec![Arc::downgrade(&*handle.lock().unwrap())];
    let mut most_live = 1;
    let is_over = AtomicBool::new(false);
    let counts: [[AtomicU64; 2]; 3] = Default::default();
    std::thread::scope(|scope| {
        for [answers, wrong] in &counts {
            scope.spawn(|| {
                while !is_over.load(Ordering::Relaxed) {
                    let held = handle.lock().unwrap().clone();
                    let (at, kernel) = &*held;
                    let is_wrong = subjects[*at].run(kernel) != expected[*at];
                    wrong.fetch_add(u64::from(is_wrong), Ordering::Relaxed);
                    answers.fetch_add(1, Ordering::Relaxed);
                }
            });
        }
        for swap in 1..=swaps {
            let next = fresh(swap % subjects.len());
            kernels.push(Arc::downgrade(&next));
            kernels.retain(|kernel| kernel.strong_count() > 0);
            most_live = most_live.max(kernels.len());
            drop(std::mem::replace(&mut *handle.lock().unwrap(), next));
        }
        // On a busy machine a thread may not have started yet.
        while counts.iter().any(|[answers, _]| answers.load(Ordering::Relaxed) == 0) {
            std::thread::yield_now();
        }
        is_over.store(true, Ordering::Relaxed);
    });
    let of = |which: usize| counts.iter().map(move |count| count[which].load(Ordering::Relaxed));
    let live = kernels.iter().filter(|kernel| kernel.strong_count() > 0).count();
    Swapping { answers: of(0).sum(), wrong: of(1).sum(), fewest: of(0).min().unwrap(), most_live, live }
}

/// Documents of a family that grows: the body of the k-th term, and how many parameters a term has.
type Family = (&'static str, usize, fn(usize) -> String);

const FAMILIES: [Family; 4] = [
    ("gaussians", 4, |k| format!("v{k} * exp(-w{k} * ((x - a{k})^2 + (y - b{k})^2))")),
    ("rational spots", 4, |k| format!("v{k} / (1 + w{k} * ((x - a{k})^2 + (y - b{k})^2))^2")),
    ("waves", 4, |k| format!("v{k} * sin(w{k} * x + a{k}) * cos(b{k} * y)")),
    ("tilted gaussians", 6, |k| {
        format!("v{k} * exp(-(w{k} * (x - a{k})^2 + c{k} * (x - a{k}) * (y - b{k}) + d{k} * (y - b{k})^2))")
    }),
];

/// The text of a family's document with that many terms; `noisy`: with weights that depend on the parameters.
fn text((_, letters, term): Family, terms: usize, noisy: bool) -> String {
    let names =
        (0..terms).flat_map(|k| ["v", "w", "a", "b", "c", "d"][..letters].iter().map(move |l| format!("{l}{k}")));
    let names: String = names.map(|name| format!("{name} = {{ start = 1.0 }}\n")).collect();
    let body = (0..terms).map(term).collect::<Vec<_>>().join(" + ");
    let noise = if noisy { "noise = \"1 + 0.1 * abs(m)\"\n" } else { "" };
    format!(
        "name = \"large\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\n{names}\
         [definitions]\nm = \"{body}\"\n[model]\nintensity = \"m\"\n{noise}"
    )
}

/// The documents of each family, without and with noise, that are admitted with all their parameters free by Newton: the
/// family's name, and its members by their number of terms, the largest last.
pub fn admitted() -> Vec<(String, Vec<(usize, Subject)>)> {
    let families = FAMILIES.into_iter().flat_map(|family| [(family, false), (family, true)]);
    let members = |(family, noisy): (Family, bool)| {
        let member = |terms: usize| {
            let model = document(&text(family, terms, noisy));
            let all: Vec<ParameterId> = (0..model.parameters().len()).map(|i| ParameterId(i as u32)).collect();
            let lowering = Lowering { fma: isophote_jit::has_fma(), drop_saturated: true };
            let program = model.objective(&all, Method::Newton).and_then(|objective| objective.program(lowering));
            Some((terms, Subject::new(&model, program.ok()?)))
        };
        let noise = if noisy { ", with noise" } else { "" };
        (format!("{}{noise}", family.0), (1..=LIMITS.parameters / family.1).filter_map(member).collect())
    };
    families.map(members).collect()
}
