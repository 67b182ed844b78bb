//! From starting values to a fit: compiled kernels, the schedule's stages, the trust region, outliers, and other
//! backgrounds for a picture that a model does not describe.
//!
//! What comes in: planes, a window, parameters to start from. What goes out: a fit with its covariance and how it ended.
//! It must never know the frame before, or the time.

pub(crate) mod backgrounds;
mod bounded;
pub(crate) mod compiled;
pub(crate) mod control;
pub(crate) mod corrections;
pub(crate) mod covariance;
pub(crate) mod covered;
mod derived;
pub(crate) mod exact;
pub(crate) mod fit;
pub(crate) mod follow;
pub(crate) mod loops;
mod means;
pub(crate) mod outliers;
pub(crate) mod painted;
pub(crate) mod passes;
pub(crate) mod prepare;
pub(crate) mod readiness;
pub(crate) mod residuals;
mod round;
pub(crate) mod rows;
pub(crate) mod sampling;
pub(crate) mod shelf;
pub(crate) mod stage;
pub(crate) mod stage_kernels;
pub(crate) mod structure;
mod thinned;
pub(crate) mod trust;
pub(crate) mod veil;
pub(crate) mod workers;
