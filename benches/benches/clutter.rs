//! `cargo bench -p isophote-benches --bench clutter [-- FRAMES [FIRST [TARGETS]] [DOCUMENT…]]`: what is taken for a target in frames
//! full of squares, bars, rings, triangles, texture and 1/f noise, sharp and blurred, and how many targets among them are found, with
//! the shipped documents and default options: FRAMES without a target, TARGETS with one (as many), of each kind. FIRST is the first
//! seed. With `UPDATE_EXPECT=1` and all documents it writes its part of docs/confidence.md.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use isophote_benches::accuracy::clutter;
use isophote_benches::page;

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let numbers: Vec<usize> = arguments.iter().filter_map(|argument| argument.parse().ok()).collect();
    let is_named = |document: &&str| arguments.iter().any(|argument| argument == document);
    let some = clutter::DOCUMENTS.iter().any(is_named);
    let number = |place: usize, usual| numbers.get(place).copied().unwrap_or(usual);
    let (frames, first) = (number(0, 1000), number(1, 0));
    let targets = number(2, frames);
    let mut text = clutter::HEAD.to_string();
    print!("{text}");
    for document in clutter::DOCUMENTS.iter().filter(|document| !some || is_named(document)) {
        for line in clutter::lines(document, [frames, targets], first as u64) {
            print!("{line}");
            text += &line;
        }
    }
    let command = format!("clutter -- {frames} {first} {targets}");
    text += &format!("\n{}", page::provenance(&command, &["tracker", "symbolic", "jit", "models", "benches"]));
    if !some && std::env::var_os("UPDATE_EXPECT").is_some() {
        page::write_to("confidence.md", "clutter", &text);
    }
}
