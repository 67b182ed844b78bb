//! `cargo bench -p isophote-benches --bench pose [-- FRAMES]`: poses of three spots, by every method, against the truth and
//! the Cramér–Rao bound. With `UPDATE_EXPECT=1` it writes docs/pose-accuracy.md anew.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use isophote_benches::accuracy::pose::cell::{CELLS, Documents, run};
use isophote_benches::accuracy::pose::disturbed::{self, CONDITIONS, Disturbance};
use isophote_benches::accuracy::pose::table::{branches, consistency, errors};
use isophote_benches::accuracy::pose::thesis;
use isophote_benches::page;

/// Frames of a cell.
const FRAMES: usize = 200;
/// The methods that begin with ellipses see each so many-th of them.
const EVERY: usize = 2;
const SEED: u64 = 20_261_121;

/// Sequences of a disturbance.
const SEQUENCES: usize = 20;

/// One frame in so many of the others is a sequence.
const FRAMES_A_SEQUENCE: usize = FRAMES / SEQUENCES;

fn disturbed_poses(frames: usize, wanted: Option<&str>) -> String {
    let documents = disturbed::DisturbedDocuments::new();
    let sources = ["tracker", "jit", "symbolic", "models", "benches"];
    let mut text = format!("{}\n\n{}", page::provenance("pose", &sources), disturbed::HEAD);
    for (number, condition) in CONDITIONS.into_iter().enumerate() {
        if wanted.is_some_and(|wanted| !condition.name.contains(wanted)) {
            continue;
        }
        let is_cold = matches!(condition.disturbance, Disturbance::Cold { .. } | Disturbance::ColdQuarters(_));
        let count = if is_cold { frames } else { (frames / FRAMES_A_SEQUENCE).max(1) };
        let begin = std::time::Instant::now();
        let told = disturbed::run(&documents, condition, count, SEED + 50_000_000 + 1_000_000 * number as u64);
        let row = told.text(condition.name);
        eprintln!("{row} {:.1} s", begin.elapsed().as_secs_f64());
        text = text + "\n" + &row;
    }
    text + "\n"
}

fn main() {
    let frames = std::env::args().skip(1).find_map(|argument| argument.parse().ok()).unwrap_or(FRAMES);
    // Only the disturbed ones, or those of them that a word names: `-- 200 --disturbed glare`.
    let mut words = std::env::args().skip_while(|argument| argument != "--disturbed").skip(1);
    if std::env::args().any(|argument| argument == "--disturbed") {
        let wanted = words.next().filter(|word| !word.starts_with('-'));
        let text = disturbed_poses(frames, wanted.as_deref());
        println!("{text}");
        if std::env::var("UPDATE_EXPECT").is_ok() && wanted.is_none() {
            page::write_to("pose-accuracy.md", "disturbed", &text);
        }
        return;
    }
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
        page::write_to("pose-accuracy.md", "disturbed", &disturbed_poses(frames, None));
        page::write_to("pose.md", "thesis", &thesis::table());
    }
}
