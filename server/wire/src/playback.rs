//! Scenes of synthetic sources; playback of those and of recordings.

use std::collections::BTreeMap;

use isophote_capture::{Light, Moving};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::document::SyntheticDocument;

/// Body of `PUT /v1/sources/{name}/scene`: the part of a synthetic source that may change while it runs. Absent keys keep their
/// values; present ones are replaced as a whole.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneDocument {
    /// Fixed parameters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub set: Option<BTreeMap<String, f64>>,
    /// Moving parameters: formulas in `t`, seconds since the first frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motion: Option<BTreeMap<String, String>>,
    /// Factor on the light and on the exposure that a session sets.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure: Option<Moving>,
    /// Gain applied after the electrons are counted, to light and noise alike.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gain: Option<Moving>,
    /// Electrons at `saturation`; 0: no noise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub full_well_e: Option<f64>,
    /// Read noise: standard deviation, electrons.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub read_noise_e: Option<f64>,
    /// Noise that all pixels of a row share: standard deviation, electrons.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub row_noise_e: Option<f64>,
    /// Disturbances: glare, occluders, blindness, defocus, hot pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light: Option<Box<Light>>,
}

impl SceneDocument {
    /// The complete scene of a source.
    pub fn of(document: &SyntheticDocument) -> SceneDocument {
        SceneDocument {
            set: Some(document.set.clone()),
            motion: Some(document.motion.clone()),
            exposure: Some(document.exposure.clone()),
            gain: Some(document.gain.clone()),
            full_well_e: Some(document.full_well_e),
            read_noise_e: Some(document.read_noise_e),
            row_noise_e: Some(document.row_noise_e).filter(|deviation| *deviation != 0.0),
            light: Some(document.light.clone()),
        }
    }

    /// Applies this scene to a source.
    pub fn over(self, document: SyntheticDocument) -> SyntheticDocument {
        SyntheticDocument {
            set: self.set.unwrap_or(document.set),
            motion: self.motion.unwrap_or(document.motion),
            exposure: self.exposure.unwrap_or(document.exposure),
            gain: self.gain.unwrap_or(document.gain),
            full_well_e: self.full_well_e.unwrap_or(document.full_well_e),
            read_noise_e: self.read_noise_e.unwrap_or(document.read_noise_e),
            row_noise_e: self.row_noise_e.unwrap_or(document.row_noise_e),
            light: self.light.unwrap_or(document.light),
            ..document
        }
    }
}

/// The scene in force.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SceneView {
    /// The complete scene.
    #[serde(flatten)]
    pub scene: SceneDocument,
    /// Frames from this number on show this scene or a later one.
    pub since_frame: u64,
}

/// Body of `PUT /v1/sources/{name}/playback`. Absent keys keep their values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PlaybackDocument {
    /// Whether playback is paused.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub paused: Option<bool>,
    /// Recording: continue from the frame at this position, counted from 0; while paused, show only that frame. Synthetic source,
    /// which must be paused: continue until the frame of this number is shown. A repeated request does not show the frame again.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<u64>,
    /// Factor on the source's rate, 0.05 to 16.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed: Option<f64>,
    /// Recording: begin again after the last frame.
    #[serde(default, rename = "loop", skip_serializing_if = "Option::is_none")]
    pub repeat: Option<bool>,
}

/// State of a source's playback.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PlaybackView {
    /// Whether playback is paused.
    pub paused: bool,
    /// Recording: position of the last frame shown, or of the frame from which it is about to continue. Synthetic source: number of
    /// the last frame shown.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub frame: Option<u64>,
    /// Recording: number of frames.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub length: Option<u64>,
    /// Factor on the source's rate.
    pub speed: f64,
    /// Recording: whether it begins again after the last frame.
    #[serde(skip_serializing_if = "Option::is_none", default, rename = "loop")]
    pub repeat: Option<bool>,
    /// Number of the next frame in estimates; it only grows.
    pub next_frame: u64,
}
