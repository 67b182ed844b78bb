//! `cargo bench -p isophote-benches --bench clutter [-- FRAMES [FIRST [TARGETS]]]`: what is taken for a target in frames full of
//! squares, bars, rings, triangles, texture and 1/f noise, sharp and blurred, and how many targets among them are found, with the
//! shipped documents and default options: FRAMES without a target, TARGETS with one (as many), of each kind. FIRST is the first
//! seed. With `UPDATE_EXPECT=1` it writes its part of docs/confidence.md.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use isophote_benches::accuracy::clutter;
use isophote_benches::page;

fn main() {
    let numbers: Vec<usize> = std::env::args().filter_map(|argument| argument.parse().ok()).collect();
    let number = |place: usize, usual| numbers.get(place).copied().unwrap_or(usual);
    let (frames, first) = (number(0, 1000), number(1, 0));
    let targets = number(2, frames);
    let mut text = clutter::HEAD.to_string();
    print!("{text}");
    for document in clutter::DOCUMENTS {
        for line in clutter::lines(document, [frames, targets], first as u64) {
            print!("{line}");
            text += &line;
        }
    }
    let command = format!("clutter -- {frames} {first} {targets}");
    text += &format!("\n{}", page::provenance(&command, &["tracker", "symbolic", "jit", "models", "benches"]));
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        page::write_to("confidence.md", "clutter", &text);
    }
}
