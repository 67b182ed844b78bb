//! Exposure: an [`ExposureAdvice`] for each estimate, and an [`ExposureController`] that follows it.
//!
//! Independent of the camera: exposure is a factor relative to the initial one.

mod advice;
mod controller;
#[cfg(test)]
mod documents_tests;
mod goal;
mod light;
#[cfg(test)]
mod tests;
mod trial;

pub(crate) use advice::{Advisor, Best, is_advisable, outlook};
pub use controller::{ControllerOptions, ExposureController};
pub use goal::{ExposureAdvice, ExposureGoal};
pub(crate) use light::{Kernels, RenderedLight};
