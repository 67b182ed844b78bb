//! From a document's text to a checked [`Model`](model::Model).
//!
//! What comes in: TOML or JSON. What goes out: a `Model`, or every fault of the document as diagnostics with a place and a
//! remedy. It must never know: derivatives, programs, pixels.

pub(crate) mod budget;
pub(crate) mod calls;
pub(crate) mod document;
pub(crate) mod elaborate;
pub(crate) mod estimator;
pub(crate) mod formulas;
pub(crate) mod graph;
pub(crate) mod model;
pub(crate) mod places;
pub(crate) mod reader;
pub(crate) mod remark;
