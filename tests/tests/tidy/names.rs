//! One word for one thing: no two files define types of one name, and no public function is told by `true` and `false`.

use std::collections::{BTreeMap, BTreeSet};

use crate::sources::{code_only, without_tests};
use crate::{File, expect_none, files};

/// What is shipped; benchmarks and tests name their own things.
const SHIPPED: [&str; 12] = [
    "symbolic/elementary/src/",
    "symbolic/src/",
    "symbolic/export/src/",
    "symbolic/notation/src/",
    "jit/src/",
    "tracker/frame/src/",
    "tracker/src/",
    "capture/src/",
    "server/src/",
    "server/wire/src/",
    "server/machine/src/",
    "client/src/",
];

/// The word behind each of `heads` where it begins a word of the code, with all that stands behind it.
fn behind<'a>(code: &'a str, head: &'a str) -> impl Iterator<Item = (&'a str, &'a str, &'a str)> {
    let starts =
        code.match_indices(head).filter(|(at, _)| !code[..*at].ends_with(|c: char| c.is_alphanumeric() || c == '_'));
    starts.filter_map(move |(at, _)| {
        let rest = &code[at + head.len()..];
        let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_')?;
        let line = code[..at].rsplit('\n').next().unwrap_or_default();
        (end > 0).then_some((line, &rest[..end], &rest[end..]))
    })
}

/// Types that others than their file may name.
fn public_types(code: &str) -> BTreeSet<&str> {
    let heads = ["struct ", "enum ", "trait ", "union ", "type "];
    let of = |head| behind(code, head).filter(|(line, ..)| line.trim_start().starts_with("pub"));
    heads.into_iter().flat_map(of).map(|(_, name, _)| name).collect()
}

/// Names with the files that define a type of it, where there are several.
fn shared_names(files: &[(String, String)]) -> BTreeMap<String, Vec<&str>> {
    let mut places: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    for (path, code) in files {
        public_types(code).into_iter().for_each(|name| places.entry(name.to_string()).or_default().push(path));
    }
    places.retain(|_, paths| paths.len() > 1);
    places
}

/// Public functions that take a `bool`.
fn told(code: &str) -> Vec<&str> {
    let is_public = |line: &str| line.trim_start().starts_with("pub");
    let parameters = |rest: &str| -> String {
        let open = rest.find('(').unwrap_or(0);
        let mut depth = 0;
        let inside = |c: &char| {
            depth += i32::from(*c == '(') - i32::from(*c == ')');
            depth > 0
        };
        rest[open..].chars().take_while(inside).filter(|c| !c.is_whitespace()).collect()
    };
    let functions = behind(code, "fn ").filter(|(line, ..)| is_public(line));
    functions
        .filter(|(.., rest)| parameters(rest).split(',').any(|one| one.ends_with(":bool")))
        .map(|(_, name, _)| name)
        .collect()
}

fn shipped() -> Vec<(String, String)> {
    let is_shipped =
        |file: &File| SHIPPED.iter().any(|folder| file.path.starts_with(folder)) && !file.path.contains("tests");
    let code = |file: File| (file.path, without_tests(&code_only(&file.text)));
    files(&[".rs"]).into_iter().filter(is_shipped).map(code).collect()
}

#[test]
fn a_type_has_a_name_of_its_own() {
    let shipped = shipped();
    let found: Vec<String> =
        shared_names(&shipped).iter().map(|(name, paths)| format!("{name}: {}", paths.join(", "))).collect();
    expect_none("names of several things", &found);
}

#[test]
fn public_functions_take_no_truth_values() {
    let shipped = shipped();
    let found =
        shipped.iter().flat_map(|(path, code)| told(code).into_iter().map(move |name| format!("{path}: {name}")));
    expect_none("functions told by true and false", &found.collect::<Vec<_>>());
}

#[test]
fn planted_faults_are_caught() {
    let file = |path: &str, code: &str| (path.to_string(), code.to_string());
    let shared = |a: &str, b: &str| shared_names(&[file("a.rs", a), file("b.rs", b)]).into_keys().collect::<Vec<_>>();
    assert_eq!(shared("pub struct Light {}", "pub(crate) enum Light { On }"), ["Light"]);
    assert_eq!(shared("pub struct Light {}", "struct Light;\npub struct Lights;"), Vec::<String>::new());
    assert_eq!(told("pub fn f(&self, a: u8, b: bool) {}"), ["f"]);
    assert_eq!(told("    pub(crate) async fn f<A: Into<B>>(\n        a: A,\n        b: bool,\n    ) {}"), ["f"]);
    assert_eq!(told("fn f(a: bool) {}\npub fn g(a: &dyn Fn(u8) -> bool) -> bool {}"), Vec::<&str>::new());
}
