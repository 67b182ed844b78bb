//! What may stand in which folder: `unsafe`, clocks, files, sockets, async, mathematics, sleeps; and how long a file is.

use crate::{File, expect_none, files};

/// What `book/build` and the page's build write, which nobody reads or edits.
const BUILT: [&str; 2] = ["server/web/docs/", "server/web/dist/"];

/// Lines of a source file.
const LINES_MAX: usize = 500;

/// Files that are longer, and why that is better than two files.
const LONG_FILES: [(&str, &str); 1] = [("symbolic/src/language/graph.rs", "one arena with its constructors")];

/// The files that may hold `unsafe`, and what for.
const UNSAFE_FILES: [(&str, &str); 6] = [
    ("jit/src/runner.rs", "calls compiled code"),
    ("tracker/tests/allocations.rs", "counts allocations"),
    ("jit/tests/bounds.rs", "pixels between protected pages"),
    ("capture/src/camera/ioctl.rs", "calls V4L2 drivers, and maps their buffers"),
    ("server/machine/src/peer.rs", "asks the system how far a connection's peer has come"),
    ("benches/src/speed/foreign.rs", "calls what other compilers made of exported source, to time it"),
];

/// Words that must not stand in the code of some folders, tests left out, and why.
struct Rule {
    folders: &'static [&'static str],
    words: &'static [&'static str],
    why: &'static str,
}

const RULES: [Rule; 6] = [
    Rule {
        folders: &["symbolic/elementary/src/", "symbolic/src/", "jit/src/", "tracker/src/", "server/wire/src/"],
        words: &[
            "std::time",
            "std::thread",
            "std::fs",
            "std::net",
            "std::env",
            "std::process",
            "std::os",
            "Instant::now",
        ],
        why: "core and wire are pure: time is an argument; no threads, files, sockets, environment",
    },
    Rule {
        folders: &[
            "symbolic/elementary/src/",
            "symbolic/src/",
            "jit/src/",
            "tracker/src/",
            "capture/src/",
            "server/wire/src/",
        ],
        words: &["async fn", "async move", "async {", ".await"],
        why: "nothing below server is async",
    },
    Rule {
        folders: &["server/src/", "server/wire/src/", "server/machine/src/"],
        words: &["nalgebra", "libm", ".sqrt(", ".sin(", ".cos(", ".exp(", ".ln(", ".powi(", ".powf("],
        why: "the server contains no mathematics",
    },
    Rule {
        folders: &["symbolic/elementary/src/", "symbolic/src/"],
        words: &["PlaneView", "stride", "_mm"],
        why: "symbolic knows no pixels' memory layout, and no processor's vectors",
    },
    Rule {
        folders: &["server/wire/src/"],
        words: &["cfg("],
        why: "what is on the wire is the same for whoever speaks it",
    },
    Rule {
        folders: &["capture/src/", "tracker/src/", "jit/src/", "symbolic/src/", "symbolic/elementary/src/"],
        words: &["sleep("],
        why: "pace is kept above",
    },
];

/// Words that stand in no code of ours, tests included.
const NOWHERE: [(&str, &str); 2] =
    [("#[ignore", "a test runs or is deleted"), ("thread::sleep", "wait on a channel or condition with a deadline")];

/// `text` with comments, strings and characters blanked; lines stay where they are.
pub fn code_only(text: &str) -> String {
    let bytes = text.as_bytes();
    let mut code = String::new();
    let mut at = 0;
    while at < bytes.len() {
        let rest = &text[at..];
        let word_before = at > 0 && (bytes[at - 1].is_ascii_alphanumeric() || bytes[at - 1] == b'_');
        let skipped = if rest.starts_with("//") {
            rest.find('\n').unwrap_or(rest.len())
        } else if rest.starts_with("/*") {
            block_comment(rest)
        } else if !word_before
            && (rest.starts_with("r\"")
                || rest.starts_with("r#")
                || rest.starts_with("br\"")
                || rest.starts_with("br#"))
        {
            raw_string(rest)
        } else if rest.starts_with('"') {
            quoted(rest, b'"')
        } else if rest.starts_with('\'') {
            character(rest)
        } else {
            0
        };
        let newlines = text[at..at + skipped].matches('\n').count();
        code.extend(std::iter::repeat_n('\n', newlines));
        at += skipped;
        if skipped == 0 {
            let next = rest.chars().next().unwrap_or(' ');
            code.push(next);
            at += next.len_utf8();
        }
    }
    code
}

fn block_comment(text: &str) -> usize {
    let (mut depth, mut at) = (0, 0);
    while at < text.len() {
        let rest = &text.as_bytes()[at..];
        if rest.starts_with(b"/*") {
            (depth, at) = (depth + 1, at + 2);
        } else if rest.starts_with(b"*/") {
            (depth, at) = (depth - 1, at + 2);
            if depth == 0 {
                return at;
            }
        } else {
            at += 1;
        }
    }
    text.len()
}

/// Length of `r"…"` or `r#"…"#`; 0 for a raw identifier.
fn raw_string(text: &str) -> usize {
    let hashes = text.trim_start_matches(['b', 'r']).bytes().take_while(|b| *b == b'#').count();
    let Some(open) = text.find('"').filter(|open| *open <= hashes + 2) else { return 0 };
    let close = format!("\"{}", "#".repeat(hashes));
    text[open + 1..].find(&close).map_or(text.len(), |at| open + 1 + at + close.len())
}

fn quoted(text: &str, quote: u8) -> usize {
    let bytes = text.as_bytes();
    let mut at = 1;
    while at < bytes.len() && bytes[at] != quote {
        at += if bytes[at] == b'\\' { 2 } else { 1 };
    }
    (at + 1).min(bytes.len())
}

/// Length of `'x'` or `'\n'`; 0 for a lifetime.
fn character(text: &str) -> usize {
    let mut rest = text[1..].chars();
    match (rest.next(), rest.next()) {
        (Some('\\'), _) => quoted(text, b'\''),
        (Some(c), Some('\'')) => 2 + c.len_utf8(),
        _ => 0,
    }
}

/// The code without items for tests alone; lines stay where they are.
pub fn without_tests(code: &str) -> String {
    let (mut kept, mut rest) = (String::new(), code);
    while let Some((before, item)) = rest.split_once("#[cfg(test)]") {
        let end = item_length(item);
        kept.push_str(before);
        kept.extend(item[..end].matches('\n'));
        rest = &item[end..];
    }
    kept + rest
}

/// How many lines items for tests alone take.
pub fn lines_of_tests(code: &str) -> usize {
    let items = code.split("#[cfg(test)]").skip(1);
    items.map(|item| 1 + item[..item_length(item)].matches('\n').count()).sum()
}

/// Up to the `;` or the closing brace that ends an item.
fn item_length(code: &str) -> usize {
    let mut depth = 0;
    for (at, c) in code.char_indices() {
        match c {
            '{' | '(' | '[' => depth += 1,
            '}' | ')' | ']' => depth -= 1,
            _ => {}
        }
        if depth == 0 && (c == ';' || c == '}') {
            return at + 1;
        }
    }
    code.len()
}

/// `use std::{fs, io}` written out, so that one word finds it.
fn spelled_out(code: &str) -> String {
    let groups = code.match_indices("std::{").filter_map(|(at, head)| {
        let inner = code[at + head.len()..].split_once('}')?.0;
        Some(inner.split(',').map(|one| format!("std::{}\n", one.trim())).collect::<String>())
    });
    code.to_string() + "\n" + &groups.collect::<String>()
}

fn line_of(code: &str, word: &str) -> usize {
    code.find(word).map_or(0, |at| code[..at].matches('\n').count() + 1)
}

fn is_word(code: &str, word: &str) -> bool {
    let boundary = |c: Option<char>| !c.is_some_and(|c| c.is_alphanumeric() || c == '_');
    code.match_indices(word)
        .any(|(at, _)| boundary(code[..at].chars().next_back()) && boundary(code[at + word.len()..].chars().next()))
}

fn faults(file: &File) -> Vec<String> {
    let whole = code_only(&file.text);
    // Unit tests that stand in a file of their own are called `tests.rs` or `…_tests.rs`.
    let code = if file.path.ends_with("tests.rs") { String::new() } else { spelled_out(&without_tests(&whole)) };
    let mut found = Vec::new();
    for rule in RULES.iter().filter(|rule| rule.folders.iter().any(|folder| file.path.starts_with(folder))) {
        let words = rule.words.iter().filter(|word| code.contains(**word));
        found.extend(words.map(|word| format!("{}:{}: `{word}`: {}", file.path, line_of(&whole, word), rule.why)));
    }
    for (word, why) in NOWHERE.iter().filter(|(word, _)| whole.contains(word)) {
        found.push(format!("{}:{}: `{word}`: {why}", file.path, line_of(&whole, word)));
    }
    let allowed = UNSAFE_FILES.iter().any(|(path, _)| *path == file.path);
    if is_word(&whole, "unsafe") && !allowed {
        found.push(format!("{}:{}: `unsafe` outside the files that may hold it", file.path, line_of(&whole, "unsafe")));
    }
    if file.path.ends_with("src/lib.rs") && !file.text.starts_with("//!") {
        found.push(format!(
            "{}: a crate opens with what comes in, what goes out and what it must never know",
            file.path
        ));
    }
    let lines = file.text.lines().count();
    if lines > LINES_MAX && !LONG_FILES.iter().any(|(path, _)| *path == file.path) {
        found.push(format!("{}: {lines} lines; is it still one idea?", file.path));
    }
    found
}

fn sources() -> Vec<File> {
    let mut sources = files(&[".rs", ".js", ".ts", ".tsx", ".py", ".css", ".html"]);
    sources.retain(|file| !BUILT.iter().any(|folder| file.path.starts_with(folder)));
    sources
}

#[test]
fn sources_keep_the_house_rules() {
    let found: Vec<String> = sources().iter().flat_map(faults).collect();
    expect_none("sources", &found);
}

#[test]
fn lists_of_exceptions_are_not_stale() {
    let sources = sources();
    let find = |path: &str| sources.iter().find(|file| file.path == path);
    let short = |path: &str| find(path).is_none_or(|file| file.text.lines().count() <= LINES_MAX);
    let long = LONG_FILES.iter().filter(|(path, _)| short(path));
    let mut stale: Vec<String> = long.map(|(path, _)| format!("{path} is not long")).collect();
    let used = |path: &str| find(path).is_some_and(|file| is_word(&code_only(&file.text), "unsafe"));
    stale.extend(
        UNSAFE_FILES.iter().filter(|(path, _)| !used(path)).map(|(path, _)| format!("{path} holds no unsafe code")),
    );
    expect_none("exceptions", &stale);
}

#[test]
fn planted_faults_are_caught() {
    let caught = |path: &str, text: &str| faults(&File { path: path.into(), text: text.into() }).len();
    assert_eq!(caught("symbolic/src/a.rs", "use std::fs;"), 1);
    assert_eq!(caught("tracker/src/a.rs", "use std::{collections::BTreeMap, time::Instant};"), 1);
    assert_eq!(
        caught("symbolic/src/a.rs", "#[cfg(test)]\nmod a_tests;\nfn f(row_stride: usize) { _mm512_add_ps() }"),
        2
    );
    assert_eq!(caught("capture/src/a.rs", "async fn f() {}"), 1);
    assert_eq!(caught("server/src/a.rs", "let r = (x * x).sqrt();"), 1);
    assert_eq!(caught("server/wire/src/a.rs", "#[cfg(feature = \"http\")]\nfn f() {}"), 1);
    assert_eq!(caught("tracker/src/a.rs", "fn f() { unsafe { g() } }"), 1);
    assert_eq!(caught("tests/a.rs", "std::thread::sleep(d);"), 1);
    assert_eq!(caught("tests/a.rs", &"//\n".repeat(LINES_MAX + 1)), 1);
    assert_eq!(caught("jit/src/lib.rs", "pub mod a;"), 1);
    let innocent = "// unsafe std::fs\n/* a /* std::fs */ */ fn f<'a>(c: &'a str) -> char { let s = \"std::fs \\\" unsafe\"; \
                    let r = r#\"unsafe \" std::fs\"#; '\"' }\n#[cfg(test)]\nmod tests { use std::fs; }";
    assert_eq!(caught("symbolic/src/a.rs", innocent), 0);
    assert_eq!(caught("symbolic/src/a.rs", "#![forbid(unsafe_code)]"), 0);
}
