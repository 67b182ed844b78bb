//! Processor time and peak memory of each hostile document, as a table, the slowest last: `cargo run --release -p isophote-symbolic --example hostile`;
//! with words behind `--`, of those documents alone whose name holds one of them.
#![allow(clippy::print_stdout, clippy::unwrap_used, missing_docs)]

#[path = "../tests/hostile/documents.rs"]
mod documents;
#[path = "../tests/hostile/ending.rs"]
mod ending;

use peak_alloc::PeakAlloc;

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

/// Processor time of this thread, ms: what others run at the same time does not count. Linux tells it.
fn processor_ms() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).map_or(f64::NAN, |ns| ns / 1e6)
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    println!("| document | bytes | reading, ms | deriving, ms | peak, KiB | ends with |");
    println!("|---|---|---|---|---|---|");
    let is_meant = |name: &str| words.is_empty() || words.iter().any(|word| name.contains(word.as_str()));
    let mut rows = Vec::new();
    for hostile in documents::all().into_iter().filter(|hostile| is_meant(hostile.name)) {
        let before = MEMORY.current_usage();
        MEMORY.reset_peak_usage();
        let start = processor_ms();
        let model = hostile.read();
        let reading = processor_ms() - start;
        let end = match model {
            Err(faults) => format!("{}: {}", faults[0].code, faults[0].message),
            Ok(model) => match ending::derive(&model) {
                Err(faults) => format!("when deriving, {}: {}", faults[0].code, faults[0].message),
                Ok(()) => "a program".into(),
            },
        };
        let all = processor_ms() - start;
        let peak = MEMORY.peak_usage().saturating_sub(before) >> 10;
        let (name, bytes, deriving) = (hostile.name, hostile.text.len(), all - reading);
        rows.push((all, format!("| {name} | {bytes} | {reading:.1} | {deriving:.1} | {peak} | {end} |")));
    }
    rows.sort_by(|a, b| a.0.total_cmp(&b.0));
    rows.iter().for_each(|(_, row)| println!("{row}"));
}
