//! `Diagnostic`: the user's fault, with its place and the remedy.

use serde::{Deserialize, Serialize};

/// Bytes `start..end` of the document as sent.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default, Serialize, Deserialize)]
#[serde(from = "(u32, u32)", into = "(u32, u32)")]
pub struct Span {
    /// First byte.
    pub start: u32,
    /// One past the last byte.
    pub end: u32,
}

impl From<(u32, u32)> for Span {
    fn from((start, end): (u32, u32)) -> Span {
        Span { start, end }
    }
}
impl From<Span> for (u32, u32) {
    fn from(span: Span) -> (u32, u32) {
        (span.start, span.end)
    }
}

/// How bad it is.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// The document is refused.
    Error,
    /// The document is accepted.
    Warning,
}

/// One fault of a document.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct Diagnostic {
    /// How bad it is.
    pub severity: Severity,
    /// A stable word to branch on, e.g. `unknown-name`.
    pub code: String,
    /// A sentence to read.
    pub message: String,
    /// What would be right.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub help: Option<String>,
    /// The key of the document, e.g. `model.intensity`; empty where the document as a whole is meant.
    pub key: String,
    /// From 1.
    pub line: u32,
    /// From 1, in characters.
    pub column: u32,
    /// Bytes of the document as sent.
    pub span: Span,
    /// The line of the document, for display.
    #[serde(skip_serializing_if = "String::is_empty", default)]
    pub source: String,
}

/// All faults that were found in one go; never empty when it is an error.
pub type Diagnostics = Vec<Diagnostic>;

/// Bytes of a message or of a line that is echoed.
const ECHO_CHARACTERS: usize = 80;

impl Diagnostic {
    /// An error at `span` of `document`; line, column and the line's text follow from it.
    pub fn error(document: &str, code: &str, key: &str, span: Span, message: impl Into<String>) -> Diagnostic {
        let start = floor_boundary(document, span.start as usize);
        let end = floor_boundary(document, (span.end as usize).max(start));
        let line_start = document[..start].rfind('\n').map_or(0, |i| i + 1);
        let line_end = document[start..].find('\n').map_or(document.len(), |i| start + i);
        Diagnostic {
            severity: Severity::Error,
            code: code.into(),
            message: message.into(),
            help: None,
            key: key.into(),
            line: document[..start].matches('\n').count() as u32 + 1,
            column: document[line_start..start].chars().count() as u32 + 1,
            span: Span { start: start as u32, end: end as u32 },
            source: document[line_start..line_end].trim_end_matches('\r').to_string(),
        }
    }

    /// Adds what would be right.
    pub fn help(mut self, help: impl Into<String>) -> Diagnostic {
        self.help = Some(help.into());
        self
    }

    /// The diagnostic as rustc would show it: message, place, line, caret, help. `name` is the file's name.
    pub fn render(&self, name: &str) -> String {
        let level = match self.severity {
            Severity::Error => "error",
            Severity::Warning => "warning",
        };
        let mut text = format!("{level}[{}]: {}\n", self.code, self.message);
        let gutter = self.line.to_string().len();
        let key = if self.key.is_empty() { String::new() } else { format!(" ({})", self.key) };
        text += &format!("{:gutter$}--> {name}:{}:{}{key}\n", "", self.line, self.column);
        let (shown, column) = self.excerpt();
        if !shown.is_empty() {
            let length = self.span.end.saturating_sub(self.span.start).max(1) as usize;
            let carets = "^".repeat(length.min(shown.chars().count().saturating_sub(column).max(1)));
            text += &format!("{:gutter$} |\n{} | {shown}\n{:gutter$} | {:column$}{carets}\n", "", self.line, "", "");
        }
        if let Some(help) = &self.help {
            text += &format!("{:gutter$} = help: {help}\n", "");
        }
        text
    }

    /// At most [`ECHO_CHARACTERS`] of the line around the caret, and the caret's column in it, from 0.
    fn excerpt(&self) -> (String, usize) {
        let characters: Vec<char> = self.source.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
        let caret = (self.column as usize - 1).min(characters.len());
        let first = if characters.len() <= ECHO_CHARACTERS { 0 } else { caret.saturating_sub(ECHO_CHARACTERS / 2) };
        (characters.iter().skip(first).take(ECHO_CHARACTERS).collect(), caret - first)
    }
}

fn floor_boundary(text: &str, mut index: usize) -> usize {
    index = index.min(text.len());
    while !text.is_char_boundary(index) {
        index -= 1;
    }
    index
}

/// At most 40 characters of user text for a message.
pub(crate) fn quoted(text: &str) -> String {
    let clean: String = text.chars().take(40).map(|c| if c.is_control() { '�' } else { c }).collect();
    if text.chars().count() > 40 { format!("`{clean}…`") } else { format!("`{clean}`") }
}

/// The candidate nearest to `name` by edit distance, when it is near enough to be meant.
pub(crate) fn nearest_name<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let limit = 1 + name.chars().count() / 4;
    let scored =
        candidates.into_iter().map(|c| (distance(name, c), c)).filter(|(d, c)| *d <= limit && *d < c.len().max(2));
    scored.min().map(|(_, c)| c)
}

fn distance(a: &str, b: &str) -> usize {
    if a.len() > 64 || b.len() > 64 {
        return usize::MAX;
    }
    let (a, b): (Vec<char>, Vec<char>) = (a.to_lowercase().chars().collect(), b.to_lowercase().chars().collect());
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.iter().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let substitute = diagonal + usize::from(ca != cb);
            diagonal = row[j + 1];
            row[j + 1] = substitute.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}
