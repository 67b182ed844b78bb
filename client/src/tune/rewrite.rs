//! Replaces the stages of a document's text and leaves every other line unchanged.
//!
//! The result is parsed again and must differ in `stages` only. Lines are classified by TOML's rules for brackets and
//! strings alone.

use std::sync::Arc;

use isophote_symbolic::{Model, Stage};
use serde::de::IgnoredAny;
use serde_json::{Value, json};

/// Prefix of the comment's lines; an older comment is replaced.
const MARK: &str = "# isophote tune: ";

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

/// A document whose stages are to be replaced.
pub struct Document<'a> {
    /// The parsed text.
    pub model: &'a Model,
    /// The user's text.
    pub text: &'a str,
    /// Whether the text is JSON, else TOML.
    pub is_json: bool,
}

impl Document<'_> {
    /// The model with these stages and nothing else changed; `None` if the text's own stages cannot be located.
    pub fn with_stages(&self, stages: &[Stage]) -> Option<Arc<Model>> {
        self.checked(Some(stages), &[]).map(|(_, model)| Arc::new(model))
    }

    /// The text with these stages, or its own, below a comment (TOML only). `None` as above.
    pub fn rewritten(&self, stages: Option<&[Stage]>, comment: &[String]) -> Option<String> {
        self.checked(stages, comment).map(|(text, _)| text)
    }

    fn checked(&self, stages: Option<&[Stage]>, comment: &[String]) -> Option<(String, Model)> {
        let wanted = document(self.model, stages.unwrap_or(self.model.stages()));
        let text = match self.is_json {
            true => json_text(self.text, &wanted["stages"])?,
            false => self.toml(stages, comment),
        };
        let read = if self.is_json { Model::from_json(&text) } else { Model::from_toml(&text) }.ok()?;
        let is_kept = stages.is_none() && read.document() == self.model.document();
        // The JSON document has sorted keys: check the order of parameters as well.
        let names = |model: &Model| model.parameters().iter().map(|p| p.name.clone()).collect::<Vec<_>>();
        let is_same = is_kept || *read.document() == wanted;
        (is_same && names(&read) == names(self.model)).then_some((text, read))
    }

    fn toml(&self, stages: Option<&[Stage]>, comment: &[String]) -> String {
        let sentences = comment.len();
        let lines = self.text.lines().filter(|line| !line.starts_with(MARK)).collect::<Vec<_>>();
        let starts = line_starts(&lines);
        let comment = comment.iter().map(|sentence| format!("{MARK}{sentence}"));
        let tables = stages.unwrap_or(self.model.stages()).iter().map(|stage| table(self.model, stage));
        let stage_lines = comment.chain(tables).collect::<Vec<_>>();
        let is_stages = |i: usize| starts[i] == LineStart::Header && is_stages_header(lines[i]);
        let keeps = stages.is_none() && (0..lines.len()).any(is_stages);
        let mut written: Vec<String> = Vec::new();
        let (mut inside, mut done, mut at_top) = (false, false, true);
        for (i, line) in lines.iter().enumerate() {
            match starts[i] {
                LineStart::Header => {
                    at_top = false;
                    inside = is_stages(i);
                    if inside && !done {
                        done = true;
                        written
                            .extend(if keeps { &stage_lines[..sentences] } else { &stage_lines[..] }.iter().cloned());
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
            written.extend(stage_lines);
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

/// Kind of a line of TOML.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LineStart {
    /// `[table]` or `[[table]]`.
    Header,
    /// `key = …`.
    Key,
    /// An empty line or a comment.
    Blank,
    /// Continues an earlier line.
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

/// The multi-line string and the number of brackets that a line leaves open.
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

/// The rest after a single-line string.
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

/// Whether a blank line or comment is followed only by such lines up to the next table or the end, and so belongs
/// there.
fn is_before_header(starts: &[LineStart], line: usize) -> bool {
    starts[line..].iter().find(|start| **start != LineStart::Blank).is_none_or(|start| *start == LineStart::Header)
}

/// Replaces or adds the key `stages` of the outer JSON object; `None` if there is no such object.
fn json_text(text: &str, stages: &Value) -> Option<String> {
    let (mut depth, mut at) = (0usize, 0);
    while let Some(byte) = text.as_bytes().get(at) {
        match byte {
            b'{' | b'[' => depth += 1,
            b'}' | b']' => depth = depth.checked_sub(1)?,
            b'"' => {
                let end = at + length(&text[at..])?;
                let value = text[end..].trim_start().strip_prefix(':').map(str::trim_start);
                if let Some(value) = value.filter(|_| depth == 1 && &text[at..end] == "\"stages\"") {
                    let begin = text.len() - value.len();
                    let rest = &value[length(value)?..];
                    return Some(format!("{}{stages}{rest}", &text[..begin]));
                }
                at = end;
                continue;
            }
            _ => {}
        }
        at += 1;
    }
    let (head, tail) = text.rsplit_once('}')?;
    Some(format!("{}, \"stages\": {stages}\n}}{tail}", head.trim_end()))
}

/// Bytes of the JSON value that a text begins with.
fn length(text: &str) -> Option<usize> {
    let mut values = serde_json::Deserializer::from_str(text).into_iter::<IgnoredAny>();
    values.next()?.ok()?;
    Some(values.byte_offset())
}

#[cfg(test)]
#[path = "rewrite_tests.rs"]
mod tests;
