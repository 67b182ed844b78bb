//! Rules that no compiler checks: dependencies between crates, forbidden words, licences, links, and that the commands
//! of README.md and docs/ run. Each check must detect a planted fault.
#![allow(clippy::unwrap_used)]

mod claims;
mod dependencies;
mod estimates;
mod examples;
mod figures;
mod folders;
mod imports;
mod language;
mod links;
mod markdown;
mod mentions;
mod packages;
mod sources;

use std::path::PathBuf;

/// A file of the repository: its path from the root, with `/`, and its text.
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
