//! A document with another schedule: its stages replaced, every other line as the user wrote it.
//!
//! What comes in: a model, its text, stages. What goes out: a text whose document is the same but for `stages`; that is
//! checked by reading it again. Lines are told apart by TOML's own rules for brackets and strings, no further.

use std::sync::Arc;

use isophote_symbolic::{Diagnostics, Model, Stage};
use serde_json::{Value, json};

/// How each line of the comment begins; an older one is replaced.
const MARK: &str = "# isophote tune: ";

/// The model with these stages and nothing else changed.
pub fn with_stages(model: &Model, stages: &[Stage]) -> Result<Arc<Model>, Diagnostics> {
    Model::from_json(&document(model, stages).to_string()).map(Arc::new)
}

/// The document as JSON with these stages.
fn document(model: &Model, stages: &[Stage]) -> Value {
    let mut document = model.document().clone();
    document["stages"] = stages.iter().map(|stage| value(model, stage)).collect();
    document
}

fn value(model: &Model, stage: &Stage) -> Value {
    let iterations = stage.iterations;
    json!({"parameters": names(model, stage), "method": stage.method.name(), "iterations": iterations,
           "tolerance": stage.tolerance})
}

/// The free parameters of a stage.
pub fn names<'a>(model: &'a Model, stage: &Stage) -> Vec<&'a str> {
    stage.parameters.iter().map(|id| model.parameters()[id.index()].name.as_str()).collect()
}

/// What is written in the place of a document's stages.
pub struct Rewrite<'a> {
    /// Of the text.
    pub model: &'a Model,
    /// The user's.
    pub text: &'a str,
    /// The text is JSON, which has no comments and is written anew.
    pub is_json: bool,
    /// Absent: the document's own stages stay as they are written.
    pub stages: Option<&'a [Stage]>,
    /// Sentences that stand before the stages.
    pub comment: &'a [String],
}

impl Rewrite<'_> {
    /// The new text; `None` when it does not say the same: stages are written in a way that is not understood here.
    pub fn text(&self) -> Option<String> {
        let stages = self.stages.unwrap_or(self.model.stages());
        let wanted = document(self.model, stages);
        if self.is_json {
            return serde_json::to_string_pretty(&wanted).ok().map(|text| text + "\n");
        }
        let text = self.toml(stages);
        let read = Model::from_toml(&text).ok()?;
        let is_kept = self.stages.is_none() && read.document() == self.model.document();
        (is_kept || *read.document() == wanted).then_some(text)
    }

    fn toml(&self, stages: &[Stage]) -> String {
        let lines = self.text.lines().filter(|line| !line.starts_with(MARK)).collect::<Vec<_>>();
        let starts = line_starts(&lines);
        let comment: Vec<String> = self.comment.iter().map(|sentence| format!("{MARK}{sentence}")).collect();
        let tables = stages.iter().map(|stage| table(self.model, stage)).collect::<Vec<_>>();
        let own = comment.into_iter().chain(tables).collect::<Vec<_>>();
        let is_stages = |i: usize| starts[i] == LineStart::Header && is_stages_header(lines[i]);
        let keeps = self.stages.is_none() && (0..lines.len()).any(is_stages);
        let mut written: Vec<String> = Vec::new();
        let (mut inside, mut done, mut at_top) = (false, false, true);
        for (i, line) in lines.iter().enumerate() {
            match starts[i] {
                LineStart::Header => {
                    at_top = false;
                    inside = is_stages(i);
                    if inside && !done {
                        done = true;
                        written.extend(if keeps { &own[..self.comment.len()] } else { &own[..] }.iter().cloned());
                    }
                }
                LineStart::Key if at_top => inside = key(line) == "stages",
                LineStart::Blank if inside && is_before_header(&starts, i) => inside = false,
                _ => {}
            }
            if !inside || keeps {
                written.push(line.to_string());
            }
        }
        while written.last().is_some_and(|line| line.trim().is_empty()) {
            written.pop();
        }
        if !done {
            written.push(String::new());
            written.extend(own);
        }
        written.join("\n") + "\n"
    }
}

fn table(model: &Model, stage: &Stage) -> String {
    let names: Vec<String> = names(model, stage).iter().map(|name| format!("\"{name}\"")).collect();
    format!(
        "[[stages]]\nparameters = [{}]\nmethod     = \"{}\"\niterations = {}\ntolerance  = {:?}",
        names.join(", "),
        stage.method.name(),
        stage.iterations,
        stage.tolerance
    )
}

/// What a line of TOML begins with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LineStart {
    /// `[table]` or `[[table]]`.
    Header,
    /// `key = …`.
    Key,
    /// Nothing, or a comment.
    Blank,
    /// Something that began on an earlier line.
    Inside,
}

fn line_starts(lines: &[&str]) -> Vec<LineStart> {
    let (mut quote, mut depth) = (None, 0usize);
    let start = |line: &&str| {
        let trimmed = line.trim_start();
        let is_inside = quote.is_some() || depth > 0;
        let found = match trimmed.chars().next() {
            _ if is_inside => LineStart::Inside,
            None | Some('#') => LineStart::Blank,
            Some('[') => LineStart::Header,
            Some(_) => LineStart::Key,
        };
        (quote, depth) = after(line, quote, depth);
        found
    };
    lines.iter().map(start).collect()
}

/// The long string and the number of brackets that a line leaves open.
fn after(line: &str, mut quote: Option<&'static str>, mut depth: usize) -> (Option<&'static str>, usize) {
    let mut rest = line;
    while let Some(first) = rest.chars().next() {
        if let Some(end) = quote {
            if rest.starts_with(end) {
                quote = None;
                rest = rest[end.len()..].trim_start_matches(&end[..1]);
                continue;
            }
            let escaped = first == '\\' && end == "\"\"\"";
            rest = skip(rest, if escaped { 2 } else { 1 });
            continue;
        }
        match first {
            '#' => break,
            '"' if rest.starts_with("\"\"\"") => (quote, rest) = (Some("\"\"\""), &rest[3..]),
            '\'' if rest.starts_with("'''") => (quote, rest) = (Some("'''"), &rest[3..]),
            '"' | '\'' => rest = after_short(rest, first),
            '[' | '{' => (depth, rest) = (depth + 1, &rest[1..]),
            ']' | '}' => (depth, rest) = (depth.saturating_sub(1), &rest[1..]),
            _ => rest = skip(rest, 1),
        }
    }
    (quote, depth)
}

/// What follows a string of one line.
fn after_short(text: &str, quote: char) -> &str {
    let mut rest = skip(text, 1);
    while let Some(first) = rest.chars().next() {
        rest = skip(rest, if first == '\\' && quote == '"' { 2 } else { 1 });
        if first == quote {
            break;
        }
    }
    rest
}

fn skip(text: &str, characters: usize) -> &str {
    text.char_indices().nth(characters).map_or("", |(at, _)| &text[at..])
}

fn is_stages_header(line: &str) -> bool {
    let header = line.split('#').next().unwrap_or_default();
    let inner = header.trim().strip_prefix("[[").and_then(|rest| rest.strip_suffix("]]"));
    inner.is_some_and(|name| name.trim() == "stages")
}

fn key(line: &str) -> &str {
    line.split('=').next().unwrap_or_default().trim()
}

/// A blank line or comment after which nothing but such lines comes before another table or the end: it belongs there.
fn is_before_header(starts: &[LineStart], line: usize) -> bool {
    starts[line..].iter().find(|start| **start != LineStart::Blank).is_none_or(|start| *start == LineStart::Header)
}

#[cfg(test)]
#[path = "rewrite_tests.rs"]
mod tests;
