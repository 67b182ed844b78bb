//! From a model to few per-pixel sums: the graph of its formulas, their derivatives, and how both are taken apart.
//!
//! What comes in: a checked model, a subset of its parameters, a method. What goes out: an
//! [`Objective`](objective::Objective), which is lowered to a program by [`crate::program::schedule`].

pub(crate) mod absorb;
pub(crate) mod bodies;
pub(crate) mod cuts;
pub(crate) mod derivation;
pub(crate) mod domain;
pub(crate) mod entry;
pub(crate) mod graph;
pub(crate) mod jet;
pub(crate) mod likelihood;
pub(crate) mod monomial;
pub(crate) mod objective;
pub(crate) mod polynomials;
pub(crate) mod rank;
pub(crate) mod sample;
pub(crate) mod search;
pub(crate) mod square;
pub(crate) mod variant;
