//! Files, commands, options and routes named in README.md, ARCHITECTURE.md and docs/ exist: paths in the repository,
//! commands and options in docs/cli.md, routes in docs/openapi.json, which other tests compare with the program.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;

use crate::markdown::{blocks, spans};
use crate::{File, expect_none, files};

/// Extensions of source files, which may be named without a folder.
const SOURCES: [&str; 4] = [".rs", ".ts", ".py", ".c"];
/// Prefixes of system paths.
const SYSTEM: [&str; 5] = ["/dev", "/etc", "/srv", "/usr", "/var"];
/// The service's address in the documentation.
const SERVICE: &str = "http://127.0.0.1:7240";

/// Existing names.
struct Names {
    /// Files and folders, from the repository root.
    paths: BTreeSet<String>,
    /// Options by command, whose words are separated by a space; `` is the program itself.
    commands: BTreeMap<String, BTreeSet<String>>,
    /// Methods by route.
    routes: BTreeMap<String, BTreeSet<String>>,
}

impl Names {
    fn of_the_repository() -> Names {
        let (top, mut all) = (isophote_tests::repository(), Vec::new());
        isophote_tests::files_below(&top, &mut all).unwrap();
        let mut paths = BTreeSet::new();
        for path in &all {
            let relative = path.strip_prefix(&top).unwrap();
            paths.extend(relative.ancestors().map(|one| one.to_string_lossy().into_owned()));
        }
        let read = |path: &str| std::fs::read_to_string(top.join(path)).unwrap();
        let commands = commands(&read("docs/cli.md"));
        Names { paths, commands, routes: routes(&serde_json::from_str(&read("docs/openapi.json")).unwrap()) }
    }

    /// The longest command that the words begin with, and its number of words.
    fn command(&self, words: &[&str]) -> (usize, &BTreeSet<String>) {
        let longest =
            (0..=words.len()).rev().find_map(|count| Some((count, self.commands.get(&words[..count].join(" "))?)));
        longest.unwrap()
    }

    fn has_folder(&self, name: &str) -> bool {
        self.paths.iter().any(|path| path.starts_with(&format!("{name}/")))
    }

    /// Whether some file or folder has this suffix, with or without `.rs`.
    fn ends_so(&self, name: &str) -> bool {
        let is_it = |path: &str| path == name || path.ends_with(&format!("/{name}"));
        self.paths.iter().any(|path| is_it(path) || path.strip_suffix(".rs").is_some_and(is_it))
    }
}

/// The options of each section of docs/cli.md.
fn commands(page: &str) -> BTreeMap<String, BTreeSet<String>> {
    let mut commands: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for section in page.split("\n## isophote").skip(1) {
        let (name, help) = section.split_once('\n').unwrap();
        let lines = help.lines().map(str::trim_start).filter(|line| line.starts_with('-'));
        let names = lines.flat_map(|line| line.split([' ', ',', '=']).take(3)).filter(|word| word.starts_with("--"));
        commands.insert(name.trim().to_string(), names.map(String::from).collect());
    }
    commands
}

/// The methods of each route of docs/openapi.json.
fn routes(document: &Value) -> BTreeMap<String, BTreeSet<String>> {
    let methods = |route: &Value| route.as_object().unwrap().keys().map(|method| method.to_uppercase()).collect();
    document["paths"].as_object().unwrap().iter().map(|(path, route)| (path.clone(), methods(route))).collect()
}

/// Whether a path matches a route: `{name}` matches any segment.
fn is_of(route: &str, path: &str) -> bool {
    let (route, path): (Vec<&str>, Vec<&str>) = (route.split('/').collect(), path.split('/').collect());
    let is_name = |name: &str| match name.strip_prefix('{') {
        Some(rest) => rest.ends_with('}'),
        None => !name.is_empty() && !name.contains(':'),
    };
    let same = |(one, found): (&&str, &&str)| match one.split_once('}') {
        Some((_, verb)) => found.strip_suffix(verb).is_some_and(is_name),
        None => one == found,
    };
    route.len() == path.len() && route.iter().zip(&path).all(same)
}

/// Code of a document: code spans, and command lines with continuations joined.
fn code(document: &File) -> Vec<String> {
    let commands = blocks(&document.text)
        .into_iter()
        .filter(|block| matches!(block.words.first().map(String::as_str), Some("sh" | "text")));
    let lines =
        commands.flat_map(|block| block.text.replace("\\\n", " ").lines().map(String::from).collect::<Vec<_>>());
    spans(&document.text).into_iter().chain(lines.filter(|line| line.starts_with("isophote "))).collect()
}

/// Whether a word is a placeholder: `NAME`, `…`.
fn is_placeholder(word: &str) -> bool {
    word.chars().any(|c| c.is_uppercase() || "…*<>{}$=~".contains(c))
}

/// Faults of the command and options of a code span that calls `isophote`.
fn wrong_command(code: &str, names: &Names) -> Vec<String> {
    let words = code.split(" #").next().unwrap_or_default().split_whitespace();
    let words: Vec<&str> = words.skip_while(|word| word.contains('=') && !word.starts_with('-')).collect();
    let words = words.split(|word| matches!(*word, "|" | ">" | "&&" | "--")).next().unwrap_or_default();
    let Some(first) = words.first() else { return Vec::new() };
    let given = words.iter().filter(|word| word.starts_with("--"));
    let given = given
        .flat_map(|word| word.split('|'))
        .map(|word| word.split(['=', '[', ']', ',', ';']).next().unwrap_or_default());
    if first.starts_with('-') {
        let is_known = |option: &&str| names.commands.values().any(|options| options.contains(*option));
        return given.filter(|option| !is_known(option)).map(|option| format!("no command has {option}")).collect();
    }
    let is_called = *first == "isophote";
    let (count, options) = names.command(&words[usize::from(is_called)..]);
    if count == 0 && !is_called {
        return Vec::new(); // another program
    }
    let next =
        words.get(count + usize::from(is_called)).filter(|word| word.starts_with(|c: char| c.is_ascii_lowercase()));
    let command = words[..count + usize::from(is_called)].join(" ");
    let is_group = names
        .commands
        .keys()
        .any(|one| one.starts_with(&format!("{} ", command.trim_start_matches("isophote").trim())));
    let unknown = next.filter(|word| is_called && (count == 0 || is_group) && !is_placeholder(word));
    let unknown = unknown.map(|word| format!("no command `{command} {word}`"));
    let wrong = given.filter(|option| !options.contains(*option)).map(|option| format!("`{command}` has no {option}"));
    unknown.into_iter().chain(wrong).collect()
}

/// Faults of the routes of a code span.
fn wrong_routes(code: &str, names: &Names) -> Vec<String> {
    let mut found = Vec::new();
    let words: Vec<&str> = code.split([' ', '\'', '"', '(', ')']).collect();
    for (at, word) in words.iter().enumerate() {
        let path = word.strip_prefix(SERVICE).unwrap_or(word).split(['?', '#', ',', ';']).next().unwrap_or_default();
        let methods: Vec<&str> =
            at.checked_sub(1).map_or(Vec::new(), |before| words[before].split(['/', ',']).collect());
        let is_method = |word: &&str| matches!(*word, "GET" | "PUT" | "POST" | "DELETE");
        let methods: Vec<&str> = methods.into_iter().filter(is_method).collect();
        let known: BTreeSet<&String> = match path.strip_prefix('…') {
            Some(end) if end.starts_with(['/', ':']) => {
                names.routes.iter().filter(|(route, _)| route.ends_with(end)).flat_map(|(_, methods)| methods).collect()
            }
            None if path.starts_with('/') && path.len() > 1 => {
                let segment = path[1..].split('/').next().unwrap_or_default();
                if SYSTEM.contains(&format!("/{segment}").as_str()) || is_placeholder(segment) {
                    continue;
                }
                names.routes.iter().filter(|(route, _)| is_of(route, path)).flat_map(|(_, methods)| methods).collect()
            }
            _ => continue,
        };
        if known.is_empty() {
            found.push(format!("no route {path}"));
        }
        found.extend(
            methods
                .iter()
                .filter(|one| !known.is_empty() && !known.contains(&one.to_string()))
                .map(|one| format!("no {one} {path}")),
        );
    }
    found
}

/// Missing files and folders of a code span; `own` are those that the document itself writes.
fn wrong_paths(code: &str, own: &[String], is_map: bool, names: &Names) -> Vec<String> {
    let words = code.split_whitespace().map(|word| word.trim_matches(['\'', '"', '(', ')', ',', ';', ':']));
    let words =
        words.filter(|word| !word.starts_with(['/', '-', '.', '@']) && !is_placeholder(word) && !word.contains("://"));
    let is_missing = |word: &&str| {
        let path = word.split('#').next().unwrap_or_default();
        let trimmed = path.trim_end_matches('/');
        let first = trimmed.split('/').next().unwrap_or_default();
        if path.contains('/') && names.has_folder(first) {
            return !names.paths.contains(trimmed);
        }
        let is_source = SOURCES.iter().any(|ending| trimmed.strip_suffix(ending).is_some_and(|stem| !stem.is_empty()));
        let is_plain = path.bytes().all(|byte| byte.is_ascii_lowercase() || b"_/".contains(&byte));
        let is_folder = is_map && path.contains('/') && is_plain;
        (is_source || is_folder) && !names.ends_so(trimmed) && !own.iter().any(|one| one == trimmed)
    };
    words.filter(is_missing).map(|word| format!("no file {word}")).collect()
}

fn faults(document: &File, names: &Names) -> Vec<String> {
    let code = code(document);
    let written = code.iter().flat_map(|line| line.split(" --out ").skip(1)).filter_map(|rest| rest.split(' ').next());
    let shown = blocks(&document.text);
    let own = shown.iter().filter_map(|block| block.words.get(2).map(String::as_str));
    let own: Vec<String> = own.chain(written).map(String::from).collect();
    let is_map = document.path == "ARCHITECTURE.md";
    let check = |code: &String| {
        [wrong_command(code, names), wrong_routes(code, names), wrong_paths(code, &own, is_map, names)].concat()
    };
    code.iter().flat_map(check).map(|fault| format!("{}: {fault}", document.path)).collect()
}

#[test]
fn mentioned_names_exist() {
    let names = Names::of_the_repository();
    let is_ours = |document: &File| {
        matches!(document.path.as_str(), "README.md" | "ARCHITECTURE.md") || document.path.starts_with("docs/")
    };
    let documents = files(&[".md"]).into_iter().filter(|document| is_ours(document) && document.path != "docs/cli.md");
    let found: Vec<String> = documents.flat_map(|document| faults(&document, &names)).collect();
    expect_none("names in the documentation", &found);
}

#[test]
fn planted_faults_are_caught() {
    let names = Names::of_the_repository();
    let caught = |path: &str, text: &str| faults(&File { path: path.into(), text: text.into() }, &names);
    for wrong in [
        "`--targets-of-none 3`",
        "`isophote frobnicate`",
        "`isophote model frobnicate`",
        "`isophote model list --demo`",
        "`model check --frames x`",
        "```text\nisophote serve --demo \\\n    --nothing\n```",
        "`/v1/nothing`",
        "`PUT /v1/models`",
        "`GET /v1/models/{name}:nothing`",
        "`GET …/nothing`",
        "`http://127.0.0.1:7240/v1/sessions/demo/nothing`",
        "`server/src/registry.rs`",
        "`python3 tests/nothing.py`",
        "`nothing.rs`",
        "`docs/nothing/`",
    ] {
        assert_eq!(caught("docs/planted.md", wrong).len(), 1, "{wrong}: {:?}", caught("docs/planted.md", wrong));
    }
    assert_eq!(caught("ARCHITECTURE.md", "`session/nothing` and `nothing/`").len(), 2);
    for right in [
        "`--demo` `serve --demo` `--set k=v,…` `-h`",
        "`isophote COMMAND --help` `isophote fit MODEL --frames photo.jpg | head`",
        "`cargo test --workspace` `curl --silent x` `fit` `exposure.control`",
        "`PUT /v1/models/{name}` `/livez` `DELETE /v1/sources/{name}/control?lease=9f0c…` `POST …:rollback` `/dev/video0`",
        "`image/png` `session/nothing` `models/NAME.toml` `spot.toml` `models/`",
        "```python script why.py\n```\n`why.py`",
    ] {
        assert_eq!(caught("docs/planted.md", right), Vec::<String>::new(), "{right}");
    }
}
