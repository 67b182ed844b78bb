//! The folders of a crate's source, the order of their imports, and the size of the core.

use std::collections::BTreeSet;

use crate::imports::{Crate, crates};
use crate::sources::{code_only, lines_of_tests};
use crate::{File, expect_none, files};

/// The folders of a crate, and the files beside them.
struct CrateFolders {
    source: &'static str,
    folders: &'static [&'static str],
    /// Plain data shared by several folders; no other files.
    files: &'static [&'static str],
}

const CRATES: [CrateFolders; 2] = [
    CrateFolders {
        source: "symbolic/src/",
        folders: &["derive", "graph", "language", "likelihood", "model", "objective", "program", "proof", "schedule"],
        files: &["lib.rs"],
    },
    CrateFolders {
        source: "tracker/src/",
        folders: &["camera", "exposure", "pose", "preview", "report", "sight", "solve", "track", "tune", "verdict"],
        files: &[
            "budget.rs",
            "estimate.rs",
            "least_squares.rs",
            "lib.rs",
            "options.rs",
            "outline.rs",
            "photometry.rs",
            "picture.rs",
            "scaled.rs",
            "statistics.rs",
        ],
    },
];

/// The folders of symbolic from the bottom up: each may import those before it.
const ORDER: [&str; 9] =
    ["program", "graph", "model", "language", "likelihood", "schedule", "derive", "proof", "objective"];
/// Maximum lines of symbolic/src without tests. Raised only for new features (last: exponentials on wide pictures, and
/// work that grows with the square of a document).
const CORE_LINES_MAX: usize = 14_920;

/// Unexpected and missing entries of a crate.
fn unexpected(crate_folders: &CrateFolders, files: &[File]) -> Vec<String> {
    let inside = files.iter().filter_map(|file| file.path.strip_prefix(crate_folders.source));
    let found: BTreeSet<&str> = inside.map(|path| path.split_once('/').map_or(path, |(folder, _)| folder)).collect();
    let wanted: BTreeSet<&str> = crate_folders.folders.iter().chain(crate_folders.files).copied().collect();
    found.symmetric_difference(&wanted).map(|name| format!("{}{name}", crate_folders.source)).collect()
}

/// Imports in symbolic against the order of its folders.
fn upward(symbolic: &Crate) -> Vec<String> {
    let place = |module: &[String]| ORDER.iter().position(|folder| module.first().is_some_and(|first| first == folder));
    let mut found = Vec::new();
    for (module, others) in symbolic.imports() {
        for other in others {
            let (Some(from), Some(to)) = (place(&module), place(&other)) else { continue };
            if to > from {
                found.push(format!("{} imports {}", module.join("/"), other.join("/")));
            }
        }
    }
    found
}

fn core_lines(files: &[File]) -> usize {
    let core = files.iter().filter(|file| file.path.starts_with("symbolic/src/") && !file.path.contains("tests"));
    core.map(|file| file.text.lines().count() - lines_of_tests(&code_only(&file.text))).sum()
}

#[test]
fn crates_have_the_mapped_folders() {
    let sources = files(&[".rs"]);
    let found: Vec<String> = CRATES.iter().flat_map(|crate_folders| unexpected(crate_folders, &sources)).collect();
    expect_none("folders", &found);
}

#[test]
fn folders_of_symbolic_import_lower_ones() {
    expect_none("imports", &upward(&crates(&files(&[".rs"]))["symbolic"]));
}

#[test]
fn the_core_stays_small() {
    let lines = core_lines(&files(&[".rs"]));
    assert!(lines <= CORE_LINES_MAX, "symbolic/src has {lines} lines without tests, {CORE_LINES_MAX} at most");
}

#[test]
fn planted_faults_are_caught() {
    let file = |path: &str, text: &str| File { path: format!("symbolic/src/{path}"), text: text.into() };
    let tree: Vec<File> =
        ORDER.iter().map(|folder| file(&format!("{folder}/a.rs"), "")).chain([file("lib.rs", "")]).collect();
    assert_eq!(unexpected(&CRATES[0], &tree), Vec::<String>::new());
    assert_eq!(unexpected(&CRATES[0], &tree[1..]), ["symbolic/src/program"]);
    let more: Vec<File> = tree.into_iter().chain([file("shelf.rs", ""), file("attic/a.rs", "")]).collect();
    assert_eq!(unexpected(&CRATES[0], &more), ["symbolic/src/attic", "symbolic/src/shelf.rs"]);
    let order = [
        file("program/a.rs", "use crate::language::model::Model;"),
        file("language/model.rs", "use crate::program::a::A;"),
    ];
    assert_eq!(upward(&Crate::of("symbolic/src/", &order)), ["program/a imports language/model"]);
    let inner = "one\ntwo\n#[cfg(test)]\nmod tests {\n    three {}\n}\nfour\n";
    assert_eq!(core_lines(&[file("a.rs", inner), file("a_tests.rs", "five\n")]), 3);
}
