//! What a source shows and how it goes on, while it runs: scenes of synthetic sources, playback of those and of recordings.

use std::collections::BTreeMap;

use isophote_capture::{Light, Moving};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::document::SyntheticDocument;

/// `PUT /v1/sources/{name}/scene`: the part of a synthetic source that changes while it runs. What is not named is as it was; what
/// is named is replaced as a whole.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneDocument {
    /// Parameters that stand still.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub set: Option<BTreeMap<String, f64>>,
    /// Parameters that move: formulas in `t`, seconds since the first frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motion: Option<BTreeMap<String, String>>,
    /// So many times the light, times what a session sets.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure: Option<Moving>,
    /// DN for each DN, after the electrons are counted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gain: Option<Moving>,
    /// Electrons at `saturation`; 0: no noise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub full_well_e: Option<f64>,
    /// Electrons, 1 σ.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub read_noise_e: Option<f64>,
    /// What all pixels of a row are off by together, electrons, 1 σ.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub row_noise_e: Option<f64>,
    /// Glare, occluders, blindness, defocus, hot pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light: Option<Box<Light>>,
}

impl SceneDocument {
    /// All of a source's.
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

    /// The source with this scene.
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
    /// All of it.
    #[serde(flatten)]
    pub scene: SceneDocument,
    /// Frames from this number on show it, or one that was put after it.
    pub since_frame: u64,
}

/// `PUT /v1/sources/{name}/playback`: what is not named is as it was.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PlaybackDocument {
    /// Whether it stands still.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub paused: Option<bool>,
    /// Of a recording: go on with the frame at this place, from 0; while it stands still just that frame is shown. Of a synthetic
    /// source, which has to stand still: go on until the frame of this number was shown. Asked for again, it is not shown again.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<u64>,
    /// So many times its rate, 0.05 to 16.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed: Option<f64>,
    /// Of a recording: begin again after the last frame.
    #[serde(default, rename = "loop", skip_serializing_if = "Option::is_none")]
    pub repeat: Option<bool>,
}

/// How a source goes on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PlaybackView {
    /// Whether it stands still.
    pub paused: bool,
    /// Of a recording: the place of the frame that was shown last, or where it is about to go on. Of a synthetic source: the number
    /// of the frame that was shown last.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub frame: Option<u64>,
    /// Of a recording: how many frames it has.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub length: Option<u64>,
    /// So many times its rate.
    pub speed: f64,
    /// Of a recording: whether it begins again after the last frame.
    #[serde(skip_serializing_if = "Option::is_none", default, rename = "loop")]
    pub repeat: Option<bool>,
    /// The number that the next frame will have in estimates: it only grows.
    pub next_frame: u64,
}
