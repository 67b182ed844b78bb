//! Source map of a string literal: which bytes of the document stand for which character.
//!
//! Reads a TOML or JSON literal, quotes included, a second time and compares it with the parsed value; where they
//! disagree every span is the whole literal's.

use std::rc::Rc;

use crate::diagnostic::Span;

/// Maps a value's bytes to the document.
#[derive(Clone, Debug)]
pub enum Spelling {
    /// Verbatim, from this byte on.
    Plain(u32),
    /// For each byte of the value its character's span; one more, empty, for the end.
    Each(Rc<[Span]>),
    /// Unknown, within this span.
    Somewhere(Span),
}

impl Spelling {
    /// Maps a literal at byte `start` of the document.
    pub fn of(value: &str, raw: &str, start: usize) -> Spelling {
        let at = |byte: usize| (start + byte) as u32;
        let quotes = ["\"\"\"", "'''", "\"", "'"].into_iter().find(|quotes| raw.starts_with(quotes)).unwrap_or("");
        if raw.len() == value.len() + 2 * quotes.len() && raw[quotes.len()..].starts_with(value) {
            return Spelling::Plain(at(quotes.len()));
        }
        match read(value, raw, quotes) {
            Some(read) => Spelling::Each(read.into_iter().map(|(a, b)| Span { start: at(a), end: at(b) }).collect()),
            None => Spelling::Somewhere(Span { start: at(0), end: at(raw.len()) }),
        }
    }

    /// The document's span of bytes `start..end` of a value of `length` bytes.
    pub fn span(&self, start: usize, end: usize, length: usize) -> Span {
        let (start, end) = (start.min(length), end.min(length));
        match self {
            Spelling::Plain(first) => Span { start: first + start as u32, end: first + end.max(start) as u32 },
            Spelling::Each(spans) if start < end => Span { start: spans[start].start, end: spans[end - 1].end },
            Spelling::Each(spans) => Span { start: spans[start].start, end: spans[start].start },
            Spelling::Somewhere(span) => *span,
        }
    }
}

/// The literal's byte range for each byte of the value and for the end; `None` if the literal does not spell the value.
fn read(value: &str, raw: &str, quotes: &str) -> Option<Vec<(usize, usize)>> {
    let inside = raw.strip_prefix(quotes)?.strip_suffix(quotes)?;
    let is_of_lines = quotes.len() == 3;
    let mut rest = inside;
    if is_of_lines {
        rest = rest.strip_prefix("\r\n").or_else(|| rest.strip_prefix('\n')).unwrap_or(rest);
    }
    let place = |rest: &str| raw.len() - quotes.len() - rest.len();
    let mut spans = Vec::with_capacity(value.len() + 1);
    let mut end = place(rest);
    let mut wanted = value.chars();
    while !rest.is_empty() {
        let (character, length) = match quotes {
            "\"\"\"" | "\"" => spelled(rest)?,
            _ => rest.chars().next().map(|c| (Some(c), c.len_utf8()))?,
        };
        let start = place(rest);
        rest = rest.get(length..)?;
        let Some(character) = character else { continue };
        if wanted.next() != Some(character) {
            return None;
        }
        end = place(rest);
        spans.extend(std::iter::repeat_n((start, end), character.len_utf8()));
    }
    spans.push((end, end));
    wanted.next().is_none().then_some(spans)
}

/// The first character of a double-quoted string and its bytes; no character for a line continuation.
fn spelled(rest: &str) -> Option<(Option<char>, usize)> {
    let first = rest.chars().next()?;
    if first != '\\' {
        return Some((Some(first), first.len_utf8()));
    }
    let digits = |at: usize, count: usize| u32::from_str_radix(rest.get(at..at + count)?, 16).ok();
    let coded = |count: usize| Some((char::from_u32(digits(2, count)?)?, 2 + count));
    let (character, length) = match rest[1..].chars().next()? {
        'b' => ('\u{8}', 2),
        't' => ('\t', 2),
        'n' => ('\n', 2),
        'f' => ('\u{c}', 2),
        'r' => ('\r', 2),
        'e' => ('\u{1b}', 2),
        c @ ('"' | '\\' | '/') => (c, 2),
        'x' => coded(2)?,
        'U' => coded(8)?,
        'u' => coded(4).or_else(|| pair(digits(2, 4)?, rest.get(6..8)?, digits(8, 4)?))?,
        ' ' | '\t' | '\r' | '\n' => {
            // Only these are trimmed; a no-break space is kept.
            let blank = rest[1..].trim_start_matches([' ', '\t', '\r', '\n']);
            return Some((None, rest.len() - blank.len()));
        }
        _ => return None,
    };
    Some((Some(character), length))
}

/// A character beyond 16 bits as a JSON surrogate pair: `\uD83D\uDE00`.
fn pair(high: u32, between: &str, low: u32) -> Option<(char, usize)> {
    let units = [u16::try_from(high).ok()?, u16::try_from(low).ok()?];
    let character = char::decode_utf16(units).next()?.ok()?;
    (between == "\\u").then_some((character, 12))
}
