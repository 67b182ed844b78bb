//! `cargo bench -p isophote-benches --bench accuracy [-- CONDITION… [--frames N]]`: how right estimates are, over the
//! Cramér–Rao bound, on rendered frames with known truth. With `UPDATE_EXPECT=1` and without arguments it writes
//! docs/accuracy.md and its figures. The same seeds give the same frames on every run, whatever the processors.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use isophote_benches::accuracy::condition::ROWS;
use isophote_benches::accuracy::run::{Documents, Measured, measure};
use isophote_benches::accuracy::table;

/// Frames of a row.
const FRAMES: usize = 3000;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let frames =
        arguments.iter().position(|argument| argument == "--frames").map(|at| arguments[at + 1].parse().unwrap());
    let wanted = |name: &str| {
        let names = arguments.iter().filter(|argument| ROWS.iter().any(|row| row.condition == **argument));
        names.clone().count() == 0 || names.into_iter().any(|argument| argument == name)
    };
    let mut documents = Documents::default();
    println!("{}", table::HEAD);
    let mut all: Vec<Measured> = Vec::new();
    for row in ROWS.iter().filter(|row| wanted(row.condition)) {
        let measured = measure(&row.task(), documents.get(row.document), frames.unwrap_or(FRAMES));
        println!("{}", table::centre_line(row, &measured));
        all.push(measured);
    }
    println!("\n{}", table::worth(&all));
}
