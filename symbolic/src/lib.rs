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

mod absorb;
mod bodies;
mod calculus;
mod calls;
mod check;
mod cuts;
mod derivation;
mod diagnostic;
mod document;
mod domain;
mod double_double;
#[cfg(test)]
mod duals_tests;
mod elaborate;
pub mod elementary;
mod entry;
mod evaluate;
mod explain;
mod export;
mod formulas;
mod function;
mod graph;
mod hyper;
pub mod interpreter;
mod jet;
mod latex;
mod lexer;
mod likelihood;
mod limits;
mod looks;
mod mathml;
mod model;
mod modular;
mod monomial;
mod objective;
mod parser;
mod peephole;
mod places;
mod points;
mod polynomials;
mod print;
mod program;
mod proof;
mod rank;
mod reader;
mod registers;
mod remark;
mod sample;
mod schedule;
mod search;
mod square;
mod steps;
mod text;
mod tree;
mod variant;
mod weighed;

pub use bodies::{BodyFlops, Part};
pub use check::ProgramParts;
pub use diagnostic::{Diagnostic, Diagnostics, Severity, Span};
pub use explain::Show;
pub use export::{ExportError, ExportOptions, Language, PixelType};
pub use formulas::Formula;
pub use function::{Function1, Function2};
pub use likelihood::{Loss, Saturated};
pub use limits::{LIMITS, Limits};
pub use model::{Constant, Estimator, Lowering, Method, Model, Parameter, Roles, Stage, Start, Summand};
pub use objective::{Objective, Prediction, ValueKind};
pub use program::*;
pub use proof::{Form, Proof};
pub use sample::Sample;
pub use variant::Variant;
