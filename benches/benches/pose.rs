//! `cargo bench -p isophote-benches --bench pose [-- FRAMES] [--seed N]`: poses of three spots by every method,
//! against the truth and the Cramér–Rao bound; `--cold`: in other light, `--disturbed`: under disturbances.
//! `UPDATE_EXPECT=1` writes docs/pose-accuracy.md.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use std::time::Instant;

use isophote_benches::accuracy::pose::cell::{CELLS, Documents, run};
use isophote_benches::accuracy::pose::cold::{self, ColdDocuments, ROWS};
use isophote_benches::accuracy::pose::disturbed::{self, CONDITIONS};
use isophote_benches::accuracy::pose::table::{branches, consistency, errors};
use isophote_benches::accuracy::pose::tally;
use isophote_benches::accuracy::pose::thesis;
use isophote_benches::page;

/// Frames of a cell.
const FRAMES: usize = 200;
/// Methods that start from ellipses see every n-th frame.
const EVERY: usize = 2;
const SEED: u64 = 20_261_121;

/// Sequences per disturbance.
const SEQUENCES: usize = 20;

/// One sequence per this many frames of the other parts.
const FRAMES_A_SEQUENCE: usize = FRAMES / SEQUENCES;

fn cold_poses(frames: usize, seed: u64, wanted: Option<&str>) -> String {
    let mut documents = ColdDocuments::default();
    let sources = ["tracker", "jit", "symbolic", "models", "benches"];
    let mut text = format!("{}\n\n{}", page::provenance("pose", &sources), cold::HEAD);
    for (number, row) in ROWS.into_iter().enumerate() {
        if wanted.is_some_and(|wanted| !row.name.contains(wanted)) {
            continue;
        }
        let begin = Instant::now();
        let tally = cold::run(&mut documents, row, frames, seed + 100_000_000 + 1_000_000 * number as u64);
        let row = tally.text(row.name);
        eprintln!("{row} {:.1} s", begin.elapsed().as_secs_f64());
        text = text + "\n" + &row;
    }
    text + "\n"
}

fn disturbed_poses(frames: usize, seed: u64, wanted: Option<&str>) -> String {
    let documents = disturbed::DisturbedDocuments::new();
    let sources = ["tracker", "jit", "symbolic", "models", "benches"];
    let mut text = format!("{}\n\n{}", page::provenance("pose", &sources), tally::HEAD);
    for (number, condition) in CONDITIONS.into_iter().enumerate() {
        if wanted.is_some_and(|wanted| !condition.name.contains(wanted)) {
            continue;
        }
        let count = if condition.is_cold() { frames } else { (frames / FRAMES_A_SEQUENCE).max(1) };
        let begin = Instant::now();
        let tally = disturbed::run(&documents, condition, count, seed + 50_000_000 + 1_000_000 * number as u64);
        let row = tally.text(condition.name);
        eprintln!("{row} {:.1} s", begin.elapsed().as_secs_f64());
        text = text + "\n" + &row;
    }
    text + "\n"
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let after = |name: &str| words.iter().skip_while(|word| *word != name).nth(1).filter(|word| !word.starts_with('-'));
    let seed = after("--seed").and_then(|seed| seed.parse().ok()).unwrap_or(SEED);
    let numbers = words.iter().enumerate().filter(|(i, _)| *i == 0 || words[i - 1] != "--seed");
    let frames = numbers.filter_map(|(_, word)| word.parse().ok()).next().unwrap_or(FRAMES);
    // Some parts only, or rows named by a word: `-- 200 --disturbed glare`.
    type Part = fn(usize, u64, Option<&str>) -> String;
    let parts: [(&str, &str, Part); 2] =
        [("--disturbed", "disturbed", disturbed_poses), ("--cold", "cold", cold_poses)];
    if let Some((option, part, write)) = parts.into_iter().find(|(option, ..)| words.iter().any(|word| word == option))
    {
        let wanted = after(option).filter(|wanted| wanted.parse::<usize>().is_err());
        let text = write(frames, seed, wanted.map(String::as_str));
        println!("{text}");
        if std::env::var("UPDATE_EXPECT").is_ok() && wanted.is_none() {
            page::write_to("pose-accuracy.md", part, &text);
        }
        return;
    }
    let documents = Documents::new();
    let mut all = Vec::new();
    for (number, cell) in CELLS.into_iter().enumerate() {
        eprintln!("{} …", cell.name);
        all.push(run(&documents, cell, frames, EVERY, seed + 1_000_000 * number as u64));
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
        page::write_to("pose-accuracy.md", "disturbed", &disturbed_poses(frames, seed, None));
        page::write_to("pose-accuracy.md", "cold", &cold_poses(frames, seed, None));
        page::write_to("pose.md", "thesis", &thesis::table());
    }
}
