//! The tables of docs/model-language.md match the code: limits, and the codes of malformed documents.

use std::collections::BTreeSet;

use isophote_symbolic::LIMITS;

use crate::{expect_none, files};

/// The cells of table rows whose first cell is `code`.
fn rows(document: &str, heading: &str) -> Vec<Vec<String>> {
    let section = document.split("\n## ").find(|section| section.starts_with(heading)).unwrap_or_default();
    let lines = section.lines().filter(|line| line.starts_with("| `"));
    lines
        .map(|line| line.trim_matches('|').split('|').map(|cell| cell.trim().trim_matches('`').to_string()).collect())
        .collect()
}

fn page() -> String {
    files(&["docs/model-language.md"]).remove(0).text
}

#[test]
fn documented_limits_are_in_force() {
    let shown: BTreeSet<String> = rows(&page(), "Limits").iter().map(|row| format!("{}: {}", row[0], row[1])).collect();
    let debug = format!("{LIMITS:?},{:?}", isophote_jit::LIMITS)
        .replace("KernelLimits {", "")
        .replace("Limits {", "")
        .replace('}', "");
    let in_force: BTreeSet<String> = debug.split(',').map(|field| field.trim().to_string()).collect();
    assert_eq!(shown, in_force);
}

#[test]
fn documented_codes_match_the_malformed_documents() {
    let shown: BTreeSet<String> = rows(&page(), "Errors").into_iter().map(|row| row[0].clone()).collect();
    let documents: Vec<_> =
        files(&[".toml", ".json"]).into_iter().filter(|file| file.path.starts_with("tests/malformed/")).collect();
    let code =
        |text: &str| text.split("code:").nth(1).and_then(|rest| rest.split_whitespace().next().map(String::from));
    let given: BTreeSet<String> =
        documents.iter().filter_map(|file| code(&file.text)).filter(|code| code != "*").collect();
    let missing: Vec<String> = shown.symmetric_difference(&given).cloned().collect();
    expect_none("codes in only one of the two", &missing);
}
