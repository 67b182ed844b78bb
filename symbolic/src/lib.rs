//! Compiles a model document (TOML or JSON) to a minimal pixel loop, in typed steps:
//! ```text
//! text ─► Model ─► Summand ─► Objective ─► Program
//! ```
//! [`Model`] holds the checked document and the graph of its formulas; its [`Summand`]s add up to the function that a
//! fit minimises. [`Summand::objective`] differentiates one for a subset of the parameters and splits the result into
//! few per-pixel sums; [`Objective::program`] lowers them to a [`LoopNest`], and makes it a [`Program`] if it passes its
//! check. [`interpreter::run`] defines a program's semantics: native code must equal it bit for bit.
//!
//! The crate is independent of pixel memory layout, files, threads, clocks and the compiler backend. Faults of the user
//! are [`Diagnostic`]s with a span and a help text; [`LIMITS`] bounds a document.

#![forbid(unsafe_code)]

#[cfg(test)]
extern crate self as isophote_symbolic; // for test code shared with the JIT crate

mod derive;
mod graph;
mod language;
mod likelihood;
mod model;
mod objective;
mod program;
mod proof;
mod schedule;

pub use isophote_elementary::{Axis, Function1, Function2, Lookup, Table, Tables};

pub use derive::derivatives::Derivatives;
pub use graph::expressions::Expressions;
pub use graph::{Bits, Node, NodeId};
pub use isophote_syntax::diagnostic::{Diagnostic, Diagnostics, Severity, Span};
pub use isophote_syntax::limits::{LIMITS, Limits};
pub use language::formulas::Formula;
pub use likelihood::claim::{Part, ValueKind};
pub use model::corrected::Slopes;
pub use model::estimator::Estimator;
pub use model::sample::Sample;
pub use model::{Constant, Method, Model, Parameter, Quadrature, Roles, Saturated, Stage, Start, Summand};
pub use objective::Objective;
pub use objective::planes::Prediction;
pub use program::check::{Malformed, Reader, Rule};
pub use program::*;
#[doc(hidden)]
pub use proof::direct::DirectSums;
pub use proof::program::Program;
pub use proof::{Form, Proof};
pub use schedule::Lowering;
pub use schedule::sums::{Output, Term as OutputTerm};
