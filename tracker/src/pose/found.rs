//! What is published of a target: its pose, and the other poses that the data hardly tell from it.

use serde::{Deserialize, Serialize};

/// Where the target is: `X_camera = R X_target + position`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Pose {
    /// The target's origin in the camera's frame (x to the right, y down, z forward), mm.
    pub position_mm: [f64; 3],
    /// The rotation that turns target axes into camera axes, as a unit quaternion x, y, z, w with w ≥ 0.
    pub orientation_xyzw: [f64; 4],
    /// 6 × 6, row by row: x, y, z, then a small rotation about the camera's axes; mm², mm rad, rad².
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub covariance: Option<Vec<f64>>,
    /// Six; five for one round spot, whose spin nothing shows: its variance is then that of an angle of which nothing is
    /// known, π²/3.
    pub degrees_of_freedom: u32,
    /// What the spots' ellipses miss the pose by, in their own standard deviations, squared and summed. Absent where the
    /// pose was fitted to the pixels: the estimate's own χ² says it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub chi_square: Option<f64>,
    /// Names of spots that say nothing of a pose that was fitted to the pixels: hidden, dark, outside of the frame, or such
    /// that they do not agree with the others.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub left_out: Vec<String>,
    /// Other poses that the data hardly tell from this one, the best first.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub alternatives: Vec<Alternative>,
}

/// Another minimum.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Alternative {
    /// As in [`Pose`].
    pub position_mm: [f64; 3],
    /// As in [`Pose`].
    pub orientation_xyzw: [f64; 4],
    /// By how much its χ² is larger.
    pub delta_chi_square: f64,
}

/// Minima are published up to this Δχ²: the wrong one of two has it once in six hundred times or less.
pub(crate) const DELTA_CHI_SQUARE_MAX: f64 = 10.0;
