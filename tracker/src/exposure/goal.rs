//! What exposure is to be best for, and what would be.

use serde::{Deserialize, Serialize};

/// What is to be measured best.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
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
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ExposureAdvice {
    /// So many times as much light.
    pub factor: f64,
    /// For what.
    pub goal: ExposureGoal,
    /// A sentence.
    pub why: String,
}
