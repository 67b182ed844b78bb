//! Collects the faults of a document, each with its key and span.

use std::collections::HashMap;

use crate::language::document::{Entry, Item, Key, Text};
use crate::model::Parameter;
use crate::program::ParameterId;
use isophote_syntax::diagnostic::{Diagnostic, Diagnostics, Span, Spellings, quoted};
use isophote_syntax::limits::LIMITS;
use isophote_syntax::parser::{Fault, STRAY_CHARACTER};
use isophote_syntax::words::is_reserved;

/// A fault that is not a diagnostic yet.
struct Found {
    code: String,
    key: String,
    span: Span,
    message: String,
    help: Option<String>,
}

/// Maximum length of a key, characters.
const KEY_CHARACTERS: usize = 200;

/// Collects faults; keys are paths such as `stages[0].method`.
pub(crate) struct Faults<'a> {
    document: &'a str,
    list: Vec<Found>,
    /// Syntax faults that the document's parser reported.
    of_syntax: Diagnostics,
    /// Spelling suggestions.
    spellings: Spellings,
}

impl<'a> Faults<'a> {
    /// An empty list of faults of this document.
    pub fn of(document: &'a str) -> Faults<'a> {
        Faults { document, list: Vec::new(), of_syntax: Vec::new(), spellings: Spellings::default() }
    }

    /// Continues after syntax faults that did not prevent reading.
    pub fn after(document: &'a str, of_syntax: Diagnostics) -> Faults<'a> {
        Faults { of_syntax, ..Faults::of(document) }
    }

    /// True when lines of the document could not be read: keys that seem to be missing may be there.
    pub fn is_partial(&self) -> bool {
        self.of_syntax.iter().any(|d| d.code != "duplicate")
    }

    /// Number of faults so far, without those of syntax.
    pub fn count(&self) -> usize {
        self.list.len()
    }

    /// True without faults.
    pub fn is_empty(&self) -> bool {
        self.list.is_empty() && self.of_syntax.is_empty()
    }

    /// All faults in the order of the document, each once.
    pub fn finish(self) -> Diagnostics {
        let Faults { document, mut list, mut of_syntax, .. } = self;
        // Faults of a duplicate key follow from the duplication.
        let stands_twice = |f: &Found| of_syntax.iter().any(|d| d.code == "duplicate" && d.key == f.key);
        list.retain(|found| !stands_twice(found));
        list.sort_by_key(|found| found.span);
        // An undeclared name or a stray character is one fault, wherever it occurs.
        let key = |f: &Found| {
            let is_one = f.code == "unknown-name" || f.message.starts_with(STRAY_CHARACTER);
            (f.message.clone(), if is_one { Span::default() } else { f.span })
        };
        let mut places: HashMap<_, usize> = HashMap::new();
        list.retain(|found| {
            let count = places.entry(key(found)).or_default();
            *count += 1;
            *count == 1
        });
        let all = list.len() + of_syntax.len();
        for found in list.into_iter().take(LIMITS.diagnostics) {
            let count = places[&key(&found)];
            let more = if count > 1 { format!(" (here and in {} more places)", count - 1) } else { String::new() };
            let more = more.replace("1 more places", "1 more place");
            let mut diagnostic =
                Diagnostic::error(document, &found.code, &found.key, found.span, found.message + &more);
            diagnostic.help = found.help;
            of_syntax.push(diagnostic);
        }
        of_syntax.sort_by_key(|diagnostic| diagnostic.span);
        if all > LIMITS.diagnostics {
            of_syntax.truncate(LIMITS.diagnostics);
            let message = format!("{} more faults are not shown", all - LIMITS.diagnostics);
            let help = "mend the first ones and check again";
            let at = of_syntax.last().map_or_else(Span::default, |last| last.span);
            of_syntax.push(Diagnostic::error(document, "limit", "", at, message).help(help));
        }
        of_syntax
    }

    pub fn tell(&mut self, code: &str, key: &str, span: Span, message: impl Into<String>, help: impl Into<String>) {
        if self.is_partial() && code == "missing-key" {
            return;
        }
        let key = key.chars().take(KEY_CHARACTERS).collect();
        self.list.push(Found { code: code.into(), key, span, message: message.into(), help: Some(help.into()) });
    }

    /// Adds a formula's faults, mapped to the document.
    pub fn tell_all(&mut self, faults: Vec<Fault>, key: &str, text: &Text) {
        let key: String = key.chars().take(KEY_CHARACTERS).collect();
        for Fault { code, message, help, start, end } in faults {
            self.list.push(Found { code: code.into(), key: key.clone(), span: text.span(start, end), message, help });
        }
    }

    /// The candidate nearest in spelling.
    pub fn nearest<'n>(&mut self, name: &str, candidates: impl IntoIterator<Item = &'n str>) -> Option<&'n str> {
        self.spellings.nearest(name, candidates)
    }

    pub fn wrong_type(&mut self, key: &str, entry: &Entry, wanted: &str) {
        let found = match entry.item {
            Item::Text(_) => "a string",
            Item::Integer(_) | Item::Float(_) => "a number",
            Item::Bool(_) => "true or false",
            Item::List(_) => "a list",
            Item::Table(_) => "a table",
            Item::Other => "something else",
        };
        self.tell("wrong-type", key, entry.span, format!("this is {found}"), format!("`{key}` is {wanted}"));
    }

    pub fn text<'e>(&mut self, key: &str, entry: &'e Entry) -> Option<&'e Text> {
        match &entry.item {
            Item::Text(text) => Some(text),
            _ => {
                self.wrong_type(key, entry, "a string");
                None
            }
        }
    }

    pub fn number(&mut self, key: &str, entry: &Entry) -> Option<f64> {
        let value = match entry.item {
            Item::Integer(value) => value as f64,
            Item::Float(value) => value,
            _ => {
                self.wrong_type(key, entry, "a number");
                return None;
            }
        };
        if !value.is_finite() {
            self.tell("bad-number", key, entry.span, "numbers are finite", "leave the key out where there is no bound");
            return None;
        }
        Some(value)
    }

    pub fn list<'e>(&mut self, key: &str, entry: &'e Entry, wanted: &str) -> Option<&'e [Entry]> {
        match &entry.item {
            Item::List(list) => Some(list),
            _ => {
                self.wrong_type(key, entry, wanted);
                None
            }
        }
    }

    pub fn table<'e>(&mut self, key: &str, entry: &'e Entry) -> Option<&'e [(Key, Entry)]> {
        match &entry.item {
            Item::Table(table) => Some(table),
            _ => {
                self.wrong_type(key, entry, "a table");
                None
            }
        }
    }

    /// Reports every key that is not among `known`.
    pub fn known(&mut self, path: &str, table: &[(Key, Entry)], known: &[&str]) {
        let path: String = path.chars().take(KEY_CHARACTERS).collect();
        for (key, _) in table {
            if !known.contains(&key.name.as_str()) {
                let help = match self.nearest(&key.name, known.iter().copied()) {
                    Some(near) => format!("did you mean `{near}`?"),
                    None => format!("known keys here: {}", known.join(", ")),
                };
                let place = if path.is_empty() { key.name.clone() } else { format!("{path}.{}", key.name) };
                self.tell("unknown-key", &place, key.span, format!("unknown key {}", quoted(&key.name)), help);
            }
        }
    }

    /// Checks a declared name: letters, digits, underscores, not reserved.
    pub fn name(&mut self, key: &str, name: &str, span: Span) -> bool {
        let mut characters = name.chars();
        let well_formed = characters.next().is_some_and(|c| c.is_alphabetic() || c == '_')
            && characters.all(|c| c.is_alphanumeric() || c == '_');
        if !well_formed {
            self.tell(
                "bad-name",
                key,
                span,
                format!("{} is not a name", quoted(name)),
                "names are letters, digits and _, a letter first",
            );
        } else if name.len() > LIMITS.name_bytes {
            self.tell("limit", key, span, format!("a name has at most {} bytes", LIMITS.name_bytes), "shorten it");
        } else if is_reserved(name) {
            self.tell(
                "reserved-name",
                key,
                span,
                format!("{} belongs to the language", quoted(name)),
                "choose another name",
            );
        } else {
            return true;
        }
        false
    }
}

/// The entry of that name.
pub(crate) fn get<'e>(table: &'e [(Key, Entry)], name: &str) -> Option<&'e Entry> {
    table.iter().find(|(k, _)| k.name == name).map(|(_, entry)| entry)
}

pub(crate) fn parameter_named(
    faults: &mut Faults,
    key: &str,
    entry: &Entry,
    parameters: &[Parameter],
) -> Option<ParameterId> {
    let text = faults.text(key, entry)?;
    let found = parameters.iter().position(|p| p.name == *text.value);
    // Unreadable parameters are already reported.
    if found.is_none() && !parameters.is_empty() && !faults.is_partial() {
        let help = match faults.nearest(&text.value, parameters.iter().map(|p| p.name.as_str())) {
            Some(near) => format!("did you mean `{near}`?"),
            None => "name one of the [parameters]".to_string(),
        };
        faults.tell("unknown-name", key, entry.span, format!("{} is not a parameter", quoted(&text.value)), help);
    }
    found.map(|i| ParameterId(i as u32))
}

pub(crate) fn parameters_named(
    faults: &mut Faults,
    key: &str,
    entry: &Entry,
    parameters: &[Parameter],
) -> Vec<ParameterId> {
    let Some(list) = faults.list(key, entry, "a list of parameters") else { return Vec::new() };
    let mut found = Vec::new();
    for (i, item) in list.iter().enumerate() {
        let key = format!("{key}[{i}]");
        let Some(parameter) = parameter_named(faults, &key, item, parameters) else { continue };
        if found.contains(&parameter) {
            faults.tell("duplicate", &key, item.span, "this parameter stands twice", "name it once");
        }
        found.push(parameter);
    }
    found
}
