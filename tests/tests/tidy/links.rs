//! Links of documents to files of the repository resolve.

use crate::markdown::prose;
use crate::{File, expect_none, files};

/// Targets of `[text](target)` and `![text](target)` outside code.
fn targets(text: &str) -> Vec<String> {
    let prose = prose(text);
    let starts = prose.match_indices("](").map(|(at, _)| at + 2);
    starts.filter_map(|at| prose[at..].split_once(')').map(|(target, _)| target.trim().to_string())).collect()
}

/// Resolves `../README.md` in `docs/api.md` to `README.md`; `None` outside the repository.
fn resolve(document: &str, target: &str) -> Option<String> {
    let mut parts: Vec<&str> = document.split('/').collect();
    parts.pop();
    for part in target.split('/') {
        match part {
            "" | "." => {}
            ".." => drop(parts.pop()?),
            name => parts.push(name),
        }
    }
    Some(parts.join("/"))
}

/// The anchor that a forge makes of a heading.
fn anchor(heading: &str) -> String {
    let kept = heading.trim().to_lowercase();
    kept.chars()
        .filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'))
        .map(|c| if c == ' ' { '-' } else { c })
        .collect()
}

fn has_anchor(text: &str, wanted: &str) -> bool {
    prose(text).lines().filter(|line| line.starts_with('#')).any(|line| anchor(line.trim_start_matches('#')) == wanted)
}

fn faults(document: &File, documents: &[File]) -> Vec<String> {
    let top = isophote_tests::repository();
    let mut found = Vec::new();
    for target in targets(&document.text) {
        if target.contains("://") || target.starts_with("mailto:") {
            continue;
        }
        let (file, heading) = target.split_once('#').unwrap_or((&target, ""));
        let path = if file.is_empty() { Some(document.path.clone()) } else { resolve(&document.path, file) };
        let exists = path.as_ref().is_some_and(|path| top.join(path).exists());
        let linked = documents.iter().find(|one| Some(&one.path) == path.as_ref());
        if !exists && linked.is_none() {
            found.push(format!("{}: no file {target}", document.path));
        } else if !heading.is_empty() && !linked.is_some_and(|linked| has_anchor(&linked.text, heading)) {
            found.push(format!("{}: no heading {target}", document.path));
        }
    }
    found
}

#[test]
fn links_find_their_files() {
    let documents = files(&[".md"]);
    let found: Vec<String> = documents.iter().flat_map(|document| faults(document, &documents)).collect();
    expect_none("links", &found);
}

#[test]
fn every_document_is_in_the_index() {
    let documents = files(&[".md"]);
    let index = documents.iter().find(|document| document.path == "docs/SUMMARY.md").unwrap();
    let linked: Vec<String> =
        targets(&index.text).iter().filter_map(|target| resolve(&index.path, target.split('#').next()?)).collect();
    let lonely = documents.iter().filter(|document| document.path.starts_with("docs/") && document.path != index.path);
    let found: Vec<String> =
        lonely.filter(|document| !linked.contains(&document.path)).map(|document| document.path.clone()).collect();
    expect_none("not in docs/SUMMARY.md", &found);
}

#[test]
fn planted_faults_are_caught() {
    let document = |text: &str| File { path: "docs/planted.md".into(), text: text.into() };
    let caught = |text: &str| faults(&document(text), &[document("# One heading, two")]).len();
    assert_eq!(caught("[gone](gone.md)"), 1);
    assert_eq!(caught("![gone](../pictures/gone.png)"), 1);
    assert_eq!(caught("[out](../../elsewhere.md)"), 1);
    assert_eq!(caught("[heading](planted.md#no-such-heading)"), 1);
    assert_eq!(caught("[heading](planted.md#one-heading-two) [here](../README.md) [net](https://example.org/x)"), 0);
    assert_eq!(caught("`[code](gone.md)`\n```sh\n[code](gone.md)\n```"), 0);
}
