//! docs/estimates.md names all fields of an estimate, states, endings and rejections, and nothing else.

use std::collections::BTreeSet;

use crate::{expect_none, files};

/// The code words that begin the rows of a section's table.
fn rows(page: &str, heading: &str) -> BTreeSet<String> {
    let section = page.split("\n## ").find(|section| section.starts_with(heading)).unwrap_or_default();
    let cells = section.lines().filter_map(|line| line.strip_prefix("| `")?.split('`').next());
    cells.map(String::from).collect()
}

/// The lines between `head` and its closing brace, without comments and attributes.
fn body<'a>(source: &'a str, head: &str) -> Vec<&'a str> {
    let inside = source.split(head).nth(1).and_then(|rest| rest.split("\n}").next()).unwrap_or_default();
    inside.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with(['/', '#'])).collect()
}

/// Names of public fields.
fn fields(source: &str, head: &str) -> BTreeSet<String> {
    body(source, head)
        .iter()
        .filter_map(|line| line.strip_prefix("pub ")?.split(':').next())
        .map(String::from)
        .collect()
}

/// Names of variants in JSON: `SmallStep` is `small-step`.
fn variants(source: &str, head: &str) -> BTreeSet<String> {
    let kebab = |name: &str| {
        let mut text = String::new();
        for c in name.chars() {
            if c.is_uppercase() && !text.is_empty() {
                text.push('-');
            }
            text.extend(c.to_lowercase());
        }
        text
    };
    body(source, head).iter().map(|line| kebab(line.trim_end_matches(','))).collect()
}

#[test]
fn the_page_names_all_fields_of_an_estimate() {
    let read = |path: &str| files(&[path]).into_iter().find(|file| file.path == path).unwrap().text;
    let (page, wire, tracker) =
        (read("docs/estimates.md"), read("server/wire/src/estimate.rs"), read("tracker/src/estimate.rs"));
    let pairs = [
        ("Fields", fields(&wire, "pub struct EstimateView {")),
        ("States", variants(&tracker, "pub enum TrackState {")),
        ("Endings", variants(&tracker, "pub enum Ending {")),
        ("Rejections", variants(&tracker, "pub enum Rejection {")),
    ];
    for (heading, known) in pairs {
        assert!(known.len() > 3, "{heading}: {known:?}");
        let missing: Vec<String> = rows(&page, heading).symmetric_difference(&known).cloned().collect();
        expect_none(&format!("{heading}, in only one of page and source"), &missing);
    }
}

#[test]
fn pages_and_sources_are_parsed() {
    let page = "# x\n\n## Fields\n\n| field | |\n|---|---|\n| `a` | `b` |\n\n## States\n\n| `c` | |\n";
    assert_eq!(rows(page, "Fields"), BTreeSet::from(["a".to_string()]));
    let source = "pub struct S {\n    /// One.\n    pub a: u8,\n    #[serde(default)]\n    pub b_px: f64,\n}\npub enum E {\n    OneTwo,\n    /// Three.\n    Three,\n}\n";
    assert_eq!(fields(source, "pub struct S {"), BTreeSet::from(["a".to_string(), "b_px".to_string()]));
    assert_eq!(variants(source, "pub enum E {"), BTreeSet::from(["one-two".to_string(), "three".to_string()]));
}
