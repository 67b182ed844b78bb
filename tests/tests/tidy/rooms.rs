//! Which folders a crate's source has, in which order they may import each other, and how large the core is.

use std::collections::BTreeSet;

use crate::imports::{Crate, crates};
use crate::sources::{code_only, lines_of_tests};
use crate::{File, expect_none, files};

/// The rooms of a crate: folders, and files beside them.
struct Rooms {
    source: &'static str,
    folders: &'static [&'static str],
    /// Plain data that several rooms share; no others.
    files: &'static [&'static str],
}

const ROOMS: [Rooms; 2] = [
    Rooms { source: "symbolic/src/", folders: &["derive", "language", "program", "proof"], files: &["lib.rs"] },
    Rooms {
        source: "tracker/src/",
        folders: &["camera", "exposure", "pose", "preview", "report", "sight", "solve", "track", "tune", "verdict"],
        files: &[
            "budget.rs",
            "estimate.rs",
            "least_squares.rs",
            "lib.rs",
            "options.rs",
            "outline.rs",
            "picture.rs",
            "scaled.rs",
        ],
    },
];

/// The rooms of symbolic from the ground up: each may import those before it.
const ORDER: [&str; 4] = ["program", "language", "proof", "derive"];
/// Lines of symbolic/src, tests left out: this becomes less, but for what it can do that it could not before (last, exponentials on
/// wide pictures, and work that grows with the square of a document).
const CORE_LINES_MAX: usize = 14_990;

/// What a room holds that it should not, or lacks.
fn strangers(rooms: &Rooms, files: &[File]) -> Vec<String> {
    let inside = files.iter().filter_map(|file| file.path.strip_prefix(rooms.source));
    let found: BTreeSet<&str> = inside.map(|path| path.split_once('/').map_or(path, |(folder, _)| folder)).collect();
    let wanted: BTreeSet<&str> = rooms.folders.iter().chain(rooms.files).copied().collect();
    found.symmetric_difference(&wanted).map(|name| format!("{}{name}", rooms.source)).collect()
}

/// Imports of symbolic against the order of its rooms.
fn upward(symbolic: &Crate) -> Vec<String> {
    let place = |module: &[String]| ORDER.iter().position(|room| module.first().is_some_and(|first| first == room));
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
fn crates_have_the_rooms_of_the_map() {
    let sources = files(&[".rs"]);
    let found: Vec<String> = ROOMS.iter().flat_map(|rooms| strangers(rooms, &sources)).collect();
    expect_none("rooms", &found);
}

#[test]
fn rooms_of_symbolic_import_those_below() {
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
    let rooms = ["derive/a.rs", "language/mod.rs", "program/a.rs", "proof/a.rs", "lib.rs"].map(|path| file(path, ""));
    assert_eq!(strangers(&ROOMS[0], &rooms), Vec::<String>::new());
    assert_eq!(strangers(&ROOMS[0], &rooms[1..]), ["symbolic/src/derive"]);
    let more: Vec<File> = rooms.into_iter().chain([file("shelf.rs", ""), file("attic/a.rs", "")]).collect();
    assert_eq!(strangers(&ROOMS[0], &more), ["symbolic/src/attic", "symbolic/src/shelf.rs"]);
    let order = [
        file("program/a.rs", "use crate::language::model::Model;"),
        file("language/model.rs", "use crate::program::a::A;"),
    ];
    assert_eq!(upward(&Crate::of("symbolic/src/", &order)), ["program/a imports language/model"]);
    let inner = "one\ntwo\n#[cfg(test)]\nmod tests {\n    three {}\n}\nfour\n";
    assert_eq!(core_lines(&[file("a.rs", inner), file("a_tests.rs", "five\n")]), 3);
}
