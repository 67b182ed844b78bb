//! TOML or JSON in, a tree with spans out: the same tree for both, so that a model does not know how it was written.

use std::borrow::Cow;
use std::ops::Range;
use std::rc::Rc;

use crate::diagnostic::{Diagnostic, Span};
use crate::limits::LIMITS;

/// A string of the document and where each of its bytes stands there.
#[derive(Clone, Debug)]
pub(crate) struct Text {
    pub value: Rc<str>,
    /// Document offsets of the value's bytes, and one more for the end.
    offsets: Rc<[u32]>,
}

impl Text {
    /// The place in the document of bytes `start..end` of the value.
    pub fn span(&self, start: usize, end: usize) -> Span {
        let last = self.offsets.len() - 1;
        Span { start: self.offsets[start.min(last)], end: self.offsets[end.min(last)] }
    }

    /// A text that stands alone: its own document.
    pub fn alone(value: &str) -> Text {
        Text { value: value.into(), offsets: (0..=value.len() as u32).collect() }
    }

    /// `raw` is the literal with its quotes, standing at `start` of the document.
    fn literal(value: &str, raw: &str, start: usize) -> Text {
        let quotes = ["\"\"\"", "'''", "\"", "'"].into_iter().find(|q| raw.starts_with(q)).map_or(0, str::len);
        let escapes = !raw.starts_with('\'');
        let mut offsets = Vec::with_capacity(value.len() + 1);
        let mut at = quotes;
        if quotes == 3 {
            at += if raw[3..].starts_with("\r\n") { 2 } else { usize::from(raw[3..].starts_with('\n')) };
        }
        for c in value.chars() {
            let rest = &raw[at.min(raw.len())..];
            // A backslash at a line's end swallows the white space that follows it.
            let trimmed = if escapes && rest.starts_with('\\') && rest[1..].starts_with(['\n', '\r', ' ', '\t']) {
                let white = rest[1..].find(|c: char| !c.is_whitespace()).unwrap_or(rest.len() - 1);
                1 + white
            } else {
                0
            };
            at += trimmed;
            let rest = &raw[at.min(raw.len())..];
            let length = match rest.as_bytes() {
                [b'\\', b'u', ..] if escapes => {
                    if u32::from(c) > 0xffff {
                        12
                    } else {
                        6
                    }
                }
                [b'\\', b'U', ..] if escapes => 10,
                [b'\\', b'x', ..] if escapes => 4,
                [b'\\', ..] if escapes => 2,
                _ => c.len_utf8(),
            };
            offsets.extend(std::iter::repeat_n((start + at.min(raw.len())) as u32, c.len_utf8()));
            at += length;
        }
        offsets.push((start + at.min(raw.len())) as u32);
        // Bytes inside a character are never asked for; a plain run counts byte by byte.
        if raw.len() == value.len() + 2 * quotes && raw[quotes..].starts_with(value) {
            offsets = (0..=value.len()).map(|i| (start + quotes + i) as u32).collect();
        }
        Text { value: value.into(), offsets: offsets.into() }
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

/// A value and its place.
#[derive(Clone, Debug)]
pub(crate) struct Entry {
    pub item: Item,
    pub span: Span,
}

/// A key and its place.
#[derive(Clone, Debug)]
pub(crate) struct Key {
    pub name: String,
    pub span: Span,
}

fn span(range: Range<usize>) -> Span {
    Span { start: range.start as u32, end: range.end as u32 }
}

fn too_long(text: &str) -> Option<Diagnostic> {
    (text.len() > LIMITS.document_bytes).then(|| {
        let message = format!("a document has at most {} bytes, this one {}", LIMITS.document_bytes, text.len());
        Diagnostic::error(text, "limit", "", Span::default(), message).help("split the model, or shorten its comments")
    })
}

/// Syntax errors told of one document.
const SYNTAX_FAULTS: usize = 5;

/// The key that a place in broken TOML belongs to, as far as its lines tell: the last table header, and what stands before
/// the `=` of the place's own line.
fn key_at(text: &str, at: usize) -> String {
    let mut end = at.min(text.len());
    while !text.is_char_boundary(end) {
        end -= 1;
    }
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

/// The key that a place in broken JSON belongs to: the last `"key":` before it.
fn json_key_at(text: &str, at: usize) -> String {
    let mut end = at.min(text.len());
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    let colon = text[..end].rfind("\":");
    let key = colon.and_then(|colon| text[..colon].rfind('"').map(|open| &text[open + 1..colon]));
    key.unwrap_or_default().chars().take(LIMITS.name_bytes).collect()
}

/// Reads TOML; every syntax error that the reader could recover from is told.
pub(crate) fn read_toml(text: &str) -> Result<Entry, Vec<Diagnostic>> {
    if let Some(diagnostic) = too_long(text) {
        return Err(vec![diagnostic]);
    }
    let (table, errors) = toml::de::DeTable::parse_recoverable(text);
    if !errors.is_empty() {
        let tell = |e: &toml::de::Error| {
            let at = e.span().map_or(Span::default(), span);
            let message = e.message().lines().collect::<Vec<_>>().join("; ");
            let code = if message.contains("duplicate") { "duplicate" } else { "syntax" };
            Diagnostic::error(text, code, &key_at(text, at.start as usize), at, message)
                .help("the document is TOML: `key = value`, formulas in quotes")
        };
        // One slip makes many: the first few name it.
        return Err(errors.iter().take(SYNTAX_FAULTS).map(tell).collect());
    }
    let whole = span(table.span());
    Ok(Entry { item: Item::Table(toml_table(table.get_ref(), text)), span: whole })
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
pub(crate) fn read_json(text: &str) -> Result<Entry, Vec<Diagnostic>> {
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
            Some(value) => json_entry(&value, text),
            None => Err(tell(0..0, "the document is empty".into())),
        },
        Err(e) => Err(tell(e.range().start..e.range().end, e.kind().to_string())),
    }
}

fn json_entry(value: &jsonc_parser::ast::Value<'_>, text: &str) -> Result<Entry, Vec<Diagnostic>> {
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
        Value::Array(array) => {
            Item::List(array.elements.iter().map(|v| json_entry(v, text)).collect::<Result<_, _>>()?)
        }
        Value::Object(object) => {
            let mut entries: Vec<(Key, Entry)> = Vec::new();
            for property in &object.properties {
                let range = property.name.range();
                let key = Key { name: property.name.as_str().to_string(), span: span(range.start..range.end) };
                if entries.iter().any(|(k, _)| k.name == key.name) {
                    let message = format!("duplicate key {}", crate::diagnostic::quoted(&key.name));
                    return Err(vec![
                        Diagnostic::error(text, "duplicate", &key.name, key.span, message).help("remove one of them"),
                    ]);
                }
                entries.push((key, json_entry(&property.value, text)?));
            }
            Item::Table(entries)
        }
        Value::NullKeyword(_) => Item::Other,
    };
    Ok(Entry { item, span: span(at) })
}

/// Brackets outside strings, counted before a recursive reader meets them.
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

/// The tree as plain JSON, keys sorted; numbers that JSON does not know become null (they are refused elsewhere).
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
