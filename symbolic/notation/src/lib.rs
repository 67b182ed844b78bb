//! Writes a derivation as plain text, LaTeX or MathML, and a document's own formulas as MathML.
//!
//! In LaTeX and MathML each expression carries the span of the formula that it came from. `explain` turns the
//! expressions of an [`Objective`](isophote_symbolic::Objective) into the trees of `tree`; `text`, `latex` and `mathml`
//! write them; `looks` typesets names.

mod explain;
mod latex;
mod looks;
mod mathml;
mod text;
mod tree;
mod written;

pub use explain::{Show, explain};
pub use written::written;
