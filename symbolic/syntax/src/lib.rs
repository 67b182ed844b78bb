//! From a formula's text to its syntax tree.
//!
//! What comes in: text that nobody has looked at. What goes out: a tree, whatever the text, with every fault at its place; and
//! how faults are told. It must never know what names mean: parameters, coordinates, shapes.
#![allow(missing_docs)] // trees for symbolic alone; what symbolic hands on is described
#![forbid(unsafe_code)]

pub mod diagnostic;
pub mod lexer;
pub mod limits;
pub mod parser;
pub mod spelling;
pub mod words;
