//! The synthetic camera: any model, rendered with sub-pixel samples, motion, noise and saturation; the truth with each frame.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use isophote_jit::{PixelFormat, Slices, Window};
use isophote_symbolic::{Diagnostics, Estimator, Model, Start};
use isophote_tracker::{Frame, Plane};
use serde::{Deserialize, Serialize};

use crate::exposure::Exposure;
use crate::limits::LIMITS;
use crate::motion::{Motion, MotionFault};
use crate::noise::{ReadOut, Sensor};
use crate::planes::of_channels;
use crate::sampling::{BAND_ROWS, Numbers, Scene, SceneFault, Scratch};
use crate::source::{Captured, FrameSource, SourceError};

/// Between the seeds of two channels: the golden ratio's bits, so that neighbouring seeds do not meet.
const CHANNEL_SEED: u64 = 0x9e37_79b9_7f4a_7c15;

/// When the next frame is due. The source itself never waits; its owner obeys.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Pace {
    /// At `rate_hz`, like a camera: a fit that is too slow misses frames.
    #[default]
    Realtime,
    /// When the last frame has been fitted: no frame is ever lost.
    Fit,
}

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
    /// For the owner of the source.
    pub pace: Pace,
    /// Of a pixel, 1 to 16; over 8 gives u16 planes.
    pub bits: u32,
    /// Sub-pixel samples per pixel side.
    pub samples: u32,
    /// Electrons at the saturation limit; 0: no noise at all.
    pub full_well_e: f64,
    /// Standard deviation of the read noise, electrons.
    pub read_noise_e: f64,
    /// Pixel values are clipped here, DN.
    pub saturation: f64,
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
            pace: Pace::Realtime,
            bits: 8,
            samples: 8,
            full_well_e: 0.0,
            read_noise_e: 0.0,
            saturation: 255.0,
            seed: 1,
            exposure_latency: 2,
        }
    }
}

/// Why there is no synthetic camera.
#[derive(Debug, thiserror::Error)]
pub enum SyntheticError {
    /// A number out of its range.
    #[error("{name} is {value}; it must be {range}")]
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
    /// The model cannot be rendered.
    #[error("the model `{model}` cannot be rendered: {reason}")]
    Model {
        /// The model's name.
        model: String,
        /// Why.
        reason: String,
    },
}

fn first_message(diagnostics: &Diagnostics) -> String {
    diagnostics.first().map_or_else(String::new, |d| match &d.help {
        Some(help) => format!("{} ({help})", d.message),
        None => d.message.clone(),
    })
}

/// A camera that looks at a model.
///
/// A parameter that is neither set nor moved has its start if that is a number; else it follows from its estimator:
/// `centroid` the middle of the frame, `extent` an ellipse of semi-axes 60 × 42 px at 640 px width (in
/// proportion to the width), `size` 40 px (in a stack both a fifth of the frame along each coordinate), `background` 20 and `amplitude` 150 of 255 DN (in proportion to the saturation),
/// or 200 and −150 where the model wants a dark target (`max` not above 0).
pub struct Synthetic {
    spec: SyntheticSpec,
    size: Vec<usize>,
    /// One a channel, and its read-out.
    scenes: Vec<Scene>,
    read_outs: Vec<ReadOut>,
    motion: Motion,
    parameters: Vec<f64>,
    constants: Vec<f64>,
    frame: u64,
    scratch: Scratch,
    means: Vec<f32>,
    exposure: Exposure,
    /// Exposures on their way: that of the next frame is the first.
    exposures: VecDeque<f64>,
}

impl Synthetic {
    /// Checks the numbers and compiles the model.
    pub fn new(spec: SyntheticSpec) -> Result<Synthetic, SyntheticError> {
        check(&spec)?;
        let refused = |reason: String| SyntheticError::Model { model: spec.model.name().into(), reason };
        let models = of_channels(&spec.model).map_err(refused)?;
        let sides = [spec.width, spec.height, spec.depth, spec.length];
        let size = sides[..spec.model.coordinates().len().min(4)].to_vec();
        let scene = |model| {
            Scene::new(model, spec.samples).map_err(|fault| match fault {
                SceneFault::Model(diagnostics) => refused(first_message(&diagnostics)),
                SceneFault::Compile(reason) => refused(format!("{reason} (a bug of isophote)")),
            })
        };
        let scenes = models.iter().map(scene).collect::<Result<Vec<_>, _>>()?;
        let motion = Motion::parse(&spec.model, &spec.motion).map_err(|fault| match fault {
            MotionFault::UnknownName(name) => unknown(&spec.model, "parameter", name),
            MotionFault::Formula { name, diagnostics } => SyntheticError::Motion { name, diagnostics },
        })?;
        let (parameters, constants) = numbers(&spec)?;
        let electrons_per_dn = spec.full_well_e / spec.saturation;
        let sensor = Sensor { saturation: spec.saturation, electrons_per_dn, read_noise_e: spec.read_noise_e };
        let read_outs = scenes.iter().map(|_| ReadOut::new(sensor)).collect();
        let (scratch, means) = (Scratch::default(), Vec::new());
        let exposures = std::iter::repeat_n(1.0, spec.exposure_latency as usize).collect();
        let exposure = Exposure::default();
        Ok(Synthetic {
            spec,
            size,
            scenes,
            read_outs,
            motion,
            parameters,
            constants,
            frame: 0,
            scratch,
            means,
            exposure,
            exposures,
        })
    }

    /// What was asked for.
    pub fn spec(&self) -> &SyntheticSpec {
        &self.spec
    }

    /// The parameters of frame n by name.
    pub fn truth(&self, frame: u64) -> Result<BTreeMap<String, f64>, SourceError> {
        let parameters = self.parameters_of(frame)?;
        let names = self.spec.model.parameters().iter().map(|p| p.name.clone());
        Ok(names.zip(parameters).collect())
    }

    fn parameters_of(&self, frame: u64) -> Result<Vec<f64>, SourceError> {
        let mut parameters = self.parameters.clone();
        let t_s = frame as f64 / self.spec.rate_hz;
        self.motion.apply(t_s, &mut parameters).map_err(|reason| SourceError::Synthetic { frame, reason })?;
        Ok(parameters)
    }

    /// The exposure of the next frame: what was set so many frames ago.
    fn take_exposure(&mut self) -> f64 {
        self.exposures.push_back(self.exposure.get());
        self.exposures.pop_front().unwrap_or(1.0)
    }

    /// What one channel reads.
    fn pixels(&mut self, channel: usize, frame: u64, exposure: f64) -> Result<Plane, SourceError> {
        let fault = |reason: String| SourceError::Synthetic { frame, reason };
        let parameters = self.parameters_of(frame)?;
        let numbers = Numbers { parameters: &parameters, constants: &self.constants };
        let (scene, read_out) = (&self.scenes[channel], &mut self.read_outs[channel]);
        let side = |axis: usize| self.size.get(axis).copied().unwrap_or(1);
        let (width, height, depth, length) = (side(0), side(1), side(2), side(3));
        // Every channel has noise of its own; the first that of the seed.
        read_out.begin(self.spec.seed.wrapping_add((channel as u64).wrapping_mul(CHANNEL_SEED)), frame);
        let mut row = vec![0u16; width];
        let format = if self.spec.bits > 8 { PixelFormat::U16 } else { PixelFormat::U8 };
        let mut bytes = Vec::with_capacity(width * height * depth * length * format.bytes_per_pixel());
        let slices = (0..length).flat_map(|w| (0..depth).map(move |z| Slices { first: [z, w], ..Slices::ONE }));
        for (slices, y) in slices.flat_map(|slices| (0..height).step_by(BAND_ROWS).map(move |y| (slices, y))) {
            let band = Window { x: 0, y, width, height: BAND_ROWS.min(height - y), slices };
            self.means.resize(width * band.height, 0.0);
            scene.render(&numbers, band, &mut self.scratch, &mut self.means).map_err(fault)?;
            if exposure != 1.0 {
                self.means.iter_mut().for_each(|mean| *mean *= exposure as f32);
            }
            for means in self.means.chunks_exact(width) {
                read_out.row(means, &mut row);
                match format {
                    PixelFormat::U16 => bytes.extend(row.iter().flat_map(|pixel| pixel.to_le_bytes())),
                    // The saturation limit is at most 255 here, so no pixel is cut.
                    _ => bytes.extend(row.iter().map(|pixel| *pixel as u8)),
                }
            }
        }
        Ok(Plane::owned(format, bytes, width))
    }
}

impl FrameSource for Synthetic {
    fn next(&mut self) -> Result<Option<Captured>, SourceError> {
        let frame = self.frame;
        self.frame += 1;
        let exposure = self.take_exposure();
        let planes = (0..self.scenes.len()).map(|channel| self.pixels(channel, frame, exposure));
        let planes = planes.collect::<Result<Vec<_>, _>>()?;
        let mut truth = self.truth(frame)?;
        // Targets may share a background: a set names it once.
        let roles = self.spec.model.roles().iter();
        let light: BTreeSet<_> = roles.flat_map(|roles| roles.background.iter().chain(&roles.brightness)).collect();
        for parameter in light.into_iter().filter(|_| exposure != 1.0) {
            if let Some(value) = truth.get_mut(&self.spec.model.parameters()[parameter.index()].name) {
                *value *= exposure;
            }
        }
        let made = Frame::new(&self.size, planes)
            .map_err(|error| SourceError::Synthetic { frame, reason: error.to_string() })?;
        Ok(Some(Captured { frame: made.with_sequence(frame), file: None, truth: Some(truth) }))
    }

    fn description(&self) -> String {
        let size: Vec<String> = self.size.iter().map(usize::to_string).collect();
        format!("synthetic `{}` ({} px, {} Hz)", self.spec.model.name(), size.join("×"), self.spec.rate_hz)
    }

    fn size(&self) -> Option<Vec<usize>> {
        Some(self.size.clone())
    }

    fn exposure(&self) -> Option<Exposure> {
        Some(self.exposure.clone())
    }
}

fn check(spec: &SyntheticSpec) -> Result<(), SyntheticError> {
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
    let latency = f64::from(spec.exposure_latency);
    in_range("exposure_latency", latency, spec.exposure_latency <= LIMITS.exposure_latency, "0 to 64")?;
    in_range("rate_hz", spec.rate_hz, spec.rate_hz > 0.0, "positive")?;
    in_range("full_well_e", spec.full_well_e, spec.full_well_e >= 0.0, "0 (no noise) or positive")?;
    in_range("read_noise_e", spec.read_noise_e, spec.read_noise_e >= 0.0, "0 or positive")
}

/// Parameters and constants of the first frame, motion apart.
fn numbers(spec: &SyntheticSpec) -> Result<(Vec<f64>, Vec<f64>), SyntheticError> {
    let model = &spec.model;
    let dark = model
        .parameters()
        .iter()
        .any(|p| matches!(p.start, Start::Estimator(Estimator::Amplitude)) && p.max.is_some_and(|max| max <= 0.0));
    let start = |start: &Start| match start {
        Start::Number(number) => *number,
        Start::Estimator(estimator) => typical(*estimator, spec, dark),
    };
    let mut parameters: Vec<f64> = model.parameters().iter().map(|p| start(&p.start)).collect();
    let mut constants: Vec<f64> = model.constants().iter().map(|c| c.value).collect();
    for (name, value) in &spec.set {
        let value = *value;
        if !value.is_finite() {
            return Err(SyntheticError::Range { name: "a value of `set`", value, range: "a finite number".into() });
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
fn typical(estimator: Estimator, spec: &SyntheticSpec, dark: bool) -> f64 {
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
        Estimator::Background => level * if dark { 200.0 } else { 20.0 },
        Estimator::Amplitude => level * if dark { -150.0 } else { 150.0 },
        // A target on the axis, a metre away, seen from the front.
        Estimator::Position(2) => 1000.0,
        Estimator::Position(_) | Estimator::Orientation(_) => 0.0,
    }
}

fn unknown(model: &Model, wanted: &'static str, name: String) -> SyntheticError {
    let remedy = match model.nearest_name(&name) {
        Some(nearest) => format!("is `{nearest}` meant?"),
        None => {
            let parameters: Vec<&str> = model.parameters().iter().map(|p| p.name.as_str()).collect();
            format!("its parameters are {}", parameters.join(", "))
        }
    };
    SyntheticError::UnknownName { model: model.name().into(), wanted, name, remedy }
}
