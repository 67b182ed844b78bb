//! Completions and man pages name every command of docs/cli.md, which another test holds against the program.

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

use crate::{failure, output, text};

/// The words of every command.
fn commands() -> Vec<Vec<String>> {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/cli.md");
    let page = std::fs::read_to_string(page).unwrap();
    let titles = page.lines().filter_map(|line| line.strip_prefix("## "));
    titles.map(|title| title.split(' ').map(String::from).collect()).collect()
}

#[test]
fn every_command_has_a_man_page() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("man1");
    let printed = output(&["man", "--out", text(&out)]);
    let pages: BTreeSet<String> =
        std::fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    let expected: BTreeSet<String> = commands().iter().map(|words| words.join("-") + ".1").collect();
    assert_eq!(pages, expected);
    assert_eq!(printed, format!("{} pages in {}\n", pages.len(), out.display()));
    let page = std::fs::read_to_string(out.join("isophote-session-start.1")).unwrap();
    for part in [".TH isophote-session-start 1", "Start a session", "\\-\\-source", "ISOPHOTE_SERVER"] {
        assert!(page.contains(part), "{part}: {page}");
    }
    let page = std::fs::read_to_string(out.join("isophote.1")).unwrap();
    assert!(page.contains("Exit status:") && page.contains("isophote\\-watch(1)"), "{page}");
    let files: serde_json::Value = serde_json::from_str(&output(&["man", "--out", text(&out), "--json"])).unwrap();
    assert_eq!(files["files"].as_array().unwrap().len(), pages.len());
}

/// Parts of the line of a shell's completion script that defines a command.
fn marks(shell: &str, words: &[String]) -> [String; 2] {
    let [joined, path] = ["__subcmd__", ";"].map(|between| words.join(between));
    let last = format!("-a \"{}\"", words.last().unwrap());
    match (shell, words.len()) {
        ("bash", _) => [format!(" {joined})"), String::new()],
        ("elvish", _) => [format!("&'{path}'= {{"), String::new()],
        ("powershell", _) => [format!(" '{path}' {{"), String::new()],
        ("zsh", _) => [format!("_{joined}_commands() {{"), String::new()],
        (_, 1) => ["complete -c isophote".into(), String::new()],
        (_, 2) => ["__fish_isophote_needs_command".into(), last],
        _ => [format!("using_subcommand {}; and not", words[1]), last],
    }
}

#[test]
fn completions_name_every_command() {
    let options = [
        ("bash", "--confidence-min)"),
        ("elvish", "cand --confidence-min "),
        ("fish", "-l confidence-min "),
        ("powershell", "'--confidence-min'"),
        ("zsh", "'--confidence-min="),
    ];
    for (shell, option) in options {
        let script = output(&["completions", shell]);
        for words in commands() {
            let marks = marks(shell, &words);
            let is_named = script.lines().any(|line| marks.iter().all(|mark| line.contains(mark.as_str())));
            assert!(is_named, "{shell}: {words:?}");
        }
        assert!(script.contains(option), "{shell}");
    }
    let (status, message) = failure(&["completions", "csh"]);
    assert!(status == 2 && message.contains("fish"), "{message}");
}

#[test]
fn bash_completes_subcommands_and_options() {
    let folder = tempfile::tempdir().unwrap();
    let script = folder.path().join("isophote.bash");
    std::fs::write(&script, output(&["completions", "bash"])).unwrap();
    let complete = |words: &str| {
        let words_given = words.split(' ').count();
        let line = format!(
            "source {} && COMP_WORDS=({words}) && COMP_CWORD={} && _isophote isophote \"${{COMP_WORDS[{}]}}\" '' && echo \"${{COMPREPLY[@]}}\"",
            text(&script),
            words_given - 1,
            words_given - 1
        );
        let found = Command::new("bash").args(["-c", &line]).output();
        found.ok().map(|found| String::from_utf8(found.stdout).unwrap().trim().to_string())
    };
    let Some(found) = complete("isophote session sh") else {
        eprintln!("skipped: there is no bash here");
        return;
    };
    assert_eq!(found, "show shadow");
    assert_eq!(complete("isophote session shadow --pro").unwrap(), "--promote");
}
