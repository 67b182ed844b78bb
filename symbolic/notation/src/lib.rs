//! A derivation as people read it: its formulas in plain text, LaTeX and MathML; and a document's own formulas, as MathML.
//!
//! What comes in: an [`Objective`](isophote_symbolic::Objective), whose expressions carry the span of the formula that they
//! came from. What goes out: text; in LaTeX and MathML with those spans.
//! It must never know: how an expression was derived, or what becomes of it.
//!
//! `explain` turns expressions into the trees of `tree`; `text`, `latex` and `mathml` write them, `looks` says how names look.

mod explain;
mod latex;
mod looks;
mod mathml;
mod text;
mod tree;
mod written;

pub use explain::{Show, explain};
pub use written::written;
