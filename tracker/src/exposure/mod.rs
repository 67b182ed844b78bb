//! Exposure: how much light would be best, and a controller that goes there.
//!
//! What comes in: estimates. What goes out: an [`ExposureAdvice`] with each, and from the [`ExposureController`] the exposure
//! to set. They never know a camera: exposure is a factor, 1 being what it was in the beginning.

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
