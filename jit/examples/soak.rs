//! The long run: `cargo run --release -p isophote-jit --example soak`; behind `--` the parts that are wanted, of `cycles`,
//! `swaps`, `largest`, `cache`, `documents`, `triples`.
#![allow(clippy::print_stdout, clippy::unwrap_used, missing_docs)]

#[path = "../tests/common/mod.rs"]
mod common;

use std::time::Instant;

use common::differential::{Case, Stage, agree};
use common::documents::{Tally, try_document};
use common::generate::{self, Variety};
use common::soak::{admitted, cycles, executable_maps, resident_kib, subjects, swapping};
use common::{Random, widths};
use isophote_jit::{CompileError, Kernel, KernelCache, KernelOptions, PixelFormat, VectorWidth, has_fma};
use isophote_symbolic::{LIMITS, Level, Lowering, Precision, Program};

const CYCLES: usize = 100_000;
const SWAPS: usize = 100_000;
const DOCUMENTS: u64 = 10_000;
const TRIPLES: usize = 1_000_000;

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let parts: [(&str, fn()); 6] = [
        ("cycles", run_cycles),
        ("swaps", run_swaps),
        ("largest", run_largest),
        ("cache", run_cache),
        ("documents", run_documents),
        ("triples", run_triples),
    ];
    parts
        .iter()
        .filter(|(name, _)| words.is_empty() || words.iter().any(|word| word == name))
        .for_each(|(_, run)| run());
}

fn run_cycles() {
    let subjects = subjects();
    cycles(&subjects, 1000);
    let (start, before) = (Instant::now(), resident_kib());
    let (mut wrong, mut most) = (0, before);
    for thousand in 1..=CYCLES / 1000 {
        wrong += cycles(&subjects, 1000);
        most = most.max(resident_kib());
        if thousand % 20 == 0 {
            println!("{thousand},000 cycles: {} KiB resident", resident_kib());
        }
    }
    let growth = resident_kib() as f64 - before as f64;
    println!(
        "{CYCLES} compile-run-drop cycles in {:.0} s: {wrong} wrong answers; resident memory {before} KiB after the first \
         1,000, {:+.2} KiB per 1,000 cycles, at most +{} KiB",
        start.elapsed().as_secs_f64(),
        growth / (CYCLES / 1000) as f64,
        most.saturating_sub(before),
    );
}

fn run_swaps() {
    let subjects = subjects();
    let expected: Vec<_> = subjects.iter().map(|subject| subject.run(&subject.compile())).collect();
    let (start, maps) = (Instant::now(), executable_maps());
    let seen = swapping(&subjects, &expected, SWAPS);
    println!("{SWAPS} swaps in {:.0} s under 3 running threads: {seen:?}", start.elapsed().as_secs_f64());
    println!(
        "maps that are executable, and those that are writable as well: {maps:?} before, {:?} after",
        executable_maps()
    );
}

/// Of each family the largest admitted program, and the one that takes longest (a smaller one may get the allocator that
/// takes its time).
fn run_largest() {
    println!(
        "| family | terms | instructions | of them a pixel | code, KiB | compiled in, ms: median of 5 (min - max) |"
    );
    println!("|---|---|---|---|---|---|");
    for (family, members) in admitted() {
        let mut rows: Vec<(f64, String)> = members
            .iter()
            .map(|(terms, subject)| row(&family, *terms, &subject.program, &|| subject.try_compile()))
            .collect();
        let largest = rows.pop();
        let slowest = rows.into_iter().max_by(|a, b| a.0.total_cmp(&b.0));
        slowest.into_iter().chain(largest).for_each(|(_, row)| println!("{row}"));
    }
    // No document is known to reach the caps; random instructions do, and leave many values alive for long.
    for pixels in [1000, 2000, 4000, 6000, LIMITS.instructions] {
        let lengths = [LIMITS.nodes - 2 * LIMITS.instructions, LIMITS.instructions / 4, pixels]
            .map(|n| n * pixels / LIMITS.instructions);
        let variety = Variety {
            fma: has_fma(),
            calls: false,
            tables: false,
            lengths: [lengths[0], lengths[1], pixels],
            sums: pixels / 4,
        };
        let program = generate::program(&mut Random(pixels as u64), variety, false);
        let options = KernelOptions {
            width: VectorWidth::Bits128,
            precision: Precision::F32,
            formats: vec![PixelFormat::U8; program.channels()],
            packed: true,
        };
        let (_, row) = row("random instructions", pixels, &program, &|| Kernel::compile(&program, &options));
        println!("{row}");
    }
}

/// The median time, and the row of the table.
fn row(
    family: &str,
    terms: usize,
    program: &Program,
    compile: &dyn Fn() -> Result<Kernel, CompileError>,
) -> (f64, String) {
    let instructions = program.instructions();
    let pixel = instructions.iter().filter(|i| i.level == Level::Pixel).count();
    let timed = |_| {
        let start = Instant::now();
        let kernel = compile();
        (start.elapsed().as_secs_f64() * 1e3, kernel.map(|kernel| kernel.code_bytes()))
    };
    let mut times: Vec<_> = (0..5).map(timed).collect();
    times.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (min, median, max) = (times[0].0, times[2].0, times[4].0);
    let code = match &times[0].1 {
        Ok(bytes) => format!("{:.0}", *bytes as f64 / 1024.0),
        Err(error) => error.to_string(),
    };
    let row = format!(
        "| {family} | {terms} | {} | {pixel} | {code} | {median:.0} ({min:.0} - {max:.0}) |",
        instructions.len()
    );
    (median, row)
}

/// A model sent again: its kernels are there.
fn run_cache() {
    let model = common::shipped("thesis-spot");
    let options = KernelOptions {
        width: VectorWidth::Bits128,
        precision: Precision::F32,
        formats: vec![PixelFormat::U8],
        packed: true,
    };
    let programs = |drop_saturated| common::programs(&model, Lowering { fma: has_fma(), drop_saturated });
    let programs: Vec<_> = [programs(false), programs(true)].into_iter().flatten().collect();
    let cache = KernelCache::default();
    let all = || {
        let start = Instant::now();
        programs.iter().for_each(|(_, program)| drop(cache.get_or_compile(program, &options).unwrap()));
        start.elapsed().as_secs_f64() * 1e3
    };
    let (first, mut again) = (all(), (0..101).map(|_| all()).collect::<Vec<_>>());
    again.sort_by(f64::total_cmp);
    let (counts, live) = (cache.counts(), resident_kib());
    println!(
        "{} kernels of thesis-spot: {first:.2} ms at first, {:.4} ms again (median of 101; at most {:.4}); {counts:?}",
        programs.len(),
        again[50],
        again[100],
    );
    let held: Vec<Kernel> =
        (0..1000).map(|i| Kernel::compile(&programs[i % programs.len()].1, &options).unwrap()).collect();
    let grown = (resident_kib() - live) as f64 / held.len() as f64;
    let estimated = counts.bytes as f64 / 1024.0 / counts.kernels as f64;
    println!("a live kernel takes {grown:.1} KiB of resident memory; the cache reckons with {estimated:.1}");
}

/// Every program of random documents: machine code, interpreter and formulas say the same.
fn run_documents() {
    let (start, mut tally) = (Instant::now(), Tally::default());
    for seed in 1000.. {
        let (faults, documents) = (tally.faults.len(), tally.documents);
        try_document(seed, &mut tally);
        tally.faults[faults..].iter().for_each(|fault| println!("{fault}"));
        if tally.documents % 1000 == 0 && tally.documents > documents {
            println!("{} documents in {:.0} s", tally.documents, start.elapsed().as_secs_f64());
        }
        if tally.documents == DOCUMENTS {
            break;
        }
    }
    let faults = tally.faults.len();
    tally.faults.clear();
    println!("{faults} faults in {:.0} s: {tally:?}", start.elapsed().as_secs_f64());
}

/// Generated programs over generated pixels and numbers, with vectors of every width that this machine has: machine code and
/// interpreter say the same.
fn run_triples() {
    for width in widths() {
        let (start, mut programs, mut triples, mut wrong) = (Instant::now(), 0, 0, 0);
        for seed in 1_000_000.. {
            if triples >= TRIPLES {
                break;
            }
            let mut random = Random(seed);
            let longest = *random.pick(&[4, 10, 30, 60, 150]);
            let lengths = [longest, longest / 2, longest].map(|most| 1 + random.below(most));
            let (fma, calls) = (has_fma() && random.below(2) == 0, random.below(3) == 0);
            let tables = random.below(2) == 0;
            let is_picture = random.below(8) == 0;
            let program = generate::program(&mut random, Variety { fma, calls, tables, lengths, sums: 9 }, is_picture);
            let precision = *random.pick(&[Precision::F32, Precision::F64]);
            let mut stage = Stage::new(&mut random, &program, width.lanes(precision));
            let kernel = Kernel::compile(&program, &stage.options(precision, width)).unwrap();
            for odds in [0, 3, 10, 40] {
                stage.draw(&mut random, odds);
                for _ in 0..25 {
                    let case = Case::new(&mut random, &stage, odds);
                    let expected = case.interpreted(&program, kernel.options(), &stage);
                    if !agree(&case.native(&kernel, &stage), &expected) {
                        println!("seed {seed}, {width:?}: {case:?}");
                        wrong += 1;
                    }
                    triples += 1;
                }
            }
            programs += 1;
        }
        println!(
            "{width:?}: {wrong} of {triples} triples of program, pixels and numbers differ; {programs} programs in {:.0} s",
            start.elapsed().as_secs_f64()
        );
    }
}
