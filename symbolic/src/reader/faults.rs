//! Faults of a document as they are found, each at its key and place.

use crate::diagnostic::{Diagnostic, Diagnostics, Span, nearest_name, quoted};
use crate::document::{Entry, Item, Key, Text};
use crate::elaborate::is_reserved;
use crate::limits::LIMITS;
use crate::model::Parameter;
use crate::parser::Fault;
use crate::program::ParameterId;

/// Collects faults; keys are paths such as `stages[0].method`.
pub(crate) struct Faults<'a> {
    document: &'a str,
    pub list: Diagnostics,
}

impl<'a> Faults<'a> {
    /// No faults yet of this document.
    pub fn of(document: &'a str) -> Faults<'a> {
        Faults { document, list: Vec::new() }
    }

    pub fn tell(&mut self, code: &str, key: &str, span: Span, message: impl Into<String>, help: impl Into<String>) {
        self.list.push(Diagnostic::error(self.document, code, key, span, message).help(help));
    }
    /// A formula's fault, at its place in the document; poisoned ones are already told.
    pub fn tell_fault(&mut self, fault: Fault, key: &str, text: &Text) {
        let told = |d: &Diagnostic| d.code == "limit" && d.message == fault.message;
        if fault.code == crate::elaborate::POISONED || self.list.iter().any(told) {
            return;
        }
        let mut diagnostic =
            Diagnostic::error(self.document, fault.code, key, text.span(fault.start, fault.end), fault.message);
        diagnostic.help = fault.help;
        self.list.push(diagnostic);
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

    /// Tells every key that is not among `known`.
    pub fn known(&mut self, path: &str, table: &[(Key, Entry)], known: &[&str]) {
        for (key, _) in table {
            if !known.contains(&key.name.as_str()) {
                let help = match nearest_name(&key.name, known.iter().copied()) {
                    Some(near) => format!("did you mean `{near}`?"),
                    None => format!("known keys here: {}", known.join(", ")),
                };
                let place = if path.is_empty() { key.name.clone() } else { format!("{path}.{}", key.name) };
                self.tell("unknown-key", &place, key.span, format!("unknown key {}", quoted(&key.name)), help);
            }
        }
    }

    /// A name that a user may give: letters, digits, underscores, not one of the language's own.
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
    if found.is_none() {
        let help = match nearest_name(&text.value, parameters.iter().map(|p| p.name.as_str())) {
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
