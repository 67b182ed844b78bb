//! An objective as people read it: trees of its formulas, in plain text, LaTeX and MathML.

pub(crate) mod explain;
pub(crate) mod latex;
pub(crate) mod looks;
pub(crate) mod mathml;
pub(crate) mod text;
pub(crate) mod tree;
