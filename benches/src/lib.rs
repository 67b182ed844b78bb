//! Common code of the benchmarks in `benches/`, which print tables and write those of docs/.
//!
//! Three independent modules: [`flops`] counts, [`speed`] measures time, [`accuracy`] measures errors. Two more time
//! whole frames of accuracy's scenes: [`tracked`] relative to one pass of a kernel, [`peers`] against other libraries.
//! [`bodies`] makes the loops that the first two compare, [`page`] and [`plot`] write pages and figures.
#![allow(clippy::unwrap_used)] // benchmarks may panic on a faulty model

pub mod accuracy;
pub mod bodies;
pub mod flops;
pub mod page;
pub mod peers;
pub mod plot;
pub mod speed;
pub mod tracked;

use std::time::Instant;

/// Microseconds: median, minimum, maximum over `runs`, after a warm-up run.
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

/// The document of `spot` with another profile.
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
