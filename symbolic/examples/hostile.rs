//! Time and peak memory of each hostile document, as a table: `cargo run --release -p isophote-symbolic --example hostile`;
//! with words behind `--`, of those documents alone whose name holds one of them.
#![allow(clippy::print_stdout, clippy::unwrap_used, missing_docs)]

#[path = "../tests/hostile/documents.rs"]
mod documents;
#[path = "../tests/hostile/ending.rs"]
mod ending;

use std::time::Instant;

use peak_alloc::PeakAlloc;

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    println!("| document | bytes | reading, ms | deriving, ms | peak, KiB | ends with |");
    println!("|---|---|---|---|---|---|");
    let is_meant = |name: &str| words.is_empty() || words.iter().any(|word| name.contains(word.as_str()));
    for hostile in documents::all().into_iter().filter(|hostile| is_meant(hostile.name)) {
        let before = MEMORY.current_usage();
        MEMORY.reset_peak_usage();
        let start = Instant::now();
        let model = ending::read(&hostile);
        let reading = start.elapsed().as_secs_f64() * 1e3;
        let start = Instant::now();
        let end = match model {
            Err(faults) => format!("{}: {}", faults[0].code, faults[0].message),
            Ok(model) => match ending::derive(&model) {
                Err(faults) => format!("when deriving, {}: {}", faults[0].code, faults[0].message),
                Ok(()) => "a program".into(),
            },
        };
        let deriving = start.elapsed().as_secs_f64() * 1e3;
        let peak = MEMORY.peak_usage().saturating_sub(before) >> 10;
        println!("| {} | {} | {reading:.1} | {deriving:.1} | {peak} | {end} |", hostile.name, hostile.text.len());
    }
}
