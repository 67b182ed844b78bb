//! Maps a [`Span`] to its formula in the document: the key, and the text at the span.

use crate::model::Model;
use isophote_syntax::diagnostic::Span;

impl Model {
    /// The document's text at `span`; `None` beyond the document.
    pub fn words(&self, span: Span) -> Option<&str> {
        self.text.get(span.start as usize..span.end as usize)
    }

    /// The document's strings in order: keys (`definitions.s`) and spans, quotes included.
    pub fn strings(&self) -> impl Iterator<Item = (&str, Span)> {
        self.places.iter().map(|(span, key)| (key.as_str(), *span))
    }

    /// The key of the formula at `span` (`definitions.s`), and the text there; `None` for bytes outside a single string
    /// of the document.
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
