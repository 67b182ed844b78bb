//! The house rules as tests: who may depend on whom, what may stand in which folder, how long a file is, and that what
//! README.md and docs/ show really runs. Each checker is shown a planted fault that it must catch.
#![allow(clippy::unwrap_used)]

mod claims;
mod dependencies;
mod estimates;
mod examples;
mod figures;
mod imports;
mod language;
mod links;
mod markdown;
mod mentions;
mod names;
mod packages;
mod rooms;
mod sources;

use std::path::PathBuf;

/// A file of the repository as its path from the top, with `/`, and its text.
struct File {
    path: String,
    text: String,
}

/// The repository's text files whose names end in one of `endings`, in name order.
fn files(endings: &[&str]) -> Vec<File> {
    let top = isophote_tests::repository();
    let mut paths: Vec<PathBuf> = Vec::new();
    isophote_tests::files_below(&top, &mut paths).unwrap();
    let relative = |path: &PathBuf| path.strip_prefix(&top).unwrap().to_string_lossy().replace('\\', "/");
    let wanted = paths.iter().filter(|path| endings.iter().any(|ending| path.to_string_lossy().ends_with(ending)));
    wanted.map(|path| File { path: relative(path), text: std::fs::read_to_string(path).unwrap() }).collect()
}

/// Fails with all findings at once.
fn expect_none(what: &str, findings: &[String]) {
    assert!(findings.is_empty(), "{what}:\n  {}", findings.join("\n  "));
}
