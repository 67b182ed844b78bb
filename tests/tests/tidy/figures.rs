//! No stale figures: a measured page names its shipped documents by digest (`<!-- measured with NAME DIGEST -->`), and
//! states where one has changed since (`…, before it changed -->`, and a sentence with "has changed since").

use isophote_symbolic::Model;

use crate::{File, expect_none, files};

/// Pages whose tables name shipped documents.
const MEASURED: [&str; 4] = ["docs/accuracy.md", "docs/confidence.md", "docs/real.md", "docs/speed.md"];
/// Digits of a digest on a page.
const DIGITS: usize = 16;

/// Faults of a page's marks; `digest` looks up the current documents.
fn faults(page: &File, digest: impl Fn(&str) -> Option<String>) -> Vec<String> {
    let marks: Vec<&str> =
        page.text.lines().filter_map(|line| line.strip_prefix("<!-- measured with ")?.strip_suffix(" -->")).collect();
    let mut found = Vec::new();
    if marks.is_empty() {
        found.push(format!("{}: says of no document with which digest it was measured", page.path));
    }
    for mark in marks {
        let (mark, is_old) = mark.strip_suffix(", before it changed").map_or((mark, false), |mark| (mark, true));
        let (name, measured) = mark.split_once(' ').unwrap_or((mark, ""));
        let today = digest(name).unwrap_or_default();
        let says_so = page.text.contains(&format!("**`{name}` has changed since"));
        let problem = match (today.starts_with(measured) && measured.len() == DIGITS, is_old) {
            (true, false) => continue,
            (false, true) if says_so => continue,
            (false, true) => "has changed since, and no sentence says so",
            (true, true) => "is marked as changed, and has not",
            (false, false) => "has changed since: measure again, or say so",
        };
        let today = today.get(..DIGITS).unwrap_or("not shipped");
        found.push(format!("{}: {name} {problem} (today {today})", page.path));
    }
    found
}

#[test]
fn figures_match_the_shipped_documents() {
    let documents = files(&[".toml"]);
    let digest = |name: &str| {
        let document = documents.iter().find(|file| file.path == format!("models/{name}.toml"))?;
        let model = Model::from_toml(&document.text).unwrap();
        Some(model.digest().trim_start_matches("sha256:").to_string())
    };
    let pages = files(&[".md"]).into_iter().filter(|page| MEASURED.contains(&page.path.as_str()));
    let found: Vec<String> = pages.flat_map(|page| faults(&page, digest)).collect();
    expect_none("figures", &found);
}

#[test]
fn planted_faults_are_caught() {
    let digest = |name: &str| (name == "spot").then(|| "0123456789abcdef99".to_string());
    let caught = |text: &str| faults(&File { path: "a.md".into(), text: text.into() }, digest).len();
    let (same, other) =
        ("<!-- measured with spot 0123456789abcdef -->\n", "<!-- measured with spot 1123456789abcdef -->\n");
    assert_eq!([caught(same), caught(other), caught("no mark")], [0, 1, 1]);
    assert_eq!(caught("<!-- measured with spot 0123 -->"), 1);
    assert_eq!(caught("<!-- measured with none 0123456789abcdef -->"), 1);
    let old = other.replace(" -->", ", before it changed -->");
    assert_eq!((caught(&old), caught(&(old.clone() + "**`spot` has changed since**"))), (1, 0));
    assert_eq!(caught(&same.replace(" -->", ", before it changed -->")), 1);
}
