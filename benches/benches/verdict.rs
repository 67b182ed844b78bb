//! `cargo bench -p isophote-benches --bench verdict [-- FRAMES [FIRST]]`: whether what was fitted is the target, by a few signs of
//! the fit and a line that is learned from other kinds of things, or other documents; beside the product's confidence. FRAMES of each
//! document, from number FIRST on.
#![allow(missing_docs, clippy::print_stdout)]

use isophote_benches::accuracy::verdict::{examples, report};

fn main() {
    let numbers: Vec<usize> = std::env::args().filter_map(|argument| argument.parse().ok()).collect();
    let number = |place: usize, usual| numbers.get(place).copied().unwrap_or(usual);
    println!("{}", report(&examples(number(0, 480), number(1, 0) as u64)));
}
