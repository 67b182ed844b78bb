//! The check that every program passes once, when it is made: does it compute what the document's formulas say?
//!
//! What comes in: a [`Draft`](draft::Draft), and the formulas that it was derived from. What goes out: a
//! [`Program`](crate::program::Program), which nobody outside of this crate gets in another way. The reference is forward
//! differentiation ([`crate::proof::hyper`]) at made-up points, which shares nothing with the derivation but the graph of the
//! formulas as they were read:
//! 1. in exact arithmetic modulo a prime, elementary functions being values without meaning;
//! 2. in f64 at plausible points, to 1e-12 of the sum of the absolute terms; double-double decides where rounding exceeds that;
//! 3. in f32 by the interpreter, against f64, about the target and at pixels up to 4,096 px from there: the gradient's error,
//!    scaled by √H_ii, over its largest entry;
//! 4. the row bounds and masks of the pixel set, against the domain itself and the limits of the channels;
//! 5. over a window with rows that have no pixel, are all saturated, or are outside of the domain, where formulas may be NaN.
//!
//! That holds for every lowering of sums ([`referee`]) and of planes ([`plane`]). What the check may cost is in [`budget`].

pub(crate) mod budget;
pub(crate) mod claim;
pub(crate) mod direct;
pub(crate) mod draft;
#[cfg(test)]
mod duals_tests;
pub(crate) mod evaluate;
#[cfg(test)]
mod faults_tests;
pub(crate) mod hyper;
pub(crate) mod likelihood;
pub(crate) mod pixels;
pub(crate) mod plane;
pub(crate) mod points;
pub(crate) mod referee;
#[cfg(test)]
mod rewrites_tests;
pub(crate) mod subject;
pub(crate) mod weighed;

use serde::{Deserialize, Serialize};

/// How a program's sums are written down.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum Form {
    /// As few sums as the search found.
    Factored,
    /// The same without the rewrites that let a factor change sides.
    Plain,
    /// One sum for every output.
    Unfactored,
}

/// What the check found; part of a model's report.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Proof {
    /// Which form passed.
    pub form: Form,
    /// Equality held exactly at random points modulo 2⁶¹ − 1.
    pub exact: bool,
    /// The largest error in f64 over the sum of the absolute terms; `None` when F or a derivative is not finite at any of
    /// the made-up points.
    pub error: Option<f64>,
    /// The largest error of the gradient in f32, scaled by √H_ii, over its largest entry; infinite where f32 loses a sum that it
    /// has the formulas of; `None` as above.
    pub f32_error: Option<f64>,
}

/// Error in f64 over the sum of the absolute terms.
const TOLERANCE: f64 = 1e-12;
/// The same in double-double: numbers that were folded in f64 are all that may differ.
const REFEREE: f64 = 1e-13;
/// Terms below this have lost digits to the smallest numbers of f64, if not themselves, so what they are made of.
const SMALLEST: f64 = 1e-80;
/// Error in f32 that no form is turned down for.
const F32_TOLERANCE: f64 = 1e-5;
/// Terms beyond this have powers that f64 does not hold: what is said of such a point is not held against a program.
const LARGEST: f64 = 1e100;
/// Points tried around the target, …
const POINTS: u64 = 6;
/// … single pixels anywhere, before a model is said to be finite nowhere, and how many of those are enough.
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
