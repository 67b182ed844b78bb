//! `Diagnostic`: a fault of the user's document, with its span and a help text.

use serde::{Deserialize, Serialize};
use unicode_width::UnicodeWidthStr;

use crate::limits::LIMITS;

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

/// Severity of a diagnostic.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// The document is rejected.
    Error,
    /// The document is accepted.
    Warning,
}

/// An error or warning about a document.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Diagnostic {
    /// Severity.
    pub severity: Severity,
    /// Stable identifier, e.g. `unknown-name`.
    pub code: String,
    /// Description, as a sentence.
    pub message: String,
    /// Suggested fix.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub help: Option<String>,
    /// Key in the document, e.g. `model.intensity`; empty if it concerns the whole document.
    pub key: String,
    /// Line, counted from 1.
    pub line: u32,
    /// Column in characters, counted from 1.
    pub column: u32,
    /// Bytes `start..end` of the document as sent.
    #[cfg_attr(feature = "schema", schema(value_type = [u32; 2]))]
    pub span: Span,
    /// Text of the line, for display; long lines are truncated.
    #[serde(skip_serializing_if = "String::is_empty", default)]
    pub source: String,
}

/// All faults of one reading; never empty when returned as an error.
pub type Diagnostics = Vec<Diagnostic>;

/// Longest source line kept in a diagnostic, bytes.
const LINE_BYTES: usize = 1024;

/// The source line of a fault that starts after the prefix `until`: cut at [`LINE_BYTES`], empty if the fault starts
/// beyond.
fn shown_line(line: &str, until: &str) -> String {
    let line = line.trim_end_matches('\r');
    match (line.len() <= LINE_BYTES, until.len() <= LINE_BYTES) {
        (true, _) => line.to_string(),
        (false, true) => format!("{}…", &line[..line.floor_char_boundary(LINE_BYTES)]),
        (false, false) => String::new(),
    }
}

/// Characters of the source line in a rendering.
const ECHO_CHARACTERS: usize = 80;

impl Diagnostic {
    /// An error at `span` of `document`; computes line, column and source line.
    pub fn error(document: &str, code: &str, key: &str, span: Span, message: impl Into<String>) -> Diagnostic {
        let start = document.floor_char_boundary(span.start as usize);
        let end = document.floor_char_boundary((span.end as usize).max(start));
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
            source: shown_line(&document[line_start..line_end], &document[line_start..start]),
        }
    }

    /// Sets the help text.
    pub fn help(mut self, help: impl Into<String>) -> Diagnostic {
        self.help = Some(help.into());
        self
    }

    /// Renders as rustc does: message, location, source line, carets, help. `name` is the file's name.
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

    /// At most [`ECHO_CHARACTERS`] of the line around the fault; and in terminal columns the text before the fault and
    /// the fault's width, at least 1. A fault over several lines is marked on its first.
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
        let look = |part: &[char]| part.iter().map(|c| visible(*c)).collect::<String>();
        let width = |part: &[char]| look(part).width();
        let (head, tail) = (if first > 0 { "…" } else { "" }, if last < line.len() { "…" } else { "" });
        let shown = look(&line[first..last]);
        let before = usize::from(first > 0) + width(&line[first..start.max(first)]);
        (format!("{head}{shown}{tail}"), before, width(&line[start..end.min(last).max(start)]).max(1))
    }
}

/// Replaces a character for display: a tab by a space, control, zero-width and bidirectional characters by `�`.
pub fn visible(c: char) -> char {
    match c {
        '\t' => ' ',
        '\u{200b}'..='\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}' => '�',
        c if c.is_control() => '�',
        c => c,
    }
}

/// User text in backquotes for a message, cut at 40 characters.
pub fn quoted(text: &str) -> String {
    let clean: String = text.chars().take(40).map(visible).collect();
    if text.chars().count() > 40 { format!("`{clean}…`") } else { format!("`{clean}`") }
}

/// Suggests names by edit distance, within a bound per document, because used and declared names may both be many.
pub struct Spellings {
    /// Remaining character comparisons.
    pairs_left: usize,
}

/// Character comparisons per document: about 5 ms.
const PAIRS: usize = 1 << 21;

impl Default for Spellings {
    fn default() -> Spellings {
        Spellings { pairs_left: PAIRS }
    }
}

impl Spellings {
    /// The candidate nearest to `name` by edit distance, if within 1 + a quarter of its length.
    pub fn nearest<'a>(&mut self, name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
        let length = name.chars().count();
        let limit = 1 + length / 4;
        if length > LIMITS.name_bytes || self.pairs_left == 0 {
            return None;
        }
        let lower = name.to_lowercase();
        let mut best: Option<(usize, &str)> = None;
        for candidate in candidates {
            let count = if candidate.len() <= LIMITS.name_bytes { candidate.chars().count() } else { usize::MAX };
            let is_far = count.abs_diff(length) > limit;
            // Skipping a candidate by length has a fixed cost.
            let pairs = if is_far { 8 } else { (length + 4) * (count + 4) };
            self.pairs_left = self.pairs_left.saturating_sub(pairs);
            if self.pairs_left == 0 {
                return None;
            }
            if is_far {
                continue;
            }
            let distance = strsim::levenshtein(&lower, &candidate.to_lowercase());
            // Replacing all letters is no match: a one-letter name would match any other.
            let is_near = distance <= limit && distance < candidate.len().max(2) && distance < length;
            if is_near && best.is_none_or(|best| (distance, candidate) < best) {
                best = Some((distance, candidate));
            }
        }
        best.map(|(_, candidate)| candidate)
    }
}
