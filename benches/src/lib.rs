//! What the benchmarks share; they stand in `benches/`.
//!
//! What comes in: shipped models and frames made here. What goes out: tables on standard output, and those of pages of docs/.
//! Three rooms that import nothing of each other: [`flops`] counts, [`speed`] takes the time, [`accuracy`] says how right answers
//! are. Two more take the time of whole frames of accuracy's scenes: [`tracked`] beside a pass of our own, [`peers`] beside other
//! libraries. [`bodies`] makes the loops that the first two compare, [`page`] and [`plot`] are what all write with.
#![allow(clippy::unwrap_used)] // a benchmark may stop where a model is faulty

pub mod accuracy;
pub mod bodies;
pub mod flops;
pub mod page;
pub mod peers;
pub mod plot;
pub mod speed;
pub mod tracked;

use std::time::Instant;

/// Microseconds: median, minimum, maximum over `runs`, after one that is not counted.
pub fn time(runs: usize, mut f: impl FnMut()) -> [f64; 3] {
    f();
    let once = |f: &mut dyn FnMut()| {
        let start = Instant::now();
        f();
        start.elapsed().as_secs_f64() * 1e6
    };
    let mut all: Vec<f64> = (0..runs).map(|_| once(&mut f)).collect();
    all.sort_by(f64::total_cmp);
    [all[runs / 2], all[0], all[runs - 1]]
}

/// The document of a shipped model.
pub fn text(name: &str) -> String {
    std::fs::read_to_string(format!("{}/../models/{name}.toml", env!("CARGO_MANIFEST_DIR"))).unwrap()
}

/// The document of `spot` with that profile in the place of its own.
pub fn edited(formula: &str) -> String {
    let is_kept = |line: &&str| !["k1 ", "k2 ", "k = "].iter().any(|start| line.starts_with(start));
    let of = |line: &str| if line.starts_with("f = ") { format!("f = \"{formula}\"") } else { line.to_string() };
    text("spot").lines().filter(is_kept).map(of).collect::<Vec<String>>().join("\n")
}

/// The shipped models, by name.
pub fn shipped() -> Vec<String> {
    let folder = std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../models")).unwrap();
    let file_stem = |entry: std::io::Result<std::fs::DirEntry>| {
        let path = entry.unwrap().path();
        let document = path.extension().is_some_and(|extension| extension == "toml");
        document.then(|| path.file_stem().unwrap().to_string_lossy().into_owned())
    };
    let mut names: Vec<String> = folder.filter_map(file_stem).collect();
    names.sort();
    names
}
