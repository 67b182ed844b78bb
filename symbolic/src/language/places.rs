//! Which formula of the document some bytes belong to.
//!
//! What comes in: a document's tree, later a [`Span`]. What goes out: the key of the formula and its text there.

use std::sync::Arc;

use crate::language::diagnostic::Span;
use crate::language::document::{Entry, Item};
use crate::language::model::Model;

/// The strings of a document with their keys, in the order in which they stand there.
pub(crate) type Places = Arc<[(Span, String)]>;

/// All strings of a document. A worklist: the tree is the user's.
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

impl Model {
    /// The bytes of the document at `span`, as the user wrote them. `None` beyond the document.
    pub fn words(&self, span: Span) -> Option<&str> {
        self.text.get(span.start as usize..span.end as usize)
    }

    /// The key of the formula at `span` (`definitions.s`), and the bytes themselves as the user wrote them. `None` for
    /// bytes that are no part of one string of the document.
    pub fn quote(&self, span: Span) -> Option<(&str, &str)> {
        let at = self.places.partition_point(|(place, _)| place.start <= span.start).checked_sub(1)?;
        let (place, key) = &self.places[at];
        let text = self.words(span)?;
        (span.end <= place.end).then_some((key.as_str(), text))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOML: &str = "name = \"flat\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\n\
                        v0 = { start = 0.0 }\n[definitions]\ns = \"v0 * x\"\n[model]\nintensity = \"s + y\"\n";
    const JSON: &str = r#"{"name": "flat", "coordinates": ["x", "y"], "channels": ["phi"],
        "parameters": {"v0": {"start": 0.0}}, "definitions": {"s": "v0 * x"}, "model": {"intensity": "s + y"}}"#;

    #[test]
    fn bytes_of_a_formula_have_its_key() -> Result<(), crate::Diagnostics> {
        for (model, text) in [(Model::from_toml(TOML)?, TOML), (Model::from_json(JSON)?, JSON)] {
            let span = |words: &str| {
                let start = text.find(words).map_or(0, |at| at as u32);
                Span { start, end: start + words.len() as u32 }
            };
            assert_eq!(model.quote(span("v0 * x")), Some(("definitions.s", "v0 * x")));
            assert_eq!(model.quote(span("s + y")), Some(("model.intensity", "s + y")));
            assert_eq!(model.quote(span("y\"]")).map(|(key, _)| key), None, "beyond the string");
            assert_eq!(model.quote(Span { start: 0, end: 1 }), None);
            assert_eq!(model.quote(Span { start: 1 << 20, end: 1 << 21 }), None, "beyond the document");
        }
        Ok(())
    }
}
