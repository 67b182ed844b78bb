//! Bad light: what stands between a scene and a clean picture of it.
//!
//! In: the document [`Light`], whose numbers may be formulas of time. Out: for each frame a [`shine::Shine`], which changes
//! rows of light (DN, before noise) and rows of pixels (after it). It knows no model and draws no random numbers.
//!
//! ```text
//! scene ─► defocus ─► glare ─► occluders ─► veils ─► exposure ─► Poisson ─► read noise ─► gain ─► quantisation ─► hot ─► blind
//! ```

pub(crate) mod defocus;
mod read;
pub(crate) mod shine;

pub(crate) use read::{factor_at, read, read_factor};

use serde::{Deserialize, Serialize};

use crate::moving::Moving;

/// All that is wrong with the light; by default nothing is. `T` is [`Moving`] in a document.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Light<T = Moving> {
    /// The scene and its surroundings are blurred by a Gaussian of this standard deviation, px.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub defocus_px: Option<T>,
    /// Lobes of light over the scene.
    #[serde(default = "Vec::new", skip_serializing_if = "Vec::is_empty")]
    pub glare: Vec<Glare<T>>,
    /// Light that grows along x and y, DN/px, none in the middle of the frame. Where the sum is negative it is dark.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub slope: Option<[T; 2]>,
    /// Things in front of the scene, the later before the earlier.
    #[serde(default = "Vec::new", skip_serializing_if = "Vec::is_empty")]
    pub occluders: Vec<Occluder<T>>,
    /// Pixels at saturation, whatever the light.
    #[serde(default = "Vec::new", skip_serializing_if = "Vec::is_empty")]
    pub blind: Vec<Blind<T>>,
    /// Pixels that do not read the light.
    #[serde(default = "Vec::new", skip_serializing_if = "Vec::is_empty")]
    pub hot: Vec<Hot>,
}

/// Pixels here and there that read more than the light, or less, the same in all frames.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Hot {
    /// So large a share of all pixels, on average.
    pub share: f64,
    /// They read at least so much more, DN; negative: less …
    pub least: f64,
    /// … and at most so much, all values between alike.
    pub most: f64,
    /// Which ones they are.
    #[serde(default)]
    pub seed: u64,
}

/// A Gaussian lobe: `height`·exp(−r²/2σ²), averaged over each pixel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Glare<T = Moving> {
    /// Its middle, px; absent: a streak along x.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub x: Option<T>,
    /// Its middle, px; absent: a streak along y.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub y: Option<T>,
    /// Standard deviation, px.
    pub sigma_px: T,
    /// In its middle, DN.
    pub height: T,
    /// There from this time on, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from_s: Option<f64>,
    /// Gone from this time on, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to_s: Option<f64>,
}

/// A rectangle with a brightness of its own: it hides the share that it covers of a pixel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Occluder<T = Moving> {
    /// First column; from the first on when absent.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub x: Option<T>,
    /// First row; from the first on when absent.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub y: Option<T>,
    /// Columns; to the last when absent.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub width: Option<T>,
    /// Rows; to the last when absent.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub height: Option<T>,
    /// Its light, DN.
    pub value: T,
    /// There from this time on, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from_s: Option<f64>,
    /// Gone from this time on, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to_s: Option<f64>,
}

/// A rectangle whose pixels (those whose middle lies in it) stand at saturation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Blind<T = Moving> {
    /// First column; from the first on when absent.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub x: Option<T>,
    /// First row; from the first on when absent.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub y: Option<T>,
    /// Columns; to the last when absent.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub width: Option<T>,
    /// Rows; to the last when absent.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub height: Option<T>,
    /// A veil of light around it: along each side the integral of a Gaussian of this standard deviation, px, which adds the
    /// saturation limit at the rectangle's edge and falls off outside.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub soft_px: Option<T>,
    /// There from this time on, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from_s: Option<f64>,
    /// Gone from this time on, s.
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
    /// Nothing is wrong with it.
    pub fn is_clean(&self) -> bool {
        let Light { defocus_px, glare, slope, occluders, blind, hot } = self;
        let is_empty = glare.is_empty() && occluders.is_empty() && blind.is_empty() && hot.is_empty();
        is_empty && defocus_px.is_none() && slope.is_none()
    }
}

fn none<T>() -> Option<T> {
    None
}
