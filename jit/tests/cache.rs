//! The cache shares one kernel per program, keeps kernels in use, and stays within its budget.
#![allow(clippy::unwrap_used)]

mod common;

use std::sync::{Arc, Barrier};

use common::{document, programs, shipped};
use isophote_jit::{CompileError, KernelCache, KernelOptions, PixelFormat, VectorWidth};
use isophote_symbolic::{
    Instruction, Level, LoopNest, Lowering, Opcode, PixelSet, Precision, Program, Sink, TotalId, Value,
};

const PLAIN: Lowering = Lowering { fma: false, drop_saturated: false };

fn options(precision: Precision) -> KernelOptions {
    KernelOptions { width: VectorWidth::Bits128, precision, formats: vec![PixelFormat::U8], packed: true }
}

/// A program that outputs a number.
fn constant(number: f64) -> Program {
    let at = |level, op| Instruction { op, level, span: None };
    Program::of(LoopNest {
        coordinates: 2,
        channels: 1,
        inputs: Vec::new(),
        tables: Default::default(),
        instructions: vec![
            at(Level::Pass, Opcode::number(number).of([])),
            at(Level::PassEnd, Opcode::PassTotal(TotalId(0)).of([])),
        ],
        pixel_set: PixelSet::default(),
        sink: Sink::Sums { accumulators: Vec::new(), totals: vec![Value(0)], outputs: vec![Value(0), Value(1)] },
        names: Default::default(),
        fused: false,
    })
    .unwrap()
}

#[test]
fn equivalent_documents_share_kernels() {
    let text = |name: &str, before: &str| {
        format!(
            "{before}name = \"{name}\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\n\
             {name} = {{ start = 1.0 }}\n[model]\nintensity = \"{name} * x + y\"\n"
        )
    };
    let cache = KernelCache::default();
    let first = programs(&document(&text("a", "")), PLAIN);
    let second = programs(&document(&text("bb", "# moves every span\n")), PLAIN);
    assert_ne!(first[2].1, second[2].1, "names and spans differ");
    for (a, b) in first.iter().zip(&second) {
        let kernels = [a, b].map(|(_, program)| cache.get_or_compile(program, &options(Precision::F32)).unwrap());
        assert!(Arc::ptr_eq(&kernels[0], &kernels[1]));
    }
    let counts = cache.counts();
    assert_eq!(counts.hits + counts.misses, 2 * first.len() as u64);
    assert!(counts.hits >= first.len() as u64 && counts.kernels as u64 == counts.misses, "{counts:?}");
}

#[test]
fn a_different_bit_or_option_gets_its_own_kernel() {
    let cache = KernelCache::default();
    let numbers = [0.0, -0.0, 1.0, 1.0 + f64::EPSILON, f64::NAN, -f64::NAN];
    for number in numbers {
        for precision in [Precision::F32, Precision::F64] {
            let kernel = cache.get_or_compile(&constant(number), &options(precision)).unwrap();
            let Some(of_kernel) = kernel.program().instruction(Value(0)).op.constant() else {
                panic!("another program")
            };
            assert_eq!((of_kernel.to_bits(), kernel.options().precision), (number.to_bits(), precision));
        }
    }
    assert_eq!((cache.counts().kernels, cache.counts().hits), (2 * numbers.len(), 0));
    cache.get_or_compile(&constant(f64::NAN), &options(Precision::F32)).unwrap();
    assert_eq!(cache.counts().hits, 1, "a NaN equals itself");
}

#[test]
fn unused_kernels_are_evicted_oldest_first_and_used_ones_stay() {
    let cache = KernelCache::new(1);
    let held: Vec<_> =
        (0..4).map(|i| cache.get_or_compile(&constant(f64::from(i)), &options(Precision::F32)).unwrap()).collect();
    assert_eq!((cache.counts().kernels, cache.counts().evictions), (4, 0), "kernels in use stay");
    let one = cache.counts().bytes / 4;
    assert!(held[0].code_bytes() < one && one < 64 * 1024, "{one} bytes for {} of code", held[0].code_bytes());

    let cache = KernelCache::new(4 * one + one / 2);
    let ask = |number: u32| drop(cache.get_or_compile(&constant(number.into()), &options(Precision::F32)).unwrap());
    (0..4).for_each(ask);
    ask(0); // now 1 is the oldest
    ask(4);
    assert_eq!((cache.counts().kernels, cache.counts().evictions), (4, 1));
    let before = cache.counts().misses;
    [0, 2, 3, 4].into_iter().for_each(ask);
    assert_eq!(cache.counts().misses, before, "the wrong one left");
    ask(1);
    assert_eq!(cache.counts().misses, before + 1);
    assert!(cache.counts().bytes <= 4 * one + one / 2);
}

#[test]
fn concurrent_requests_share_one_compilation() {
    let program = programs(&shipped("spot"), PLAIN).swap_remove(2).1;
    let (cache, barrier) = (KernelCache::default(), Barrier::new(4));
    let kernels: Vec<_> = std::thread::scope(|scope| {
        let ask = || {
            barrier.wait();
            cache.get_or_compile(&program, &options(Precision::F32)).unwrap()
        };
        let threads: Vec<_> = (0..4).map(|_| scope.spawn(ask)).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    assert!(kernels.iter().all(|kernel| Arc::ptr_eq(kernel, &kernels[0])));
    assert_eq!((cache.counts().misses, cache.counts().hits, cache.counts().kernels), (1, 3, 1));
}

#[test]
fn failures_are_returned_to_every_caller_and_not_cached() {
    let cache = KernelCache::default();
    let wrong =
        KernelOptions { width: VectorWidth::Bits128, precision: Precision::F32, formats: Vec::new(), packed: true };
    for asked in 1..3 {
        let error = cache.get_or_compile(&constant(1.0), &wrong).unwrap_err();
        assert_eq!(error, CompileError::Formats { channels: 1, formats: 0 });
        assert_eq!((cache.counts().kernels, cache.counts().bytes, cache.counts().misses), (0, 0, asked));
    }
}

#[test]
fn waiting_requests_retry_after_a_failed_compilation() {
    let program = programs(&shipped("spot"), PLAIN).swap_remove(2).1;
    let wrong =
        KernelOptions { width: VectorWidth::Bits128, precision: Precision::F32, formats: Vec::new(), packed: true };
    for _ in 0..50 {
        let (cache, barrier) = (KernelCache::default(), Barrier::new(4));
        let ask = || {
            barrier.wait();
            cache.get_or_compile(&program, &wrong).map(drop)
        };
        let ends: Vec<_> = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..4).map(|_| scope.spawn(ask)).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        assert!(ends.iter().all(|end| *end == Err(CompileError::Formats { channels: 1, formats: 0 })), "{ends:?}");
        assert_eq!((cache.counts().kernels, cache.counts().misses), (0, 4));
    }
}

#[test]
fn tables_are_keyed_by_their_samples() {
    let text = |last: &str| {
        format!(
            "name = \"t\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[tables.psf]\nfirst = 0\nstep = 1\n\
             values = [1, 2, 1, {last}]\n[parameters]\na = {{ start = 1.0 }}\n[model]\nintensity = 'table(\"psf\", x - a)'\n"
        )
    };
    let program = |last: &str| programs(&document(&text(last)), PLAIN).swap_remove(0).1;
    let cache = KernelCache::default();
    let of = |last: &str| cache.get_or_compile(&program(last), &options(Precision::F32)).unwrap();
    assert!(Arc::ptr_eq(&of("0"), &of("0.0")) && !Arc::ptr_eq(&of("0"), &of("1e-9")));
}
