//! Which formula of the document some bytes belong to.
//!
//! What comes in: a document's tree, later a [`Span`]. What goes out: the key of the formula and its text there.

use std::sync::Arc;

use crate::language::document::{Entry, Item};
use crate::language::model::Model;
use isophote_syntax::diagnostic::Span;

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

    /// The document's strings in its order: their keys (`definitions.s`), and their bytes, quotes included.
    pub fn strings(&self) -> impl Iterator<Item = (&str, Span)> {
        self.places.iter().map(|(span, key)| (key.as_str(), *span))
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
#[path = "places_tests.rs"]
mod tests;
