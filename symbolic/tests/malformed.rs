//! Every document of tests/malformed/ is refused with a diagnostic that names the fault, its key and its place.
//!
//! A document's first lines say what is expected: `# code: unknown-name key: model.intensity`, one line a fault, in the
//! order of the document, and nothing beside them: no fault may hide another or draw one after it (in JSON documents `//`,
//! one line, blanked before parsing so that lines keep their numbers). `*` in a key stands for any text, a code of `*` for
//! any code.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::panic::catch_unwind;
use std::path::{Path, PathBuf};

use isophote_symbolic::{Diagnostic, Diagnostics, LIMITS, Model, Severity};

/// Characters of a message, so that no document can make the answer long.
const MESSAGE_CHARACTERS_MAX: usize = 400;

struct Expected {
    code: String,
    key: String,
}

fn documents() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/malformed");
    let mut files: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

fn expectations(text: &str) -> Vec<Expected> {
    let expectation = |line: &str| {
        let (code, key) = line.trim_start_matches(['#', '/']).trim().strip_prefix("code:")?.split_once("key:")?;
        Some(Expected { code: code.trim().into(), key: key.trim().into() })
    };
    text.lines().map_while(expectation).collect()
}

/// `pattern` with at most one `*`.
fn fits(pattern: &str, text: &str) -> bool {
    match pattern.split_once('*') {
        None => pattern == text,
        Some((head, tail)) => text.len() >= head.len() + tail.len() && text.starts_with(head) && text.ends_with(tail),
    }
}

fn read(path: &Path) -> (Vec<Expected>, Result<Model, Diagnostics>, String) {
    let text = fs::read_to_string(path).unwrap();
    let expected = expectations(&text);
    let json = path.extension().is_some_and(|extension| extension == "json");
    let blank = text.lines().next().map_or(0, str::len);
    let document = if json { " ".repeat(blank) + &text[blank..] } else { text };
    let result = if json { Model::from_json(&document) } else { Model::from_toml(&document) };
    (expected, result, document)
}

/// What is wrong with one diagnostic, whatever the document.
fn fault_of(diagnostic: &Diagnostic, document: &str) -> Option<String> {
    let lines = document.split('\n').count() as u32;
    let (start, end) = (diagnostic.span.start as usize, diagnostic.span.end as usize);
    let kebab = diagnostic.code.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-');
    let message = diagnostic.message.chars().count();
    let checks = [
        (kebab && !diagnostic.code.is_empty(), "code is a word of lower-case letters, digits and hyphens"),
        (message > 0 && message <= MESSAGE_CHARACTERS_MAX, "message is neither empty nor long"),
        (!diagnostic.message.contains(|c: char| c.is_control()), "message holds no control character"),
        (diagnostic.line >= 1 && diagnostic.line <= lines, "line is one of the document's"),
        (diagnostic.column >= 1, "column counts from 1"),
        (start <= end && end <= document.len(), "span lies in the document"),
        (!diagnostic.render("document").is_empty(), "it can be shown"),
    ];
    checks.iter().find(|(holds, _)| !holds).map(|(_, rule)| format!("broken: {rule}: {diagnostic:?}"))
}

#[test]
fn every_malformed_document_is_refused_where_its_fault_stands() {
    let files = documents();
    let mut wrong = Vec::new();
    for path in &files {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let Ok((expected, result, document)) = catch_unwind(|| read(path)) else {
            wrong.push(format!("{name}: panicked"));
            continue;
        };
        let Err(diagnostics) = result else {
            wrong.push(format!("{name}: accepted, expected {} faults", expected.len()));
            continue;
        };
        wrong.extend(diagnostics.iter().filter_map(|d| fault_of(d, &document)).map(|fault| format!("{name}: {fault}")));
        let errors: Vec<&Diagnostic> = diagnostics.iter().filter(|d| d.severity == Severity::Error).collect();
        let is_named = |(e, d): (&Expected, &&Diagnostic)| fits(&e.code, &d.code) && fits(&e.key, &d.key);
        if errors.len() != expected.len() || !expected.iter().zip(&errors).all(is_named) {
            let got: Vec<String> = errors.iter().map(|d| format!("{} at `{}`: {}", d.code, d.key, d.message)).collect();
            let wanted: Vec<String> = expected.iter().map(|e| format!("{} at `{}`", e.code, e.key)).collect();
            wrong.push(format!("{name}: expected {wanted:?}, got {got:#?}"));
        }
    }
    assert!(wrong.is_empty(), "{} of {} documents:\n{}", wrong.len(), files.len(), wrong.join("\n"));
}

#[test]
fn there_are_at_least_100_and_each_says_what_is_expected() {
    let files = documents();
    assert!(files.len() >= 100, "{} documents", files.len());
    for path in files {
        assert!(!expectations(&fs::read_to_string(&path).unwrap()).is_empty(), "{} says nothing", path.display());
    }
}

/// A near miss is answered with the name that was meant.
#[test]
fn near_misses_name_what_was_meant() {
    let meant = [
        ("unknown-name-in-intensity.toml", "v1"),
        ("unknown-name-in-domain.toml", "s"),
        ("unknown-name-in-noise.toml", "read_noise"),
        ("unknown-estimator-near-miss.toml", "centroid.x"),
        ("unknown-method.toml", "newton"),
        ("unknown-parameter-in-stage.toml", "by"),
        ("unknown-parameter-in-roles.toml", "bx"),
        ("key-unknown-at-the-top.toml", "parameters"),
        ("key-unknown-in-model.toml", "observed"),
        ("key-unknown-in-stage.toml", "iterations"),
        ("key-unknown-in-roles.toml", "centre"),
    ];
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/malformed");
    for (name, word) in meant {
        let (_, result, _) = read(&folder.join(name));
        let diagnostics = result.map(|_| ()).unwrap_err();
        let texts: Vec<String> =
            diagnostics.iter().map(|d| format!("{} {}", d.message, d.help.clone().unwrap_or_default())).collect();
        let named = |t: &String| t.contains(&format!("`{word}`")) || t.contains(&format!("\"{word}\""));
        assert!(texts.iter().any(named), "{name} does not name `{word}`: {texts:?}");
    }
}

/// The one limit that is too long for a file: the document's own size, at −1, 0 and +1.
#[test]
fn a_document_ends_at_its_limit() {
    let model = "name = \"m\"\ncoordinates = [\"x\"]\nchannels = [\"y\"]\nparameters = { v = { start = 1.0 } }\nmodel = { intensity = \"v\" }\n#";
    let document = |bytes: usize| model.to_string() + &"1".repeat(bytes - model.len());
    assert!(Model::from_toml(&document(LIMITS.document_bytes - 1)).is_ok());
    assert!(Model::from_toml(&document(LIMITS.document_bytes)).is_ok());
    let diagnostics = Model::from_toml(&document(LIMITS.document_bytes + 1)).map(|_| ()).unwrap_err();
    assert_eq!(diagnostics[0].code, "limit", "{diagnostics:?}");
    // What is no number has a limit of its own.
    let wordy = |words: usize, word: &str| model.to_string() + &word.repeat(words);
    for word in ["x", "-", "[", "e"] {
        assert!(Model::from_toml(&wordy(LIMITS.text_bytes - model.len(), word)).is_ok(), "{word}");
        let diagnostics = Model::from_toml(&wordy(LIMITS.text_bytes + 1, word)).map(|_| ()).unwrap_err();
        assert_eq!(diagnostics[0].code, "limit", "{word}: {diagnostics:?}");
    }
}

/// The comparison of this file catches a planted fault.
#[test]
fn patterns_fit_and_do_not_fit() {
    assert!(fits("*", "model.intensity") && fits("definitions.*", "definitions.q") && fits("a[*].b", "a[0].b"));
    assert!(!fits("definitions.*", "model.q") && !fits("name", "names") && !fits("ab*bc", "abc"));
}
