//! What a synthetic camera is asked for, looked at before anything is rendered.

use std::collections::BTreeMap;
use std::sync::Arc;

use isophote_frame::{CameraResponse, LIGHT_MAX, NUMBER_MAX, Response, ResponseError, plain};
use isophote_symbolic::{Diagnostics, Estimator, Model, Start};

use crate::light::Light;
use crate::limits::LIMITS;
use crate::moving::{Moving, MovingFault};

/// What to render and how to see it. `SyntheticSpec::new(model)` has the contract's defaults.
#[derive(Clone, Debug)]
pub struct SyntheticSpec {
    /// Of one channel, or of several that `observed` names one by one.
    pub model: Arc<Model>,
    /// Parameters and constants by name; what is not set starts as [`Synthetic`] says.
    pub set: BTreeMap<String, f64>,
    /// Parameters by name as formulas of `t`, seconds since the first frame.
    pub motion: BTreeMap<String, String>,
    /// Pixels of a row.
    pub width: usize,
    /// Rows; a one-dimensional model has one whatever this says.
    pub height: usize,
    /// Slices of a model of three coordinates and more; 1 for others.
    pub depth: usize,
    /// Volumes of a model of four coordinates; 1 for others.
    pub length: usize,
    /// Frames a second: t of frame n is n / rate.
    pub rate_hz: f64,
    /// Of a pixel, 1 to 16; over 8 gives u16 planes.
    pub bits: u32,
    /// Sub-pixel samples per pixel side.
    pub samples: u32,
    /// Electrons at the saturation limit; 0: no noise at all.
    pub full_well_e: f64,
    /// Standard deviation of the read noise, electrons.
    pub read_noise_e: f64,
    /// Standard deviation of what all pixels of a row are off by, electrons.
    pub row_noise_e: f64,
    /// So many times the light: times what the knob of [`Exposure`](crate::Exposure) says.
    pub exposure: Moving,
    /// DN for each DN, after the electrons are counted: it amplifies light and noise, but not rounding.
    pub gain: Moving,
    /// Pixel values are clipped here, DN.
    pub saturation: f64,
    /// The pixel value without light, DN; only with a response.
    pub black: f64,
    /// How values follow from light, which the model's intensity is then, in DN above black; absent: they are the intensity.
    pub response: Option<CameraResponse>,
    /// Glare, occluders, blindness, defocus.
    pub light: Light,
    /// Of the noise; same seed, same frames.
    pub seed: u64,
    /// Frames between setting an exposure and the first frame that has it.
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
    /// What its values follow from light by, where they are not light as they are.
    pub(crate) fn prepared_response(&self) -> Result<Option<Response>, ResponseError> {
        let Some(response) = &self.response else { return Ok(None) };
        response.check_size(&[self.width, self.height])?;
        Response::new(self.black, Some(self.saturation), response).map(Some)
    }
}

/// Why there is no synthetic camera.
#[derive(Debug, thiserror::Error)]
pub enum SyntheticError {
    /// A number out of its range.
    #[error("{name} is {}; it must be {range}", plain(*value))]
    Range {
        /// As in the contract.
        name: &'static str,
        /// What was given.
        value: f64,
        /// What would be right.
        range: String,
    },
    /// A name that the model does not have.
    #[error("the model `{model}` has no {wanted} named `{name}`; {remedy}")]
    UnknownName {
        /// The model's name.
        model: String,
        /// Parameter, or parameter or constant.
        wanted: &'static str,
        /// What was given.
        name: String,
        /// The name that was probably meant, or all there are.
        remedy: String,
    },
    /// A motion formula is wrong.
    #[error("the motion of `{name}` is no formula of t: {}", first_message(diagnostics))]
    Motion {
        /// The parameter.
        name: String,
        /// The faults, with places in the formula.
        diagnostics: Diagnostics,
    },
    /// The light, the exposure, the gain or a value of `set` is wrong.
    #[error("`{key}` {reason}")]
    Light {
        /// As in the document, `light.glare[0].x`, `exposure`, `gain` or `set.bx`.
        key: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The response cannot be.
    #[error(transparent)]
    Response(#[from] ResponseError),
    /// Another scene, whose formulas say nothing for the next frame.
    #[error("the next frame could not be seen: {reason}")]
    Unseen {
        /// What is wrong then.
        reason: String,
    },
    /// The model cannot be rendered.
    #[error("the model `{model}` cannot be rendered: {reason}")]
    Model {
        /// The model's name.
        model: String,
        /// Why.
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
    // A document with a third coordinate asks for slices, since one slice does not say where a target is along it.
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

/// Parameters and constants of the first frame, motion apart.
pub(crate) fn numbers(spec: &SyntheticSpec) -> Result<(Vec<f64>, Vec<f64>), SyntheticError> {
    let model = &spec.model;
    let mut parameters = model.parameters().iter();
    let is_dark = parameters
        .any(|p| matches!(p.start, Start::Estimator(Estimator::Amplitude)) && p.max.is_some_and(|max| max <= 0.0));
    // Of 255 DN: the ground, and the target above it.
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

/// What an estimator would find in an ordinary frame.
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
        // Sixteen pixels a cycle.
        Estimator::Frequency => 1.0 / 16.0,
        Estimator::Angle | Estimator::Direction | Estimator::Phase => 0.0,
        // A target on the axis, a metre away, seen from the front.
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
