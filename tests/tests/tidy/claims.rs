//! Checks statements of the documentation: features absent from the build, commands that need no service, the number
//! of shipped models.

use std::collections::BTreeSet;

use crate::examples::OFFLINE;
use crate::markdown::prose;
use crate::{File, expect_none, files};

/// The code spans of a paragraph or line.
fn code(text: &str) -> Vec<&str> {
    text.split('`').skip(1).step_by(2).collect()
}

/// Paths answered with 501, from the source of the routes.
fn absent(routes: &str) -> Vec<&str> {
    let lines = routes.lines().filter(|line| line.contains("absent("));
    lines.filter_map(|line| line.split("route(\"").nth(1)?.split('"').next()).collect()
}

/// Documented paths that are not answered with 501, and undocumented ones that are.
fn wrong_absence(page: &str, routes: &str) -> Vec<String> {
    let section = page.split("\n## ").find(|section| section.starts_with("Not in this build")).unwrap_or_default();
    let documented = code(section);
    let absent = absent(routes);
    let unknown =
        documented.iter().filter(|path| !absent.contains(path)).map(|path| format!("{path} is in this build"));
    let undocumented =
        absent.iter().filter(|path| !documented.contains(path)).map(|path| format!("{path} is not in this build"));
    unknown.chain(undocumented).collect()
}

/// Commands whose need of a service differs from the page's claim.
fn wrong_company(page: &str) -> Vec<String> {
    let Some((before, _)) = page.split_once(" need no service") else {
        return vec!["no sentence says which commands need no service".into()];
    };
    let documented: Vec<&str> = code(before.rsplit(". ").next().unwrap_or_default());
    let alone: Vec<&str> = OFFLINE.into_iter().filter(|command| !command.starts_with("--")).collect();
    let unknown = documented.iter().filter(|one| !alone.iter().any(|command| one.starts_with(command)));
    let undocumented = alone.iter().filter(|command| !documented.iter().any(|one| one.starts_with(**command)));
    let unknown = unknown.map(|one| format!("`{one}` needs a service"));
    unknown.chain(undocumented.map(|one| format!("`{one}` needs no service"))).collect()
}

/// Stated numbers of models, in digits or words, that differ from the number of documents.
fn wrong_numbers(document: &File, models: usize) -> Vec<String> {
    const WORDS: [&str; 11] =
        ["twenty", "thirty", "ten", "eleven", "twelve", "fifteen", "sixteen", "eighteen", "nineteen", "forty", "fifty"];
    let text = prose(&document.text).to_lowercase();
    let words: Vec<&str> = text.split(|c: char| !c.is_alphanumeric() && c != '-').filter(|w| !w.is_empty()).collect();
    let counts =
        words.windows(3).filter(|three| three[1..] == ["models", "are"] || three[1..] == ["shipped", "models"]);
    let wrong = counts.filter(|three| {
        let spelled = WORDS.iter().any(|word| three[0].starts_with(word));
        spelled || three[0].parse::<usize>().is_ok_and(|count| count != models)
    });
    wrong.map(|three| format!("{}: {}: there are {models}", document.path, three.join(" "))).collect()
}

/// Problem codes in the server's source.
fn problem_codes(source: &str) -> BTreeSet<&str> {
    let calls = ["Problem::new(", "Problem::conflict("].into_iter().flat_map(|head| source.split(head).skip(1));
    calls
        .filter_map(|call| {
            let (before, rest) = call.split_once('"')?;
            let is_second = before.matches(',').count() < 2;
            let is_status = is_second && before.chars().all(|c| c.is_alphanumeric() || "_:, \n".contains(c));
            is_status.then(|| rest.split('"').next().unwrap_or_default())
        })
        .collect()
}

/// Codes without a row, and rows without a code.
fn wrong_codes(page: &str, sources: &str) -> Vec<String> {
    let rows = page.lines().filter(|line| line.starts_with("| `")).filter_map(|line| code(line).first().copied());
    let (documented, made): (BTreeSet<&str>, _) = (rows.collect(), problem_codes(sources));
    let undocumented = made.difference(&documented).map(|code| format!("`{code}` has no row"));
    undocumented.chain(documented.difference(&made).map(|code| format!("no problem has the code `{code}`"))).collect()
}

#[test]
fn absent_features_are_documented() {
    let read = |path| files(&[path]).remove(0).text;
    expect_none("docs/api.md", &wrong_absence(&read("docs/api.md"), &read("server/src/http/routes/mod.rs")));
}

#[test]
fn problem_codes_are_documented() {
    let sources = files(&[".rs"]).into_iter().filter(|file| file.path.starts_with("server/src/"));
    let sources: String = sources.map(|file| file.text).collect();
    expect_none("docs/errors.md", &wrong_codes(&files(&["docs/errors.md"]).remove(0).text, &sources));
    let planted = "Problem::new(StatusCode::NOT_FOUND, \"lost\", text) Problem::conflict(\"in-use\", \"it is\") Problem::new(status, code, \"x\")";
    assert_eq!(wrong_codes("| `in-use` | 409 |\n| `old` | 404 |", planted).len(), 2);
}

#[test]
fn offline_commands_are_documented() {
    expect_none("docs/api.md", &wrong_company(&files(&["docs/api.md"]).remove(0).text));
}

#[test]
fn counts_of_shipped_models_are_right() {
    let is_shipped = |file: &File| file.path.starts_with("models/");
    let models = files(&[".toml"]).into_iter().filter(is_shipped).count();
    let found: Vec<String> = files(&[".md"]).iter().flat_map(|document| wrong_numbers(document, models)).collect();
    expect_none("numbers of models", &found);
}

#[test]
fn planted_faults_are_caught() {
    let routes = ".route(\"/a\", get(|| absent(\"a\")))\n.route(\"/b\", get(list))";
    let page = |documented: &str| format!("# x\n## Not in this build\n\n{documented}\n\n## y\n`/z`");
    assert!(wrong_absence(&page("`/a`"), routes).is_empty());
    assert_eq!(wrong_absence(&page("`/a`, `/b`"), routes).len(), 1);
    assert_eq!(wrong_absence(&page("nothing"), routes).len(), 1);
    let alone = "`model check`, `model explain`, `model export`, `fit`, `render`, `tune`, `compare`, `replay`, `token`, `config show`, \
                 `serve --check`, `completions`, `man`";
    assert_eq!(wrong_company(&format!("A `b`. {alone} need no service.\nB `c`")), ["`calibrate` needs no service"]);
    assert_eq!(wrong_company(&format!("{alone}, `calibrate colours` and `watch` need no service.")).len(), 1);
    assert_eq!(wrong_company("Nothing."), ["no sentence says which commands need no service"]);
    let counted = |text: &str| wrong_numbers(&File { path: "a.md".into(), text: text.into() }, 25).len();
    assert_eq!(
        ["Twenty models are shipped", "all 24 shipped models", "25 models are", "two models are"].map(counted),
        [1, 1, 0, 0]
    );
}
