//! Exposure: how much light would be best, and a controller that goes there.
//!
//! What comes in: estimates. What goes out: an [`ExposureAdvice`] with each, and from the [`ExposureController`] the exposure
//! to set. They never know a camera: exposure is a factor, 1 being what it was in the beginning.

mod advice;
mod controller;
mod trial;

use serde::{Deserialize, Serialize};

pub(crate) use advice::{Advisor, outlook};
pub use controller::{ControllerOptions, ExposureController};
pub(crate) use trial::{Kernels, Light};

/// What is to be measured best.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ExposureGoal {
    /// Where the target is.
    #[default]
    Centre,
    /// How bright it is.
    Brightness,
}

impl ExposureGoal {
    /// The name in documents.
    pub fn name(self) -> &'static str {
        match self {
            ExposureGoal::Centre => "centre",
            ExposureGoal::Brightness => "brightness",
        }
    }
}

/// What exposure would be best for a target.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExposureAdvice {
    /// So many times as much light.
    pub factor: f64,
    /// For what.
    pub goal: ExposureGoal,
    /// A sentence.
    pub why: String,
}

#[cfg(test)]
mod tests;
