//! Parses a formula's text to a syntax tree; defines diagnostics and the bounds on documents.
//!
//! Parsing never fails: every fault becomes a diagnostic at its span. Names have no meaning here: `symbolic` resolves
//! parameters, coordinates and shapes.
#![allow(missing_docs)] // syntax trees are for symbolic only; re-exported types are documented
#![forbid(unsafe_code)]

pub mod diagnostic;
pub mod lexer;
pub mod limits;
pub mod parser;
pub mod spelling;
pub mod words;
