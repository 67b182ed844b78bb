//! `cargo bench -p isophote-benches --bench pose [-- FRAMES]`: poses of three spots, by every method, against the truth and
//! the Cramér–Rao bound. With `UPDATE_EXPECT=1` it writes docs/pose-accuracy.md anew.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use isophote_benches::accuracy::pose::cell::{CELLS, Documents, run};
use isophote_benches::accuracy::pose::table::{branches, consistency, errors};
use isophote_benches::accuracy::pose::thesis;
use isophote_benches::page;

/// Frames of a cell.
const FRAMES: usize = 200;
/// The methods that begin with ellipses see each so many-th of them.
const EVERY: usize = 2;
const SEED: u64 = 20_261_121;

fn main() {
    let frames = std::env::args().skip(1).find_map(|argument| argument.parse().ok()).unwrap_or(FRAMES);
    let documents = Documents::new();
    let mut all = Vec::new();
    for (number, cell) in CELLS.into_iter().enumerate() {
        eprintln!("{} …", cell.name);
        all.push(run(&documents, cell, frames, EVERY, SEED + 1_000_000 * number as u64));
    }
    let sources = ["tracker", "jit", "symbolic", "models", "benches"];
    let text = format!(
        "{}\n\n{}\n\n{}\n\n{}\n",
        page::provenance("pose", &sources),
        errors(&all),
        consistency(&all),
        branches(&all)
    );
    println!("{text}\n{}", thesis::table());
    if std::env::var("UPDATE_EXPECT").is_ok() {
        page::write_to("pose-accuracy.md", "table", &text);
        page::write_to("pose.md", "thesis", &thesis::table());
    }
}
