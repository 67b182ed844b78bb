//! `cargo bench -p isophote-benches --bench verdict [-- [--learn] [FRAMES [FIRST]]]`: whether a fit is the target, in
//! cold starts of eight documents in cluttered frames: FRAMES of each, from number FIRST on. `--learn` writes the
//! weights of the verdict; `UPDATE_EXPECT=1` writes its part of docs/confidence.md and the figure.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use isophote_benches::accuracy::verdict::report::{accepted, discrimination, figure};
use isophote_benches::accuracy::verdict::{examples, learned};
use isophote_benches::page;

fn main() {
    let numbers: Vec<usize> = std::env::args().filter_map(|argument| argument.parse().ok()).collect();
    let number = |place: usize, usual| numbers.get(place).copied().unwrap_or(usual);
    let (frames, first) = (number(0, 480), number(1, 0));
    let examples = examples(frames, first as u64);
    let (accepted, discrimination) = (accepted(&examples), discrimination(&examples));
    println!("{accepted}\n{discrimination}");
    if std::env::args().any(|argument| argument == "--learn") {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../tracker/src/verdict/learned.rs");
        std::fs::write(path, learned(&examples, [frames, first])).unwrap();
    }
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        let sources = ["tracker", "symbolic", "jit", "models", "benches"];
        let provenance = page::provenance(&format!("verdict -- {frames} {first}"), &sources);
        page::write_to("confidence.md", "verdict", &format!("{accepted}\n{provenance}"));
        page::write_svg("confidence-verdict.svg", &figure(&examples));
    }
}
