//! From starting values to a fit: compiled kernels, stages, the trust region, outliers, and backgrounds added to a model.
//!
//! A fit starts from given planes, window and parameters; it keeps no state of earlier frames and has no notion of time.

pub(crate) mod backgrounds;
mod bounded;
pub(crate) mod compiled;
pub(crate) mod corrections;
pub(crate) mod covariance;
mod derived;
pub(crate) mod exact;
pub(crate) mod fit;
pub(crate) mod inpainted;
pub(crate) mod loops;
mod means;
pub(crate) mod nan_masked;
pub(crate) mod occlusion;
pub(crate) mod outliers;
pub(crate) mod passes;
pub(crate) mod pixel_handling;
pub(crate) mod prepare;
pub(crate) mod prepared;
mod prior;
pub(crate) mod readiness;
pub(crate) mod refine;
pub(crate) mod residuals;
mod round;
pub(crate) mod rows;
pub(crate) mod sampling;
pub(crate) mod stage;
pub(crate) mod stage_kernels;
pub(crate) mod structure;
mod subsampled;
pub(crate) mod trust;
pub(crate) mod workers;
