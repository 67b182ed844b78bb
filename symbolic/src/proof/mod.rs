//! Checks every program once, when it is made, against the document's formulas.
//!
//! A [`LoopNest`](crate::program::LoopNest) that passes becomes a [`Program`](program::Program): nothing else makes one
//! from a document. The reference is forward differentiation ([`crate::graph::hyper`]) at made-up points,
//! which shares nothing with the derivation but the graph of the formulas as they were read:
//! 1. in exact arithmetic modulo a prime, with elementary functions as uninterpreted values;
//! 2. in f64 at plausible points, to 1e-12 of the sum of the absolute terms; double-double decides where rounding
//!    exceeds that;
//! 3. in f32 by the interpreter, against f64, about the target and at pixels up to 4,096 px from there: the gradient's
//!    error, scaled by √H_ii, over its largest entry;
//! 4. the row bounds and masks of the pixel set, against the domain itself and the limits of the channels;
//! 5. over a window with rows that have no pixel, are all saturated, or are outside of the domain, where formulas may
//!    be NaN.
//!
//! The check covers every lowering of sums ([`referee`]) and of planes ([`plane`]); [`budget`] limits its cost.

pub(crate) mod budget;
pub(crate) mod direct;
#[cfg(test)]
mod duals_tests;
pub(crate) mod evaluate;
#[cfg(test)]
mod faults_tests;
pub(crate) mod pictures;
pub(crate) mod pixels;
pub(crate) mod plane;
pub(crate) mod program;
pub(crate) mod referee;
#[cfg(test)]
mod rewrites_tests;
pub(crate) mod subject;
pub(crate) mod weighed;

use serde::{Deserialize, Serialize};

/// Formulation of a program's sums.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum Form {
    /// As few sums as the search found.
    Factored,
    /// As `factored`, without the rewrites that move a factor between sides.
    Plain,
    /// One sum per output.
    Unfactored,
}

/// Result of the check of a stage's program.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Proof {
    /// Formulation that passed the check.
    pub form: Form,
    /// Whether the program equals the formulas exactly at random points modulo 2⁶¹ − 1.
    pub exact: bool,
    /// Largest error in f64, relative to the sum of the absolute terms; null if F and its derivatives are finite at no test
    /// point.
    pub error: Option<f64>,
    /// Largest error of the gradient in f32, scaled by √H_ii, relative to its largest entry; infinite (null in JSON) if a sum
    /// is finite in f64 but not in f32; null as above.
    pub f32_error: Option<f64>,
}

/// Tolerated error in f64 over the sum of the absolute terms.
const TOLERANCE: f64 = 1e-12;
/// The same in double-double, where only numbers that were folded in f64 may differ.
const REFEREE: f64 = 1e-13;
/// Terms below this, or their parts, have lost digits to the smallest numbers of f64.
const SMALLEST: f64 = 1e-80;
/// Error in f32 up to which a form is always accepted.
const F32_TOLERANCE: f64 = 1e-5;
/// Terms beyond this have powers that f64 does not hold: such a point is no evidence against a program.
const LARGEST: f64 = 1e100;
/// Points tried around the target.
const POINTS: u64 = 6;
/// Single pixels tried anywhere before a model counts as finite nowhere, and the number of finite ones that suffices.
const ANYWHERE: u64 = 400;
const ENOUGH: usize = 4;
/// Points of exact arithmetic for formulas with conditions: each point sees one branch of a condition.
const CONDITIONAL_POINTS: u64 = 8;

/// The errors of a program that passed.
pub(crate) struct Errors {
    pub exact: bool,
    pub error: Option<f64>,
}

/// True when the error in f32 needs no comparison with another form.
pub(crate) fn is_small_f32(error: Option<f64>) -> bool {
    error.is_none_or(|error| error <= F32_TOLERANCE)
}
