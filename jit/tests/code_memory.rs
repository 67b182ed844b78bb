//! Refused code memory is an error, nothing leaks, and existing kernels keep running. Alone in its file: it counts the process'
//! maps, and limits the memory of processes that run this file again.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used)]

mod common;

use std::hint::black_box;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use common::soak::{Subject, subjects};
use common::widths;
use isophote_jit::{CodeMemory, CodeStep, CompileError, Kernel, KernelCache, KernelOptions, VectorWidth};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Refuses the step with a given number, counted from zero.
#[derive(Debug, Default)]
struct Faulty {
    asked: Mutex<Vec<CodeStep>>,
    refused: AtomicUsize,
}

impl Faulty {
    /// Sets the step to refuse, and returns the steps requested since the last call.
    fn refuse(&self, number: usize) -> Vec<CodeStep> {
        self.refused.store(number, Ordering::Relaxed);
        std::mem::take(&mut self.asked.lock().unwrap())
    }
}

impl CodeMemory for Faulty {
    fn permit(&self, step: CodeStep) -> Result<(), String> {
        let mut asked = self.asked.lock().unwrap();
        let is_refused = asked.len() == self.refused.load(Ordering::Relaxed);
        asked.push(step);
        if is_refused { Err(format!("planted at {step:?}")) } else { Ok(()) }
    }
}

/// A cache that evicts every unused kernel.
fn cache(memory: &Arc<Faulty>) -> KernelCache {
    KernelCache::new(0).in_memory(memory.clone())
}

fn compile(cache: &KernelCache, subject: &Subject, width: VectorWidth) -> Result<Arc<Kernel>, CompileError> {
    cache.get_or_compile(&subject.program, &KernelOptions { width, ..subject.options.clone() })
}

/// Mapped pages of the process.
fn pages() -> u64 {
    let counts = std::fs::read_to_string("/proc/self/statm").unwrap();
    counts.split_whitespace().next().unwrap().parse().unwrap()
}

/// Each step of each backend's kernel is refused once.
fn every_step_may_fail() {
    let memory = Arc::new(Faulty::default());
    let subjects = subjects();
    for width in widths() {
        let cache = cache(&memory);
        memory.refuse(usize::MAX);
        let held = compile(&cache, &subjects[0], width).unwrap();
        let expected = subjects[0].run(&held);
        let steps = memory.refuse(usize::MAX);
        assert_eq!(steps, [CodeStep::Map, CodeStep::Protect], "{width:?}");
        for (number, step) in steps.into_iter().enumerate() {
            let fail = || {
                memory.refuse(number);
                match compile(&cache, &subjects[1], width) {
                    Err(CompileError::NoCodeMemory(why)) => assert!(why.contains(&format!("planted at {step:?}"))),
                    other => panic!("{width:?}, {step:?}: {other:?}"),
                }
            };
            (0..20).for_each(|_| fail());
            let before = pages();
            (0..400).for_each(|_| fail());
            // A leaked page each time would be 400.
            assert!(pages() < before + 100, "{width:?}, {step:?}: {} more pages", pages() - before);
            assert_eq!(subjects[0].run(&held), expected, "a kernel that was there");
        }
        memory.refuse(usize::MAX);
        compile(&cache, &subjects[1], width).unwrap();
    }
    // Planted fault: kernels that are not dropped are detected.
    let before = pages();
    let kept: Vec<_> = (0..400).map(|_| subjects[1].compile()).collect();
    assert!(pages() >= before + 400, "{} kernels that were kept are not seen", kept.len());
}

/// Runs in a process limited to `more` additional pages: compiles kernels until the system refuses, then lifts the limit.
fn compile_within(more: u64) {
    let (memory, subjects) = (Arc::new(Faulty::default()), subjects());
    memory.refuse(usize::MAX);
    let cache = cache(&memory);
    // Warms up the allocator, so that it needs no new memory later, not even for large pieces.
    drop(black_box(vec![1_u8; 24 << 20]));
    drop(black_box((0..512).map(|_| vec![1_u8; 32 << 10]).collect::<Vec<_>>()));
    let mut held = Vec::with_capacity(10_000);
    held.push(compile(&cache, &subjects[0], VectorWidth::Bits128).unwrap());
    let expected = subjects[0].run(&held[0]);
    let Rlimit { maximum, .. } = getrlimit(Resource::As);
    setrlimit(Resource::As, Rlimit { current: Some((pages() + more) * rustix::param::page_size() as u64), maximum })
        .unwrap();
    let refused = loop {
        match Kernel::compile(&subjects[0].program, &subjects[0].options) {
            Ok(kernel) => held.push(Arc::new(kernel)),
            Err(error) => break error,
        }
        assert!(held.len() < 10_000, "nothing is refused");
    };
    let sums: Vec<_> = held.iter().map(|kernel| subjects[0].run(kernel)).collect();
    setrlimit(Resource::As, Rlimit { current: None, maximum }).unwrap();
    assert!(matches!(&refused, CompileError::NoCodeMemory(why) if why.contains("os error 12")), "{refused:?}");
    assert!(sums.iter().all(|sums| *sums == expected), "kernels that are there run on");
    assert!(held.len() as u64 <= more + 2, "{} kernels in {more} pages", held.len());
    compile(&cache, &subjects[1], VectorWidth::Bits128).unwrap();
}

/// Passes the page limit to the process that runs this file again.
const MORE_PAGES: &str = "ISOPHOTE_MORE_PAGES";

#[test]
fn refused_code_memory_is_an_error_without_leaks() {
    if let Ok(more) = std::env::var(MORE_PAGES) {
        return compile_within(more.parse().unwrap());
    }
    every_step_may_fail();
    for more in 0..20 {
        let mut again = std::process::Command::new(std::env::current_exe().unwrap());
        let ended = again.arg("--nocapture").env(MORE_PAGES, more.to_string()).output().unwrap();
        assert!(
            ended.status.success(),
            "{more} more pages: {}\n{}",
            ended.status,
            String::from_utf8_lossy(&ended.stderr)
        );
    }
}
