//! docs/cli.md: the help of every command, as clap prints it.

use crate::{expect, printed};

const HEAD: &str = "# The command line\n\n\
    Everything is done by one program, `isophote`. This page has the help of each of its commands, as `isophote COMMAND --help` \
    prints it; a test keeps it so. Commands that speak to a service find it by `--server` or `ISOPHOTE_SERVER`.\n";

/// The names under `Commands:` in a help text.
fn subcommands(help: &str) -> Vec<&str> {
    let lines = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.trim().is_empty());
    // Continuation lines are indented further.
    let entries = lines.filter_map(|line| line.strip_prefix("  ")).filter(|entry| !entry.starts_with(' '));
    entries.filter_map(|entry| entry.split_whitespace().next()).filter(|name| *name != "help").collect()
}

/// The section of a command and those of its subcommands.
fn section(words: &[&str]) -> String {
    let help = printed(&[words, &["--help"]].concat()).unwrap();
    let trimmed: Vec<&str> = help.trim_end().lines().map(str::trim_end).collect();
    let title = ["isophote"].iter().chain(words).copied().collect::<Vec<_>>().join(" ");
    let mut text = format!("\n## {title}\n\n```text\n{}\n```\n", trimmed.join("\n"));
    for name in subcommands(&help) {
        text += &section(&[words, &[name]].concat());
    }
    text
}

#[test]
fn cli_page_matches_the_help() {
    let page = format!("{HEAD}{}", section(&[]));
    assert!(page.contains("## isophote model check\n"), "{page}");
    expect("docs/cli.md", page.as_bytes());
}

#[test]
fn subcommands_are_found() {
    let help = "What it is\n\nCommands:\n  serve  Run\n         the service\n  help   Print\n\nOptions:\n  -h\n";
    assert_eq!(subcommands(help), ["serve"]);
    assert!(subcommands("Options:\n  -h\n").is_empty());
}
