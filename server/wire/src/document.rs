//! What a client sends: the documents of sources and sessions. Unknown keys are refused.

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

/// `PUT /v1/sessions/{name}`: everything but `source` and `model` has a default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SessionDocument {
    /// Where the frames come from: a document of its own, or the name of a source that exists.
    pub source: SourceReference,
    /// Name of a model of the registry.
    pub model: String,
    /// Constants of the model, by name; those not given keep the document's default.
    #[serde(default)]
    pub constants: BTreeMap<String, f64>,
    /// Starting values that replace the document's, by parameter.
    #[serde(default)]
    pub start: BTreeMap<String, f64>,
    /// Pixels to look at; the whole frame when absent.
    #[serde(default)]
    pub window: Option<WindowDocument>,
    /// What the camera is.
    #[serde(default)]
    pub camera: Camera,
    /// The target's geometry; `{}` when it has none.
    #[serde(default, deserialize_with = "target_or_none", serialize_with = "target_or_empty")]
    #[schema(schema_with = target_schema)]
    pub target: Option<Target>,
    /// How it is computed.
    #[serde(default)]
    pub options: SessionOptions,
}

/// Options of a session.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SessionOptions {
    /// Arithmetic of the pixel loops.
    pub precision: Precision,
    /// How many targets to follow, each an instance of the model: one estimate a frame for each.
    #[serde(skip_serializing_if = "is_one")]
    pub targets: usize,
    /// One of several things is taken for a target from this confidence on, 0 … 1.
    #[serde(skip_serializing_if = "is_usual_confidence")]
    pub confidence_min: f64,
    /// How targets move.
    #[serde(skip_serializing_if = "MotionDocument::is_usual")]
    pub motion: MotionDocument,
    /// What exposure is for.
    pub exposure: ExposureOptions,
    /// How far ahead each estimate looks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub predict: Option<PredictDocument>,
    /// Models are swapped in whose fits take longer than frames of the source may.
    #[serde(skip_serializing_if = "is_false")]
    pub allow_slow: bool,
}

/// Looking ahead.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PredictDocument {
    /// To so much later, s.
    pub horizon_s: f64,
    /// In so many equal steps.
    pub steps: usize,
}

impl Default for SessionOptions {
    fn default() -> SessionOptions {
        SessionOptions {
            precision: Precision::default(),
            targets: 1,
            confidence_min: isophote_tracker::CONFIDENCE_MIN,
            motion: MotionDocument::default(),
            exposure: ExposureOptions::default(),
            predict: None,
            allow_slow: false,
        }
    }
}

/// How targets move.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MotionDocument {
    /// Standard deviation of the acceleration, px/s²; follows what is seen when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub acceleration_px_s2: Option<f64>,
    /// For so long a target that is not seen is predicted; then it is lost. s.
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

/// What exposure is for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ExposureOptions {
    /// What is to be measured best.
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
    /// First slice, with three coordinates; with `depth` absent, all from there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub z: Option<usize>,
    /// Slices.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth: Option<usize>,
    /// First volume, with four coordinates; with `length` absent, all from there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub w: Option<usize>,
    /// Volumes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub length: Option<usize>,
}

/// A source of its own, or the name of one that exists.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[serde(untagged)]
pub enum SourceReference {
    /// A source that several sessions may share.
    Named(String),
    /// A source that lives and ends with the session.
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

/// `POST /v1/models/{name}:rollback`
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RollbackDocument {
    /// A version that is kept.
    pub version: u64,
}

/// `PUT /v1/sources/{name}`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum SourceDocument {
    /// Renders a model, with truth.
    Synthetic(SyntheticDocument),
    /// Files in name order.
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

/// When the next frame comes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Pace {
    /// At `rate_hz`, whether or not the fit keeps up: the newest frame wins.
    #[default]
    Realtime,
    /// When every subscribed session has finished the last one, and not faster than `rate_hz` (0: no limit): no frame
    /// is ever lost.
    Fit,
}

/// The synthetic camera. Defaults are those of `isophote render`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SyntheticDocument {
    /// Name of a model of the registry.
    pub model: String,
    /// Parameters that stand still.
    #[serde(default)]
    pub set: BTreeMap<String, f64>,
    /// Parameters that move: formulas in `t`, seconds since the first frame.
    #[serde(default)]
    pub motion: BTreeMap<String, String>,
    /// px.
    #[serde(default = "default_width")]
    pub width: usize,
    /// px.
    #[serde(default = "default_height")]
    pub height: usize,
    /// Slices, for a model of three coordinates and more.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth: Option<usize>,
    /// Volumes, for a model of four coordinates.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub length: Option<usize>,
    /// Frames a second.
    #[serde(default = "default_synthetic_rate_hz")]
    pub rate_hz: f64,
    /// When the next frame comes.
    #[serde(default)]
    pub pace: Pace,
    /// Of a pixel, 1 to 16.
    #[serde(default = "default_bits")]
    pub bits: u32,
    /// Sub-pixel samples a side.
    #[serde(default = "default_samples")]
    pub samples: u32,
    /// Electrons at `saturation`; 0: no noise.
    #[serde(default)]
    pub full_well_e: f64,
    /// Electrons, 1 σ.
    #[serde(default)]
    pub read_noise_e: f64,
    /// What all pixels of a row are off by together, electrons, 1 σ.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub row_noise_e: f64,
    /// So many times the light, times what a session sets.
    #[serde(default = "default_factor", skip_serializing_if = "is_default_factor")]
    pub exposure: Moving,
    /// DN for each DN, after the electrons are counted.
    #[serde(default = "default_factor", skip_serializing_if = "is_default_factor")]
    pub gain: Moving,
    /// Largest pixel value; 2^bits − 1 when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub saturation: Option<f64>,
    /// The pixel value without light; with a `response` only.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub black: f64,
    /// How pixel values follow from light, as in a camera's document; the model's intensity is light above `black` then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub response: Option<CameraResponse>,
    /// Glare, occluders, blindness, defocus, hot pixels.
    #[serde(default, skip_serializing_if = "Light::is_clean")]
    pub light: Box<Light>,
    /// The same seed gives the same frames.
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// Frames from setting an exposure to the first frame that has it.
    #[serde(default = "default_exposure_latency", skip_serializing_if = "is_default_exposure_latency")]
    pub exposure_latency: u32,
}

impl SyntheticDocument {
    /// `saturation`, or what `bits` allows.
    pub fn saturation_level(&self) -> f64 {
        self.saturation.unwrap_or(f64::from((1u32 << self.bits.clamp(1, 16)) - 1))
    }
}

/// A folder or file of PNG, JPEG, TIFF, FITS, Y4M, MCAP or CSV.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RecordingDocument {
    /// On the machine of the service.
    pub path: String,
    /// Frames a second.
    #[serde(default = "default_rate_hz")]
    pub rate_hz: f64,
    /// When the next frame comes.
    #[serde(default)]
    pub pace: Pace,
    /// Begin again after the last file.
    #[serde(default, rename = "loop")]
    pub repeat: bool,
}

/// Frames that clients send to `/v1/sessions/{name}/frames`, with `POST` or over a WebSocket.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PushedDocument {
    /// px.
    pub width: usize,
    /// px.
    pub height: usize,
    /// Of raw frames.
    #[serde(default)]
    pub format: PushedFormat,
}

/// Pixels of raw frames; rows without padding.
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
    /// A path such as `/dev/video0`, or an identity as `GET /v1/cameras` lists it, which stays when numbers change.
    pub device: String,
    /// Four-character code; the best that has the size and reaches the rate when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub format: Option<String>,
    /// px; with `height`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub width: Option<u32>,
    /// px; with `width`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub height: Option<u32>,
    /// Frames a second, at least.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rate_hz: Option<f64>,
    /// Which planes the frames of a colour camera have.
    #[serde(default, skip_serializing_if = "is_all")]
    pub colour: Colour,
    /// Frames from setting an exposure to the first frame that has it.
    #[serde(default = "default_exposure_latency", skip_serializing_if = "is_default_exposure_latency")]
    pub exposure_latency: u32,
    /// Exposure, gain and so on, by name; what is automatic and in their way is switched off.
    #[serde(default)]
    pub controls: ControlValues,
}

fn is_all(colour: &Colour) -> bool {
    *colour == Colour::default()
}

/// `PUT /v1/cameras/{device}/controls` answers what the driver made of the controls that were sent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ControlsAnswer {
    /// By name, as read back.
    pub controls: ControlValues,
}

/// `PUT /v1/sessions/{name}/model`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SwapDocument {
    /// Name of a model of the registry.
    pub model: String,
    /// It is taken though its fits take longer than frames of the source may.
    #[serde(default, skip_serializing_if = "is_false")]
    pub allow_slow: bool,
}

/// What a subscriber sends: how many more messages it wants. Keys that are not known here are left alone: clients may be newer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct CreditDocument {
    /// Messages.
    pub credit: u32,
}

/// What is known of a pushed frame: the query of a `POST`; over a WebSocket, a text message before the frame's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct FrameTime {
    /// When the frame was taken, s on the client's own clock.
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
    let nothing = ObjectBuilder::new().max_properties(Some(0)).description(Some("It has none."));
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
