//! Documents that clients send for sources and sessions. Unknown keys are refused.

use std::collections::BTreeMap;
use std::fmt;

use isophote_capture::camera::ControlValues;
use isophote_capture::pixels::Colour;
use isophote_capture::{Light, Moving};
use isophote_symbolic::Precision;
pub use isophote_tracker::ExposureGoal;
use isophote_tracker::{Camera, CameraResponse, Target};
use serde::de::{self, Deserializer, MapAccess, Visitor};
use serde::{Deserialize, Serialize};
use utoipa::openapi::{ObjectBuilder, OneOfBuilder, Ref, Schema};
use utoipa::{IntoParams, ToSchema};

/// Body of `PUT /v1/sessions/{name}`. All fields except `source` and `model` have defaults.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SessionDocument {
    /// Source of the frames: a source document, or the name of an existing source.
    pub source: SourceReference,
    /// Name of a model in the registry.
    pub model: String,
    /// Constants of the model, by name; others keep the document's default.
    #[serde(default)]
    pub constants: BTreeMap<String, f64>,
    /// Starting values by parameter, replacing the document's.
    #[serde(default)]
    pub start: BTreeMap<String, f64>,
    /// Pixels to fit; the whole frame when absent.
    #[serde(default)]
    pub window: Option<WindowDocument>,
    /// Properties of the camera.
    #[serde(default)]
    pub camera: Camera,
    /// Geometry of the target; `{}` for none.
    #[serde(default, deserialize_with = "target_or_none", serialize_with = "target_or_empty")]
    #[schema(schema_with = target_schema)]
    pub target: Option<Target>,
    /// Options of fitting and tracking.
    #[serde(default)]
    pub options: SessionOptions,
}

/// Options of a session.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SessionOptions {
    /// Arithmetic of the pixel loops.
    pub precision: Precision,
    /// Number of targets to track, each an instance of the model with one estimate per frame.
    #[serde(skip_serializing_if = "is_one")]
    pub targets: usize,
    /// Minimum confidence to accept one of several candidates as a target, 0 … 1.
    #[serde(skip_serializing_if = "is_usual_confidence")]
    pub confidence_min: f64,
    /// Least signal-to-noise ratio of targets, 3 and above: everything with this response to a matched filter is fitted, and
    /// accepted whatever its confidence.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub snr_min: Option<f64>,
    /// Least and greatest size of targets: the geometric mean of their outline's half widths, px.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sizes_px: Option<[f64; 2]>,
    /// Motion of targets.
    #[serde(skip_serializing_if = "MotionDocument::is_usual")]
    pub motion: MotionDocument,
    /// Exposure advice and control.
    pub exposure: ExposureOptions,
    /// Prediction beyond each frame; none when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub predict: Option<PredictDocument>,
    /// Whether swaps accept models whose fits exceed the time limit of a frame.
    #[serde(skip_serializing_if = "is_false")]
    pub allow_slow: bool,
}

/// Prediction beyond each frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PredictDocument {
    /// Time from the frame to the last prediction, s.
    pub horizon_s: f64,
    /// Number of equal steps up to the horizon.
    pub steps: usize,
}

impl Default for SessionOptions {
    fn default() -> SessionOptions {
        SessionOptions {
            precision: Precision::default(),
            targets: 1,
            confidence_min: isophote_tracker::CONFIDENCE_MIN,
            snr_min: None,
            sizes_px: None,
            motion: MotionDocument::default(),
            exposure: ExposureOptions::default(),
            predict: None,
            allow_slow: false,
        }
    }
}

/// Motion of targets.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MotionDocument {
    /// Standard deviation of the acceleration, px/s²; learned from the track when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub acceleration_px_s2: Option<f64>,
    /// Time for which an unseen target is predicted before it is lost, s.
    pub coast_s: f64,
}

fn is_false(flag: &bool) -> bool {
    !flag
}

fn is_one(count: &usize) -> bool {
    *count == 1
}

fn is_usual_confidence(confidence_min: &f64) -> bool {
    *confidence_min == isophote_tracker::CONFIDENCE_MIN
}

impl MotionDocument {
    fn is_usual(&self) -> bool {
        *self == MotionDocument::default()
    }
}

impl Default for MotionDocument {
    fn default() -> MotionDocument {
        let isophote_tracker::MotionOptions { acceleration_px_s2, coast_s, .. } = Default::default();
        MotionDocument { acceleration_px_s2, coast_s }
    }
}

/// Exposure advice and control.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ExposureOptions {
    /// Quantity to measure most accurately.
    pub goal: ExposureGoal,
    /// Whether the session sets the source's exposure, as advised for the first target.
    pub control: bool,
}

/// A pixel rectangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct WindowDocument {
    /// First column, px.
    pub x: usize,
    /// First row, px.
    pub y: usize,
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
    /// First slice, for three and more coordinates; without `depth`, all slices from it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub z: Option<usize>,
    /// Number of slices.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth: Option<usize>,
    /// First volume, for four coordinates; without `length`, all volumes from it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub w: Option<usize>,
    /// Number of volumes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub length: Option<usize>,
}

/// A source document, or the name of an existing source.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[serde(untagged)]
pub enum SourceReference {
    /// Name of a source, which several sessions may share.
    Named(String),
    /// Source of this session alone, which ends with it.
    Own(Box<SourceDocument>),
}

impl<'de> serde::Deserialize<'de> for SourceReference {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<SourceReference, D::Error> {
        struct Either;
        impl<'de> Visitor<'de> for Either {
            type Value = SourceReference;
            fn expecting(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
                formatter.write_str("a source document or the name of a source")
            }
            fn visit_str<E: de::Error>(self, name: &str) -> Result<SourceReference, E> {
                Ok(SourceReference::Named(name.to_string()))
            }
            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<SourceReference, A::Error> {
                let document = SourceDocument::deserialize(de::value::MapAccessDeserializer::new(map))?;
                Ok(SourceReference::Own(Box::new(document)))
            }
        }
        deserializer.deserialize_any(Either)
    }
}

/// Body of `POST /v1/models/{name}:rollback`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RollbackDocument {
    /// A stored version of the model.
    pub version: u64,
}

/// A source: body of `PUT /v1/sources/{name}`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum SourceDocument {
    /// Renders a model, whose true parameters accompany the frames.
    Synthetic(SyntheticDocument),
    /// Plays files in name order.
    Recording(RecordingDocument),
    /// Frames that clients send.
    Pushed(PushedDocument),
    /// A V4L2 device.
    Camera(CameraDocument),
}

impl SourceDocument {
    /// The value of `kind`.
    pub fn kind(&self) -> &'static str {
        match self {
            SourceDocument::Synthetic(_) => "synthetic",
            SourceDocument::Recording(_) => "recording",
            SourceDocument::Pushed(_) => "pushed",
            SourceDocument::Camera(_) => "camera",
        }
    }
}

/// Timing of frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Pace {
    /// At `rate_hz`, whether or not the fit keeps up; a slow fit misses frames and gets the newest.
    #[default]
    Realtime,
    /// After every subscribed session has finished the previous frame, at most at `rate_hz` (0: no limit); no frame is lost.
    Fit,
}

/// A synthetic camera. Defaults are those of `isophote render`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SyntheticDocument {
    /// Name of a model in the registry.
    pub model: String,
    /// Fixed parameters.
    #[serde(default)]
    pub set: BTreeMap<String, f64>,
    /// Moving parameters: formulas in `t`, seconds since the first frame.
    #[serde(default)]
    pub motion: BTreeMap<String, String>,
    /// Width, px.
    #[serde(default = "default_width")]
    pub width: usize,
    /// Height, px.
    #[serde(default = "default_height")]
    pub height: usize,
    /// Number of slices, for models of three and more coordinates.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth: Option<usize>,
    /// Number of volumes, for models of four coordinates.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub length: Option<usize>,
    /// Frames per second.
    #[serde(default = "default_synthetic_rate_hz")]
    pub rate_hz: f64,
    /// Timing of frames.
    #[serde(default)]
    pub pace: Pace,
    /// Bits per pixel, 1 to 16.
    #[serde(default = "default_bits")]
    pub bits: u32,
    /// Sub-pixel samples per side.
    #[serde(default = "default_samples")]
    pub samples: u32,
    /// Electrons at `saturation`; 0: no noise.
    #[serde(default)]
    pub full_well_e: f64,
    /// Read noise: standard deviation, electrons.
    #[serde(default)]
    pub read_noise_e: f64,
    /// Noise that all pixels of a row share: standard deviation, electrons.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub row_noise_e: f64,
    /// Factor on the light and on the exposure that a session sets.
    #[serde(default = "default_factor", skip_serializing_if = "is_default_factor")]
    pub exposure: Moving,
    /// Gain applied after the electrons are counted, to light and noise alike.
    #[serde(default = "default_factor", skip_serializing_if = "is_default_factor")]
    pub gain: Moving,
    /// Pixel value at which pixels clip; 2^bits − 1 when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub saturation: Option<f64>,
    /// Pixel value without light; only with a `response`.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub black: f64,
    /// Dependence of pixel values on light, as in a camera's document; the model's intensity is then light above `black`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub response: Option<CameraResponse>,
    /// Disturbances: glare, occluders, blindness, defocus, hot pixels.
    #[serde(default, skip_serializing_if = "Light::is_clean")]
    pub light: Box<Light>,
    /// Seed of the noise; the same seed gives the same frames.
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// Frames from setting an exposure to the first frame that has it.
    #[serde(default = "default_exposure_latency", skip_serializing_if = "is_default_exposure_latency")]
    pub exposure_latency: u32,
}

impl SyntheticDocument {
    /// `saturation`, or the maximum of `bits`.
    pub fn saturation_level(&self) -> f64 {
        self.saturation.unwrap_or(f64::from((1u32 << self.bits.clamp(1, 16)) - 1))
    }
}

/// A folder or file of PNG, JPEG, TIFF, FITS, Y4M, MCAP or CSV.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RecordingDocument {
    /// Path on the machine of the service.
    pub path: String,
    /// Frames per second.
    #[serde(default = "default_rate_hz")]
    pub rate_hz: f64,
    /// Timing of frames.
    #[serde(default)]
    pub pace: Pace,
    /// Begin again after the last frame.
    #[serde(default, rename = "loop")]
    pub repeat: bool,
}

/// Frames that clients send to `/v1/sessions/{name}/frames`, with `POST` or over a WebSocket.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PushedDocument {
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    /// Pixel format of raw frames.
    #[serde(default)]
    pub format: PushedFormat,
}

/// Pixel format of raw frames; rows have no padding.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum PushedFormat {
    /// One byte.
    #[default]
    U8,
    /// Two bytes, little-endian.
    U16le,
    /// Four bytes, IEEE, little-endian.
    F32,
}

/// A V4L2 camera of the machine of the service.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CameraDocument {
    /// Path such as `/dev/video0`, or an identity from `GET /v1/cameras`, which stays the same when device numbers change.
    pub device: String,
    /// Four-character code of the format; when absent, the best format with the size and the rate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub format: Option<String>,
    /// Width, px; requires `height`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub width: Option<u32>,
    /// Height, px; requires `width`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub height: Option<u32>,
    /// Minimum frames per second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rate_hz: Option<f64>,
    /// Planes of the frames of a colour camera.
    #[serde(default, skip_serializing_if = "is_all")]
    pub colour: Colour,
    /// Frames from setting an exposure to the first frame that has it.
    #[serde(default = "default_exposure_latency", skip_serializing_if = "is_default_exposure_latency")]
    pub exposure_latency: u32,
    /// Controls by name, such as exposure and gain; automatic controls that would override them are switched off.
    #[serde(default)]
    pub controls: ControlValues,
}

fn is_all(colour: &Colour) -> bool {
    *colour == Colour::default()
}

/// Answer of `PUT /v1/cameras/{device}/controls`: the controls that were sent, as the driver applied them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ControlsAnswer {
    /// Controls by name, as read back.
    pub controls: ControlValues,
}

/// Body of `PUT /v1/sessions/{name}/model`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SwapDocument {
    /// Name of a model in the registry.
    pub model: String,
    /// Whether to accept a model whose fits exceed the time limit of a frame.
    #[serde(default, skip_serializing_if = "is_false")]
    pub allow_slow: bool,
}

/// Message of a subscriber that asks for more messages. Unknown keys are ignored, since clients may be newer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct CreditDocument {
    /// Number of further messages.
    pub credit: u32,
}

/// Time of a pushed frame: the query of a `POST`; over a WebSocket, a text message before the frame's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct FrameTime {
    /// Time of the frame on the client's own clock, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_s: Option<f64>,
}

fn target_or_none<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Target>, D::Error> {
    let fields = serde_json::Map::<String, serde_json::Value>::deserialize(deserializer)?;
    if fields.is_empty() {
        return Ok(None);
    }
    serde_json::from_value(fields.into()).map(Some).map_err(de::Error::custom)
}

fn target_or_empty<S: serde::Serializer>(target: &Option<Target>, serializer: S) -> Result<S::Ok, S::Error> {
    match target {
        Some(target) => target.serialize(serializer),
        None => serde_json::Map::new().serialize(serializer),
    }
}

fn target_schema() -> Schema {
    let nothing = ObjectBuilder::new().max_properties(Some(0)).description(Some("No geometry."));
    OneOfBuilder::new().item(Ref::from_schema_name("Target")).item(nothing).build().into()
}

fn default_width() -> usize {
    640
}
fn default_height() -> usize {
    480
}
fn default_rate_hz() -> f64 {
    30.0
}
fn default_synthetic_rate_hz() -> f64 {
    60.0
}
fn default_bits() -> u32 {
    8
}
fn default_samples() -> u32 {
    8
}
fn default_exposure_latency() -> u32 {
    2
}
fn is_default_exposure_latency(frames: &u32) -> bool {
    *frames == default_exposure_latency()
}
fn default_factor() -> Moving {
    Moving::Number(1.0)
}
fn is_zero(number: &f64) -> bool {
    *number == 0.0
}
fn is_default_factor(factor: &Moving) -> bool {
    *factor == default_factor()
}
fn default_seed() -> u64 {
    1
}
