//! The published pose of a target, and the alternative poses that the data hardly distinguish.

use serde::{Deserialize, Serialize};

/// Pose of the target: `X_camera = R X_target + position`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Pose {
    /// The target's origin in the camera's frame (x right, y down, z forward), mm.
    pub position_mm: [f64; 3],
    /// Rotation R from target axes to camera axes, as a unit quaternion x, y, z, w with w ≥ 0.
    pub orientation_xyzw: [f64; 4],
    /// 6 × 6 covariance, row by row: x, y, z, then a small rotation about the camera's axes; mm², mm rad, rad².
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub covariance: Option<Vec<f64>>,
    /// Six; five for one round spot, whose spin is not observable: the variance of the spin is then that of an unknown angle,
    /// π²/3.
    pub degrees_of_freedom: u32,
    /// χ² of the pose: squared deviations of the spots' ellipses from it, in their standard deviations, summed. Absent if the
    /// pose was fitted to the pixels; the estimate's own χ² applies then.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub chi_square: Option<f64>,
    /// Names of spots that do not contribute to a pose fitted to the pixels: hidden, dark, outside the frame, or inconsistent
    /// with the others.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub left_out: Vec<String>,
    /// Other poses that the data hardly distinguish from this one, the best first.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub alternatives: Vec<Alternative>,
}

/// An alternative pose: another minimum of χ².
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Alternative {
    /// The target's origin, as in [`Pose`], mm.
    pub position_mm: [f64; 3],
    /// Rotation, as in [`Pose`].
    pub orientation_xyzw: [f64; 4],
    /// Excess of its χ² over that of the published pose.
    pub delta_chi_square: f64,
}

/// Minima are published up to this Δχ²: the wrong one of two exceeds it once in six hundred times or less.
pub(crate) const DELTA_CHI_SQUARE_MAX: f64 = 10.0;
