//! Reads a document's text (TOML or JSON) to a checked [`Model`](crate::model::Model).
//!
//! On failure returns every fault of the document as a diagnostic with a span and a help text.

pub(crate) mod calls;
pub(crate) mod document;
pub(crate) mod elaborate;
pub(crate) mod formulas;
pub(crate) mod reader;
