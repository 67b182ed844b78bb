//! Specification of a synthetic camera, checked before anything is rendered.

use std::collections::BTreeMap;
use std::sync::Arc;

use isophote_frame::{CameraResponse, LIGHT_MAX, NUMBER_MAX, Response, ResponseError, plain};
use isophote_symbolic::{Diagnostics, Estimator, Model, Start};

use crate::light::Light;
use crate::limits::LIMITS;
use crate::moving::{Moving, MovingFault};

/// Scene and camera to render. `SyntheticSpec::new(model)` has the contract's defaults.
#[derive(Clone, Debug)]
pub struct SyntheticSpec {
    /// Model with one channel, or with several listed individually in `observed`.
    pub model: Arc<Model>,
    /// Parameters and constants by name; for defaults see [`Synthetic`].
    pub set: BTreeMap<String, f64>,
    /// Parameters by name as formulas of `t`, seconds since the first frame.
    pub motion: BTreeMap<String, String>,
    /// Pixels of a row.
    pub width: usize,
    /// Rows; ignored for one-dimensional models, which have one.
    pub height: usize,
    /// Slices, for models of three or more coordinates; otherwise 1.
    pub depth: usize,
    /// Volumes, for models of four coordinates; otherwise 1.
    pub length: usize,
    /// Frame rate, Hz: t of frame n is n / rate.
    pub rate_hz: f64,
    /// Bits per pixel, 1 to 16; above 8 planes are u16.
    pub bits: u32,
    /// Sub-pixel samples per pixel side.
    pub samples: u32,
    /// Electrons at the saturation limit; 0 disables noise.
    pub full_well_e: f64,
    /// Standard deviation of the read noise, electrons.
    pub read_noise_e: f64,
    /// Standard deviation of the offset that a row's pixels share, electrons.
    pub row_noise_e: f64,
    /// Factor of the light, multiplied by that of [`Exposure`](crate::Exposure).
    pub exposure: Moving,
    /// Gain after the electrons are counted: it amplifies light and noise, but not rounding.
    pub gain: Moving,
    /// Clipping limit of the pixel values, DN.
    pub saturation: f64,
    /// Pixel value without light, DN; only with a response.
    pub black: f64,
    /// Response from light to pixel values; the model's intensity is then light in DN above black. Without one it is the
    /// value.
    pub response: Option<CameraResponse>,
    /// Glare, occluders, blindness, defocus.
    pub light: Light,
    /// Seed of the noise; equal seeds give equal frames.
    pub seed: u64,
    /// Frames between setting an exposure and the first frame that uses it.
    pub exposure_latency: u32,
}

impl SyntheticSpec {
    /// 640 × 480 pixels of 8 bit at 60 Hz, 8 × 8 samples, no noise; 64 × 64 × 32 with three coordinates, 32 × 32 × 16 × 8
    /// with four.
    pub fn new(model: Arc<Model>) -> SyntheticSpec {
        let [width, height, depth, length] = match model.coordinates().len() {
            0..=2 => [640, 480, 1, 1],
            3 => [64, 64, 32, 1],
            _ => [32, 32, 16, 8],
        };
        SyntheticSpec {
            model,
            set: BTreeMap::new(),
            motion: BTreeMap::new(),
            width,
            height,
            depth,
            length,
            rate_hz: 60.0,
            bits: 8,
            samples: 8,
            full_well_e: 0.0,
            read_noise_e: 0.0,
            row_noise_e: 0.0,
            exposure: Moving::Number(1.0),
            gain: Moving::Number(1.0),
            saturation: 255.0,
            black: 0.0,
            response: None,
            light: Light::default(),
            seed: 1,
            exposure_latency: 2,
        }
    }
}

impl SyntheticSpec {
    /// The prepared response, if any.
    pub(crate) fn prepared_response(&self) -> Result<Option<Response>, ResponseError> {
        let Some(response) = &self.response else { return Ok(None) };
        response.check_size(&[self.width, self.height])?;
        Response::new(self.black, Some(self.saturation), response).map(Some)
    }
}

/// Why a synthetic camera cannot be created or changed.
#[derive(Debug, thiserror::Error)]
pub enum SyntheticError {
    /// A number out of range.
    #[error("{name} is {}; it must be {range}", plain(*value))]
    Range {
        /// Name in the contract.
        name: &'static str,
        /// Given value.
        value: f64,
        /// Allowed range.
        range: String,
    },
    /// A name that is not in the model.
    #[error("the model `{model}` has no {wanted} named `{name}`; {remedy}")]
    UnknownName {
        /// The model's name.
        model: String,
        /// "parameter", or "parameter or constant".
        wanted: &'static str,
        /// Given name.
        name: String,
        /// The probable name, or all names.
        remedy: String,
    },
    /// An invalid motion formula.
    #[error("the motion of `{name}` is no formula of t: {}", first_message(diagnostics))]
    Motion {
        /// The parameter.
        name: String,
        /// Parser diagnostics.
        diagnostics: Diagnostics,
    },
    /// An invalid light, exposure, gain or value of `set`.
    #[error("`{key}` {reason}")]
    Light {
        /// Key in the document, such as `light.glare[0].x`, `exposure`, `gain` or `set.bx`.
        key: String,
        /// Fault.
        reason: String,
    },
    /// An invalid response.
    #[error(transparent)]
    Response(#[from] ResponseError),
    /// A new scene whose formulas cannot be evaluated for the next frame.
    #[error("the next frame could not be seen: {reason}")]
    Unseen {
        /// Fault.
        reason: String,
    },
    /// The model cannot be rendered.
    #[error("the model `{model}` cannot be rendered: {reason}")]
    Model {
        /// The model's name.
        model: String,
        /// Cause.
        reason: String,
    },
}

pub(crate) fn first_message(diagnostics: &Diagnostics) -> String {
    diagnostics.first().map_or_else(String::new, |d| match &d.help {
        Some(help) => format!("{} ({help})", d.message),
        None => d.message.clone(),
    })
}

pub(crate) fn wrong_light((key, fault): (String, MovingFault)) -> SyntheticError {
    let reason = match fault {
        MovingFault::Range(reason) => reason,
        MovingFault::Formula(diagnostics) => format!("is no formula of t: {}", first_message(&diagnostics)),
    };
    SyntheticError::Light { key, reason }
}

pub(crate) fn check(spec: &SyntheticSpec) -> Result<(), SyntheticError> {
    let whole = |name, value: u64, to: u64| match (1..=to).contains(&value) {
        true => Ok(()),
        false => Err(SyntheticError::Range { name, value: value as f64, range: format!("1 to {to}") }),
    };
    whole("width", spec.width as u64, LIMITS.side_px.into())?;
    whole("height", spec.height as u64, LIMITS.side_px.into())?;
    // A third coordinate needs several slices, since one slice does not determine a target's position along it.
    for (axis, name, count) in [(2, "depth", spec.depth), (3, "length", spec.length)] {
        let least = if spec.model.coordinates().len() > axis { 2 } else { 1 };
        let most = if least == 2 { LIMITS.side_px as usize } else { 1 };
        if !(least..=most).contains(&count) {
            let coordinates = spec.model.coordinates();
            let range = match coordinates.get(axis) {
                Some(name) => format!("2 to {most} for the coordinate `{name}`"),
                None => format!("1 for the {} coordinates of `{}`", coordinates.len(), spec.model.name()),
            };
            return Err(SyntheticError::Range { name, value: count as f64, range });
        }
    }
    let [picture, depth, length] = [spec.width * spec.height, spec.depth, spec.length].map(|n| n as u64);
    whole("width × height", picture, LIMITS.frame_pixels)?;
    whole("width × height × depth × length", picture.saturating_mul(depth * length), LIMITS.frame_pixels)?;
    whole("samples", spec.samples.into(), LIMITS.samples.into())?;
    whole("bits", spec.bits.into(), LIMITS.bits.into())?;
    let largest = f64::from((1u32 << spec.bits) - 1);
    let in_range = |name, value: f64, holds: bool, range: &str| match holds && value.is_finite() {
        true => Ok(()),
        false => Err(SyntheticError::Range { name, value, range: range.into() }),
    };
    let (saturation, range) =
        (spec.saturation, format!("at least 1 and at most {largest}, the largest of {} bits", spec.bits));
    in_range("saturation", saturation, (1.0..=largest).contains(&saturation), &range)?;
    in_range("black", spec.black, spec.black == 0.0 || spec.response.is_some(), "0 without a `response`")?;
    spec.prepared_response()?;
    let latency = f64::from(spec.exposure_latency);
    in_range("exposure_latency", latency, spec.exposure_latency <= LIMITS.exposure_latency, "0 to 64")?;
    in_range("rate_hz", spec.rate_hz, spec.rate_hz > 0.0, "positive")?;
    let electrons = [
        ("full_well_e", spec.full_well_e, "0 (no noise) or positive"),
        ("read_noise_e", spec.read_noise_e, "0 or positive"),
        ("row_noise_e", spec.row_noise_e, "0 or positive"),
    ];
    for (name, electrons, range) in electrons {
        let range = format!("{range}, and {} at most", plain(LIGHT_MAX));
        in_range(name, electrons, (0.0..=LIGHT_MAX).contains(&electrons), &range)?;
    }
    Ok(())
}

/// Parameters and constants of the first frame, without motion.
pub(crate) fn numbers(spec: &SyntheticSpec) -> Result<(Vec<f64>, Vec<f64>), SyntheticError> {
    let model = &spec.model;
    let mut parameters = model.parameters().iter();
    let is_dark = parameters
        .any(|p| matches!(p.start, Start::Estimator(Estimator::Amplitude)) && p.max.is_some_and(|max| max <= 0.0));
    // In DN of 255: the background, and the target above it.
    let brightness = if is_dark { [200.0, -150.0] } else { [20.0, 150.0] };
    let start = |start: &Start| match start {
        Start::Number(number) => *number,
        Start::Estimator(estimator) => typical(*estimator, spec, brightness),
    };
    let mut parameters: Vec<f64> = model.parameters().iter().map(|p| start(&p.start)).collect();
    let mut constants: Vec<f64> = model.constants().iter().map(|c| c.value).collect();
    for (name, value) in &spec.set {
        let value = *value;
        if !value.is_finite() {
            return Err(SyntheticError::Range { name: "a value of `set`", value, range: "a finite number".into() });
        }
        if value.abs() > NUMBER_MAX {
            let max = plain(NUMBER_MAX);
            let reason = format!("is {}; it must be from -{max} to {max}", plain(value));
            return Err(SyntheticError::Light { key: format!("set.{name}"), reason });
        }
        match (model.parameter(name), model.constant(name)) {
            (Some(id), _) => parameters[id.index()] = value,
            (None, Some(id)) => constants[id.index()] = value,
            (None, None) => return Err(unknown(model, "parameter or constant", name.clone())),
        }
    }
    Ok((parameters, constants))
}

/// Typical result of an estimator in an ordinary frame.
fn typical(estimator: Estimator, spec: &SyntheticSpec, [ground, target]: [f64; 2]) -> f64 {
    let scale = spec.width as f64 / 640.0;
    let level = spec.saturation / 255.0;
    let sides = [spec.width, spec.height, spec.depth, spec.length].map(|side| side as f64);
    let is_stack = spec.model.coordinates().len() > 2;
    match estimator {
        Estimator::Centroid(axis) => (sides[axis] - 1.0) / 2.0,
        Estimator::Extent(row, column) if row != column => 0.0,
        Estimator::Extent(axis, _) | Estimator::Size(axis) if is_stack => {
            let half = sides[axis] / 5.0;
            if matches!(estimator, Estimator::Size(_)) { half } else { half.powi(-2) }
        }
        Estimator::Extent(axis, _) => ([60.0, 42.0, 42.0, 42.0][axis] * scale).powi(-2),
        Estimator::Size(_) => 40.0 * scale,
        Estimator::Background => level * ground,
        Estimator::Amplitude => level * target,
        // Sixteen pixels per cycle.
        Estimator::Frequency => 1.0 / 16.0,
        Estimator::Angle | Estimator::Direction | Estimator::Phase => 0.0,
        // A target on the optical axis, one metre away, facing the camera.
        Estimator::Position(2) => 1000.0,
        Estimator::Position(_) | Estimator::Orientation(_) => 0.0,
    }
}

pub(crate) fn unknown(model: &Model, wanted: &'static str, name: String) -> SyntheticError {
    let remedy = match model.nearest_name(&name) {
        Some(nearest) => format!("is `{nearest}` meant?"),
        None => {
            let parameters: Vec<&str> = model.parameters().iter().map(|p| p.name.as_str()).collect();
            format!("its parameters are {}", parameters.join(", "))
        }
    };
    SyntheticError::UnknownName { model: model.name().into(), wanted, name, remedy }
}
