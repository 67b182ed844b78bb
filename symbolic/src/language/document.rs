//! Reads TOML or JSON to one kind of tree with spans, so that a model does not depend on the format.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::ops::Range;
use std::rc::Rc;

use crate::model::Places;
use isophote_syntax::diagnostic::{Diagnostic, Diagnostics, Span};
use isophote_syntax::limits::{LIMITS, Limits};
use isophote_syntax::spelling::Spelling;

/// A string of the document with its source map.
#[derive(Clone, Debug)]
pub(crate) struct Text {
    pub value: Rc<str>,
    pub spelling: Spelling,
}

impl Text {
    /// The document's span of bytes `start..end` of the value.
    pub fn span(&self, start: usize, end: usize) -> Span {
        self.spelling.span(start, end, self.value.len())
    }

    /// A text that is its own document.
    pub fn alone(value: &str) -> Text {
        Text { value: value.into(), spelling: Spelling::Plain(0) }
    }

    /// `raw` is the literal with its quotes, at byte `start` of the document.
    fn literal(value: &str, raw: &str, start: usize) -> Text {
        Text { value: value.into(), spelling: Spelling::of(value, raw, start) }
    }
}

/// A value of the document.
#[derive(Clone, Debug)]
pub(crate) enum Item {
    Text(Text),
    Integer(i64),
    Float(f64),
    Bool(bool),
    List(Vec<Entry>),
    Table(Vec<(Key, Entry)>),
    /// A date, or null.
    Other,
}

/// A value and its span.
#[derive(Clone, Debug)]
pub(crate) struct Entry {
    pub item: Item,
    pub span: Span,
}

/// A key and its span.
#[derive(Clone, Debug)]
pub(crate) struct Key {
    pub name: String,
    pub span: Span,
}

fn span(range: Range<usize>) -> Span {
    Span { start: range.start as u32, end: range.end as u32 }
}

fn too_long(text: &str) -> Option<Diagnostic> {
    let bytes = &text.as_bytes()[..text.len().min(LIMITS.document_bytes)];
    let next = bytes.iter().skip(1).chain(b" ");
    let is_of_number = |(byte, next): &(&u8, &u8)| match byte {
        b'+' | b'-' | b'.' => next.is_ascii_digit(),
        b'e' | b'E' => next.is_ascii_digit() || b"+-".contains(next),
        b'[' | b']' => byte != next,
        byte => byte.is_ascii_digit() || b" \n\r\t,".contains(byte),
    };
    let words = text.len() - bytes.iter().zip(next).filter(is_of_number).count();
    (text.len() > LIMITS.document_bytes || words > LIMITS.text_bytes).then(|| {
        let Limits { document_bytes, text_bytes, .. } = LIMITS;
        let size = format!("{document_bytes} bytes, {text_bytes} besides its numbers");
        let message = format!("a document has at most {size}, this one {} and {words}", text.len());
        Diagnostic::error(text, "limit", "", Span::default(), message).help("split the model, or shorten its comments")
    })
}

/// Syntax errors reported per document.
const SYNTAX_FAULTS: usize = 5;

/// The key at byte `at` of broken TOML, guessed from the last table header and the text before `=` on the same line.
fn key_at(text: &str, at: usize) -> String {
    let end = text.floor_char_boundary(at);
    let line_start = text[..end].rfind('\n').map_or(0, |i| i + 1);
    let line = text[line_start..].lines().next().unwrap_or_default();
    let name = |text: &str| text.trim().trim_matches(['"', '\'']).chars().take(LIMITS.name_bytes).collect::<String>();
    let header = |line: &str| {
        let inner = line.trim().strip_prefix('[')?.trim_start_matches('[').split(']').next()?;
        (!inner.contains(['=', '"', ','])).then(|| name(inner))
    };
    let table = text[..line_start].lines().rev().find_map(header);
    let own = header(line).or_else(|| line.split_once('=').map(|(key, _)| name(key))).unwrap_or_else(|| name(line));
    match table.filter(|_| header(line).is_none()) {
        Some(table) if !own.is_empty() => format!("{table}.{own}"),
        Some(table) => table,
        None => own,
    }
}

/// The key at byte `at` of broken JSON: the last `"key":` before it.
fn json_key_at(text: &str, at: usize) -> String {
    let colon = text[..text.floor_char_boundary(at)].rfind("\":");
    let key = colon.and_then(|colon| text[..colon].rfind('"').map(|open| &text[open + 1..colon]));
    key.unwrap_or_default().chars().take(LIMITS.name_bytes).collect()
}

/// Reads TOML. Reports an unreadable line and blanks it out, so that the others are checked as well; suppresses what
/// follows from an error on the line before.
pub(crate) fn read_toml(text: &str) -> Result<(Entry, Diagnostics), Diagnostics> {
    if let Some(diagnostic) = too_long(text) {
        return Err(vec![diagnostic]);
    }
    let mut told = Diagnostics::new();
    let mut readable = text.to_string();
    let mut left_out = 0..0;
    for _ in 0..=SYNTAX_FAULTS {
        let (table, errors) = toml::de::DeTable::parse_recoverable(&readable);
        let place = |e: &toml::de::Error| e.span().map_or(Span::default(), span);
        let is_twice = |e: &&toml::de::Error| e.message().contains("duplicate");
        let Some(first) = errors.iter().filter(|e| !is_twice(e)).min_by_key(|e| place(e)) else {
            told.extend(errors.iter().take(SYNTAX_FAULTS).map(|e| syntax_fault(text, e, place(e))));
            let whole = span(table.span());
            return Ok((Entry { item: Item::Table(toml_table(table.get_ref(), &readable)), span: whole }, told));
        };
        if let Some((bracket, line)) = unclosed_above(&readable, place(first).start as usize) {
            let close = if readable.as_bytes()[bracket] == b'[' { "]" } else { "}" };
            let at = span(bracket..bracket + 1);
            let message = "this bracket is never closed";
            let key = key_at(text, bracket);
            told.push(Diagnostic::error(text, "syntax", &key, at, message).help(format!("add `{close}`")));
            if told.len() == SYNTAX_FAULTS {
                break;
            }
            readable.replace_range(line.clone(), &" ".repeat(line.len()));
            left_out = line;
            continue;
        }
        let line = line_around(&readable, place(first).start as usize);
        let source = readable[line.clone()].trim();
        let follows = left_out.end > 0 && line.start == left_out.end + 1 && !source.contains('=');
        if told.len() < SYNTAX_FAULTS && !follows {
            told.push(syntax_fault(text, first, place(first)));
        }
        // After an unreadable header all keys would seem to be in the wrong table.
        let ends = told.len() == SYNTAX_FAULTS || is_too_deep(first);
        if ends || follows || source.is_empty() || source.starts_with('[') {
            break;
        }
        readable.replace_range(line.clone(), &" ".repeat(line.len()));
        left_out = line;
    }
    Err(told)
}

fn syntax_fault(text: &str, error: &toml::de::Error, at: Span) -> Diagnostic {
    let message = error.message().lines().collect::<Vec<_>>().join("; ");
    if is_too_deep(error) {
        let message = "keys, lists or tables are nested too deeply";
        return Diagnostic::error(text, "limit", "", at, message).help("a model needs three levels");
    }
    let (code, help) = if message.contains("duplicate") {
        ("duplicate", "remove one of them, or rename it")
    } else {
        ("syntax", "the document is TOML: `key = value`, formulas in quotes")
    };
    let help = if message.contains("unquoted key") && !text[line_around(text, at.start as usize)].is_ascii() {
        "a name with other letters than a to z stands in quotes: `\"größe\" = …`"
    } else {
        help
    };
    Diagnostic::error(text, code, &key_at(text, at.start as usize), at, message).help(help)
}

fn is_too_deep(error: &toml::de::Error) -> bool {
    error.message().contains("recurs")
}

/// If the line is unreadable from its start: the bracket that the line above leaves open, and that line.
fn unclosed_above(text: &str, at: usize) -> Option<(usize, Range<usize>)> {
    let line = line_around(text, at);
    let source = &text[line.clone()];
    if at > line.start + source.len() - source.trim_start().len() && at < line.end {
        return None;
    }
    let above = text[..line.start].trim_end();
    let above = line_around(text, above.len().checked_sub(1)?);
    let mut open = Vec::new();
    let mut quote = None;
    for (i, c) in text[above.clone()].char_indices() {
        match c {
            _ if quote == Some(c) => quote = None,
            _ if quote.is_some() => {}
            '"' | '\'' => quote = Some(c),
            '#' => break,
            '[' | '{' => open.push(above.start + i),
            ']' | '}' => drop(open.pop()),
            _ => {}
        }
    }
    Some((*open.last()?, above))
}

/// The bytes of the line at `at`, without its end.
fn line_around(text: &str, at: usize) -> Range<usize> {
    let start = text[..text.floor_char_boundary(at)].rfind('\n').map_or(0, |i| i + 1);
    start..text[start..].find('\n').map_or(text.len(), |i| start + i)
}

fn toml_table(table: &toml::de::DeTable<'_>, text: &str) -> Vec<(Key, Entry)> {
    let entry = |(key, value): (&toml::Spanned<Cow<'_, str>>, &toml::Spanned<toml::de::DeValue<'_>>)| {
        let key = Key { name: key.get_ref().to_string(), span: span(key.span()) };
        (key, toml_entry(value, text))
    };
    let mut entries: Vec<_> = table.iter().map(entry).collect();
    entries.sort_by_key(|(key, _)| key.span);
    entries
}

fn toml_entry(value: &toml::Spanned<toml::de::DeValue<'_>>, text: &str) -> Entry {
    use toml::de::DeValue;
    let at = value.span();
    let item = match value.get_ref() {
        DeValue::String(string) => Item::Text(Text::literal(string, &text[at.clone()], at.start)),
        DeValue::Integer(integer) => {
            i64::from_str_radix(integer.as_str(), integer.radix()).map_or(Item::Other, Item::Integer)
        }
        DeValue::Float(float) => Item::Float(float.as_str().parse().unwrap_or(f64::NAN)),
        DeValue::Boolean(value) => Item::Bool(*value),
        DeValue::Array(array) => Item::List(array.iter().map(|v| toml_entry(v, text)).collect()),
        DeValue::Table(table) => Item::Table(toml_table(table, text)),
        DeValue::Datetime(_) => Item::Other,
    };
    Entry { item, span: span(at) }
}

/// Reads JSON.
pub(crate) fn read_json(text: &str) -> Result<(Entry, Diagnostics), Diagnostics> {
    if let Some(diagnostic) = too_long(text).or_else(|| too_deep(text)) {
        return Err(vec![diagnostic]);
    }
    let strict = jsonc_parser::ParseOptions {
        allow_comments: false,
        allow_loose_object_property_names: false,
        allow_trailing_commas: false,
        allow_missing_commas: false,
        allow_single_quoted_strings: false,
        allow_hexadecimal_numbers: false,
        allow_unary_plus_numbers: false,
        allow_bare_decimal_point_numbers: false,
        allow_non_finite_numbers: false,
        allow_extended_string_escapes: false,
    };
    let tell = |range: Range<usize>, message: String| {
        vec![
            Diagnostic::error(text, "syntax", &json_key_at(text, range.start), span(range), message)
                .help("the document is JSON: an object of keys and values"),
        ]
    };
    match jsonc_parser::parse_to_ast(text, &jsonc_parser::CollectOptions::default(), &strict) {
        Ok(parsed) => match parsed.value {
            Some(value) => {
                let mut told = Diagnostics::new();
                let entry = json_entry(&value, text, &mut told);
                Ok((entry, told))
            }
            None => Err(tell(0..0, "the document is empty".into())),
        },
        Err(e) => Err(tell(e.range().start..e.range().end, e.kind().to_string())),
    }
}

/// Of duplicate keys the first counts; the second is reported.
fn json_entry(value: &jsonc_parser::ast::Value<'_>, text: &str, told: &mut Diagnostics) -> Entry {
    use jsonc_parser::ast::Value;
    use jsonc_parser::common::Ranged;
    let at = value.range().start..value.range().end;
    let item = match value {
        Value::StringLit(string) => Item::Text(Text::literal(&string.value, &text[at.clone()], at.start)),
        Value::NumberLit(number) => match number.value.parse::<i64>() {
            Ok(integer) => Item::Integer(integer),
            Err(_) => Item::Float(number.value.parse().unwrap_or(f64::NAN)),
        },
        Value::BooleanLit(value) => Item::Bool(value.value),
        Value::Array(array) => Item::List(array.elements.iter().map(|v| json_entry(v, text, told)).collect()),
        Value::Object(object) => {
            let mut entries: Vec<(Key, Entry)> = Vec::new();
            let mut seen = BTreeSet::new();
            for property in &object.properties {
                let range = property.name.range();
                let key = Key { name: property.name.as_str().to_string(), span: span(range.start..range.end) };
                if !seen.insert(key.name.clone()) {
                    let message = format!("duplicate key {}", isophote_syntax::diagnostic::quoted(&key.name));
                    let path: String = key.name.chars().take(LIMITS.name_bytes).collect();
                    if told.len() < LIMITS.diagnostics {
                        told.push(
                            Diagnostic::error(text, "duplicate", &path, key.span, message).help("remove one of them"),
                        );
                    }
                    continue;
                }
                entries.push((key, json_entry(&property.value, text, told)));
            }
            Item::Table(entries)
        }
        Value::NullKeyword(_) => Item::Other,
    };
    Entry { item, span: span(at) }
}

/// Checks bracket depth outside strings before a recursive parser runs.
fn too_deep(text: &str) -> Option<Diagnostic> {
    let (mut depth, mut quoted, mut escaped) = (0_usize, false, false);
    for (i, byte) in text.bytes().enumerate() {
        match byte {
            _ if escaped => escaped = false,
            b'\\' if quoted => escaped = true,
            b'"' => quoted = !quoted,
            b'[' | b'{' if !quoted => depth += 1,
            b']' | b'}' if !quoted => depth = depth.saturating_sub(1),
            _ => {}
        }
        if depth > LIMITS.depth {
            let message = format!("a document is nested at most {} deep", LIMITS.depth);
            return Some(
                Diagnostic::error(text, "limit", "", span(i..i + 1), message).help("a model needs three levels"),
            );
        }
    }
    None
}

/// All strings of a document. Uses a worklist, because the user determines the tree's depth.
pub(crate) fn places(root: &Entry) -> Places {
    let mut found = Vec::new();
    let mut waiting = vec![(String::new(), root)];
    while let Some((path, entry)) = waiting.pop() {
        match &entry.item {
            Item::Text(_) => found.push((entry.span, path)),
            Item::List(list) => {
                waiting.extend(list.iter().enumerate().map(|(i, entry)| (format!("{path}[{i}]"), entry)));
            }
            Item::Table(table) => waiting.extend(table.iter().map(|(key, entry)| match path.as_str() {
                "" => (key.name.clone(), entry),
                _ => (format!("{path}.{}", key.name), entry),
            })),
            _ => {}
        }
    }
    found.sort();
    found.into()
}

/// The tree as plain JSON, keys sorted; non-finite numbers become null (they are rejected elsewhere).
pub(crate) fn to_json(entry: &Entry) -> serde_json::Value {
    use serde_json::Value;
    match &entry.item {
        Item::Text(text) => Value::from(&*text.value),
        Item::Integer(integer) => Value::from(*integer),
        Item::Float(float) => Value::from(*float),
        Item::Bool(value) => Value::from(*value),
        Item::List(list) => Value::from(list.iter().map(to_json).collect::<Vec<_>>()),
        Item::Table(table) => Value::Object(table.iter().map(|(k, v)| (k.name.clone(), to_json(v))).collect()),
        Item::Other => Value::Null,
    }
}

#[cfg(test)]
#[path = "document_tests.rs"]
mod tests;
