//! From a model document to the smallest pixel loop.
//!
//! What comes in: a document (TOML or JSON) that says what a target looks like. What goes out, each step a type that only
//! the step before can make:
//! ```text
//! text ─► Model ─► Objective ─► Program        (checked)  (what to sum)  (loop nest)
//! ```
//! [`Model`] holds the checked document and the graph of its formulas; [`Model::objective`] differentiates it for a
//! subset of the parameters and takes the result apart into few per-pixel sums; [`Objective::program`] lowers them to a
//! loop nest. [`interpreter::run`] is the meaning of a program: native code must equal it bit for bit.
//!
//! It must never know: a pixel's layout in memory, files, threads, clocks, or the compiler that comes after it.
//! The user's faults are [`Diagnostic`]s with a place and a remedy; limits on what a document may ask for are [`LIMITS`].

#![forbid(unsafe_code)]

#[cfg(test)]
extern crate self as isophote_symbolic; // what tests share with those of machine code

mod derive;
mod language;
mod program;
mod proof;

pub use isophote_elementary::{Axis, Function1, Function2, Lookup, Table, Tables};

pub use derive::corrected::Slopes;
pub use derive::derivatives::Derivatives;
pub use derive::expressions::Expressions;
pub use derive::objective::Objective;
pub use derive::planes::Prediction;
pub use derive::sample::Sample;
pub use derive::sums::{Output, Term as OutputTerm};
pub use isophote_syntax::diagnostic::{Diagnostic, Diagnostics, Severity, Span};
pub use isophote_syntax::limits::{LIMITS, Limits};
pub use language::estimator::Estimator;
pub use language::formulas::Formula;
pub use language::graph::{Bits, Node, NodeId};
pub use language::model::{
    Constant, Lowering, Method, Model, Parameter, Quadrature, Roles, Saturated, Stage, Start, Summand,
};
pub use program::check::{Malformed, ProgramParts, Reader, Rule};
pub use program::*;
pub use proof::claim::{Part, ValueKind};
#[doc(hidden)]
pub use proof::direct::DirectSums;
pub use proof::{Form, Proof};
