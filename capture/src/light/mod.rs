//! Illumination defects between a scene and its picture.
//!
//! The document [`Light`], whose numbers may be formulas of time, yields a [`defects::LightDefects`] per frame, which
//! changes rows of light (DN, before noise) and rows of pixels (after it).
//!
//! ```text
//! scene ─► defocus ─► glare ─► occluders ─► veils ─► exposure ─► Poisson ─► read noise ─► gain ─► quantisation ─► hot ─► blind
//! ```

pub(crate) mod defects;
pub(crate) mod defocus;
mod read;

pub(crate) use read::{factor_at, read, read_factor};

use serde::{Deserialize, Serialize};

use crate::moving::Moving;

/// Illumination and sensor defects of a scene; none by default. `T` is [`Moving`] in a document.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Light<T = Moving> {
    /// Standard deviation of the Gaussian that blurs the scene and its surroundings, px.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub defocus_px: Option<T>,
    /// Lobes of light added to the scene.
    #[serde(default = "Vec::new", skip_serializing_if = "Vec::is_empty")]
    pub glare: Vec<Glare<T>>,
    /// Gradient of additional light along x and y, DN/px; zero in the middle of the frame. Negative sums are set to 0.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub slope: Option<[T; 2]>,
    /// Rectangles in front of the scene; later ones cover earlier ones.
    #[serde(default = "Vec::new", skip_serializing_if = "Vec::is_empty")]
    pub occluders: Vec<Occluder<T>>,
    /// Rectangles of pixels at saturation, whatever the light.
    #[serde(default = "Vec::new", skip_serializing_if = "Vec::is_empty")]
    pub blind: Vec<Blind<T>>,
    /// Hot and dim pixels.
    #[serde(default = "Vec::new", skip_serializing_if = "Vec::is_empty")]
    pub hot: Vec<Hot>,
}

/// Randomly scattered pixels with an offset, the same in all frames.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Hot {
    /// Average share of all pixels, 0 to 1.
    pub share: f64,
    /// Smallest offset, DN; may be negative.
    pub least: f64,
    /// Largest offset, DN; offsets are uniformly distributed from `least` to `most`.
    pub most: f64,
    /// Seed of the random pixels and offsets.
    #[serde(default)]
    pub seed: u64,
}

/// A Gaussian lobe: `height`·exp(−r²/2σ²), averaged over each pixel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Glare<T = Moving> {
    /// Centre along x, px; absent: a streak along x.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub x: Option<T>,
    /// Centre along y, px; absent: a streak along y.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub y: Option<T>,
    /// Standard deviation, px.
    pub sigma_px: T,
    /// Height at the centre, DN.
    pub height: T,
    /// Time at which it appears, s. Absent: at the start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from_s: Option<f64>,
    /// Time at which it disappears, s. Absent: never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to_s: Option<f64>,
}

/// A rectangle of uniform brightness in front of the scene; it hides each pixel by the share that it covers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Occluder<T = Moving> {
    /// First column; absent: from the left edge of the frame.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub x: Option<T>,
    /// First row; absent: from the top edge of the frame.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub y: Option<T>,
    /// Number of columns; absent: to the right edge of the frame.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub width: Option<T>,
    /// Number of rows; absent: to the bottom edge of the frame.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub height: Option<T>,
    /// Light of the rectangle, DN.
    pub value: T,
    /// Time at which it appears, s. Absent: at the start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from_s: Option<f64>,
    /// Time at which it disappears, s. Absent: never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to_s: Option<f64>,
}

/// A rectangle whose pixels (those with their centre in it) are at saturation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Blind<T = Moving> {
    /// First column; absent: from the left edge of the frame.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub x: Option<T>,
    /// First row; absent: from the top edge of the frame.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub y: Option<T>,
    /// Number of columns; absent: to the right edge of the frame.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub width: Option<T>,
    /// Number of rows; absent: to the bottom edge of the frame.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub height: Option<T>,
    /// Standard deviation of a veil of light around the rectangle, px: along each side the integral of a Gaussian, which adds
    /// the saturation limit at the rectangle's edge and falls off outside.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub soft_px: Option<T>,
    /// Time at which it appears, s. Absent: at the start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from_s: Option<f64>,
    /// Time at which it disappears, s. Absent: never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to_s: Option<f64>,
}

impl<T> Default for Light<T> {
    fn default() -> Light<T> {
        Light {
            defocus_px: None,
            glare: Vec::new(),
            slope: None,
            occluders: Vec::new(),
            blind: Vec::new(),
            hot: Vec::new(),
        }
    }
}

impl<T> Light<T> {
    /// Whether there is no defect.
    pub fn is_clean(&self) -> bool {
        let Light { defocus_px, glare, slope, occluders, blind, hot } = self;
        let is_empty = glare.is_empty() && occluders.is_empty() && blind.is_empty() && hot.is_empty();
        is_empty && defocus_px.is_none() && slope.is_none()
    }
}

fn none<T>() -> Option<T> {
    None
}
