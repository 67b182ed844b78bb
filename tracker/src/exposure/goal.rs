//! The goal of an exposure, and the advice for it.

use serde::{Deserialize, Serialize};

/// The quantity to measure with the least uncertainty.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "kebab-case")]
pub enum ExposureGoal {
    /// The target's position.
    #[default]
    Centre,
    /// The target's brightness.
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

/// Recommended exposure for a target.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ExposureAdvice {
    /// Factor by which to multiply the light.
    pub factor: f64,
    /// The goal of the advice.
    pub goal: ExposureGoal,
    /// The reason, as a sentence.
    pub why: String,
}
