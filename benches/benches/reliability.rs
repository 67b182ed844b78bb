//! `cargo bench -p isophote-benches --bench reliability [-- FRAMES [SEED]]`: of estimates that say to be right with some
//! probability, how many are, in cold starts of shipped documents in frames full of other things; FRAMES of each kind. With
//! `UPDATE_EXPECT=1` it writes its part of docs/confidence.md and the diagram.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use isophote_benches::accuracy::reliability::{figure, said, table};
use isophote_benches::page;

fn main() {
    let numbers: Vec<u64> = std::env::args().filter_map(|argument| argument.parse().ok()).collect();
    let (frames, first) = (numbers.first().copied().unwrap_or(100), numbers.get(1).copied().unwrap_or(0));
    let all = said(frames as usize, first);
    let sources = ["tracker", "symbolic", "jit", "models", "benches"];
    let command = format!("reliability -- {frames} {first}");
    let text = format!("{}\n{}", table(&all), page::provenance(&command, &sources));
    println!("{text}");
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        page::write_to("confidence.md", "reliability", &text);
        page::write_svg("confidence-reliability.svg", &figure(&all));
    }
}
