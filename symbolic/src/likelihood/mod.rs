//! The function that a fit minimises, pixel by pixel: its terms as the document states them, its [`shape`] as a function
//! of residual and variance, in numbers for the check and, independently, as nodes for the derivation
//! ([`contribution`]), and the [`claim`] of what a program sums.

pub(crate) mod claim;
mod contribution;
pub(crate) mod shape;
pub(crate) mod terms;
