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
        let (shown, before, carets) = self.excerpt();
        if !shown.is_empty() {
            text += &format!(
                "{:gutter$} |\n{} | {shown}\n{:gutter$} | {:before$}{}\n",
                "",
                self.line,
                "",
                "",
                "^".repeat(carets)
            );
        }
        if let Some(help) = &self.help {
            text += &format!("{:gutter$} = help: {help}\n", "");
        }
        text
    }

    /// At most [`ECHO_CHARACTERS`] of the line around the fault, and in columns of a terminal: what stands before the
    /// fault, and its width, at least 1. A fault of several lines is shown as far as its first.
    fn excerpt(&self) -> (String, usize, usize) {
        let line: Vec<char> = self.source.chars().collect();
        let start = (self.column as usize).saturating_sub(1).min(line.len());
        let mut bytes = self.span.end.saturating_sub(self.span.start) as usize;
        let is_inside = |c: &&char| {
            let is_inside = bytes > 0;
            bytes = bytes.saturating_sub(c.len_utf8());
            is_inside
        };
        let end = start + line[start..].iter().take_while(is_inside).count();
        let first = if line.len() <= ECHO_CHARACTERS { 0 } else { start.saturating_sub(ECHO_CHARACTERS / 2) };
        let last = (first + ECHO_CHARACTERS).min(line.len());
        let width = |part: &[char]| part.iter().map(|c| columns(*c)).sum::<usize>();
        let (head, tail) = (if first > 0 { "…" } else { "" }, if last < line.len() { "…" } else { "" });
        let shown: String = line[first..last].iter().map(|c| visible(*c)).collect();
        let before = usize::from(first > 0) + width(&line[first..start.max(first)]);
        (format!("{head}{shown}{tail}"), before, width(&line[start..end.min(last).max(start)]).max(1))
    }
}

/// What is shown of a character: a tab takes one column, and nothing may move the cursor or turn the line round.
pub(crate) fn visible(c: char) -> char {
    match c {
        '\t' => ' ',
        '\u{200b}'..='\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}' => '�',
        c if c.is_control() => '�',
        c => c,
    }
}

/// Columns of a terminal that a character takes: two for the wide scripts, none for what stands on the letter before.
fn columns(c: char) -> usize {
    match u32::from(c) {
        0x300..=0x36f | 0x483..=0x489 | 0x591..=0x5bd | 0x610..=0x61a | 0x64b..=0x65f | 0x1ab0..=0x1aff => 0,
        0x1dc0..=0x1dff | 0x20d0..=0x20ff | 0xfe00..=0xfe0f | 0xfe20..=0xfe2f => 0,
        0x1100..=0x115f | 0x2e80..=0x303e | 0x3041..=0xa4cf | 0xac00..=0xd7a3 | 0xf900..=0xfaff => 2,
        0xfe30..=0xfe6f | 0xff00..=0xff60 | 0xffe0..=0xffe6 | 0x1f300..=0x1f64f | 0x1f900..=0x1f9ff => 2,
        0x20000..=0x3fffd => 2,
        _ => 1,
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
    let clean: String = text.chars().take(40).map(visible).collect();
    if text.chars().count() > 40 { format!("`{clean}…`") } else { format!("`{clean}`") }
}

/// The candidate nearest to `name` by edit distance, when it is near enough to be meant.
pub(crate) fn nearest_name<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let length = name.chars().count();
    let limit = 1 + length / 4;
    // Of a name of one letter nothing would be left.
    let is_near = |(d, c): &(usize, &str)| *d <= limit && *d < c.len().max(2) && *d < length;
    candidates.into_iter().map(|c| (distance(name, c), c)).filter(is_near).min().map(|(_, c)| c)
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
