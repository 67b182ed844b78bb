//! The synthetic camera: renders a model with sub-pixel samples, motion, noise and saturation; each frame carries its truth.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use isophote_frame::{Frame, Plane, Response};
use isophote_jit::{PixelFormat, Slices, Window};

use crate::exposure::Exposure;
use crate::light::defocus::Blur;
use crate::noise::ReadOut;
use crate::planes::of_channels;
use crate::sampling::{BAND_ROWS, RenderedNumbers, Scene, SceneFault, Scratch};
use crate::scene::{FrameLight, SceneKnob, StagedScene};
use crate::source::{Captured, FrameSource, SourceError};
use crate::spec::{SyntheticError, SyntheticSpec, check, first_message};

/// Offset between the seeds of two channels: the golden ratio's bits, so that neighbouring seeds do not collide.
const CHANNEL_SEED: u64 = 0x9e37_79b9_7f4a_7c15;

/// A camera that renders a model.
///
/// A parameter that is neither set nor moved takes its numeric start, or else a typical value of its estimator: `centroid`
/// the middle of the frame, `extent` an ellipse of semi-axes 60 × 42 px at 640 px width (in proportion to the width), `size`
/// 40 px likewise (in a stack both a fifth of the frame along each coordinate), `background` 20 and `amplitude` 150 of 255
/// DN (in proportion to the saturation), or 200 and −150 if the model wants a dark target (`max` not above 0).
pub struct Synthetic {
    spec: SyntheticSpec,
    size: Vec<usize>,
    /// One scene per channel, each with a read-out.
    scenes: Vec<Scene>,
    read_outs: Vec<ReadOut>,
    response: Option<Arc<Response>>,
    staged: Box<StagedScene>,
    knob: SceneKnob,
    frame: u64,
    scratch: Scratch,
    means: Vec<f32>,
    exposure: Exposure,
    /// Delayed exposures; the next frame's is first.
    exposures: VecDeque<f64>,
    /// Exposure of the last frame.
    exposed: f64,
}

impl Synthetic {
    /// Checks the numbers and compiles the model.
    pub fn new(spec: SyntheticSpec) -> Result<Synthetic, SyntheticError> {
        check(&spec)?;
        let refused = |reason: String| SyntheticError::Model { model: spec.model.name().into(), reason };
        let summands = of_channels(&spec.model).map_err(refused)?;
        let sides = [spec.width, spec.height, spec.depth, spec.length];
        let size = sides[..spec.model.coordinates().len().min(4)].to_vec();
        let scene = |summand| {
            Scene::new(summand, spec.samples).map_err(|fault| match fault {
                SceneFault::Model(diagnostics) => refused(first_message(&diagnostics)),
                SceneFault::Compile(reason) => refused(format!("{reason} (a bug of isophote)")),
            })
        };
        let scenes = summands.iter().map(scene).collect::<Result<Vec<_>, _>>()?;
        let staged = Box::new(StagedScene::read(&spec)?);
        let response = spec.prepared_response()?.map(Arc::new);
        let read_outs = scenes.iter().map(|_| ReadOut::new(staged.sensor, response.clone())).collect();
        let (scratch, means) = (Scratch::default(), Vec::new());
        let exposures = std::iter::repeat_n(1.0, spec.exposure_latency as usize).collect();
        let exposure = Exposure::default();
        Ok(Synthetic {
            knob: SceneKnob::new(&spec),
            spec,
            size,
            scenes,
            read_outs,
            response,
            staged,
            frame: 0,
            scratch,
            means,
            exposure,
            exposures,
            exposed: 1.0,
        })
    }

    /// Specification as given.
    pub fn spec(&self) -> &SyntheticSpec {
        &self.spec
    }

    /// Parameters of frame n by name.
    pub fn truth(&self, frame: u64) -> Result<BTreeMap<String, f64>, SourceError> {
        let parameters = self.parameters_of(frame)?;
        let names = self.spec.model.parameters().iter().map(|p| p.name.clone());
        Ok(names.zip(parameters).collect())
    }

    fn t_s(&self, frame: u64) -> f64 {
        frame as f64 / self.spec.rate_hz
    }

    fn parameters_of(&self, frame: u64) -> Result<Vec<f64>, SourceError> {
        self.staged.parameters_at(self.t_s(frame)).map_err(|reason| SourceError::Synthetic { frame, reason })
    }

    /// Switches to a pending scene, if any.
    fn restage(&mut self, frame: u64) {
        let Some(staged) = self.knob.begin(frame) else { return };
        // Background tables are valid for one sensor only.
        if staged.sensor != self.staged.sensor {
            let read_out = |_| ReadOut::new(staged.sensor, self.response.clone());
            self.read_outs = self.scenes.iter().map(read_out).collect();
        }
        self.staged = staged;
    }

    /// Exposure of the next frame: the one set `exposure_latency` frames ago.
    fn take_exposure(&mut self) -> f64 {
        self.exposures.push_back(self.exposure.get());
        self.exposed = self.exposures.pop_front().unwrap_or(1.0);
        self.exposed
    }

    /// Evaluates exposure, gain and light of frame n.
    fn seen(&mut self, frame: u64) -> Result<FrameLight, SourceError> {
        let [width, height, ..] = self.sides();
        let seen = self.staged.seen_at(self.t_s(frame), [width, height]);
        let mut seen = seen.map_err(|reason| SourceError::Synthetic { frame, reason })?;
        seen.exposure *= self.take_exposure();
        Ok(seen)
    }

    /// Pixels along each axis.
    fn sides(&self) -> [usize; 4] {
        std::array::from_fn(|axis| self.size.get(axis).copied().unwrap_or(1))
    }

    /// Renders one channel.
    fn pixels(&mut self, channel: usize, frame: u64, seen: &FrameLight) -> Result<Plane, SourceError> {
        let fault = |reason: String| SourceError::Synthetic { frame, reason };
        let parameters = self.parameters_of(frame)?;
        let numbers = RenderedNumbers { parameters: &parameters, constants: &self.staged.constants, origin: [0.0; 2] };
        let [width, height, depth, length] = self.sides();
        let (scene, read_out) = (&self.scenes[channel], &mut self.read_outs[channel]);
        // Each channel has independent noise; the first uses the seed itself.
        let seed = self.spec.seed.wrapping_add((channel as u64).wrapping_mul(CHANNEL_SEED));
        read_out.begin(seed, frame, seen.gain);
        let mut row = vec![0u16; width];
        let format = if self.spec.bits > 8 { PixelFormat::U16 } else { PixelFormat::U8 };
        let mut bytes = Vec::with_capacity(width * height * depth * length * format.bytes_per_pixel());
        let blur = seen.defocus_px().map(|sigma_px| Blur::new(sigma_px, self.size.len()));
        let factor = (seen.exposure * seen.gain) as f32;
        // The saturation limit fits into the pixel's bits, so the casts here and below do not truncate. Blind pixels are
        // full wells.
        let saturation = (self.spec.saturation * seen.gain.min(1.0)) as u16;
        for slices in (0..length).flat_map(|w| (0..depth).map(move |z| Slices { first: [z, w], ..Slices::ONE })) {
            let slice = Window { x: 0, y: 0, width, height, slices };
            let blurred =
                blur.as_ref().map(|blur| blurred(scene, &numbers, slice, blur, &mut self.scratch)).transpose();
            let blurred = blurred.map_err(fault)?;
            for y in (0..height).step_by(BAND_ROWS) {
                let band = Window { y, height: BAND_ROWS.min(height - y), ..slice };
                self.means.resize(width * band.height, 0.0);
                match &blurred {
                    Some(plane) => self.means.copy_from_slice(&plane[y * width..][..width * band.height]),
                    None => scene.render(&numbers, band, &mut self.scratch, &mut self.means).map_err(fault)?,
                }
                for (y, means) in (y..).zip(self.means.chunks_exact_mut(width)) {
                    if let Some(defects) = &seen.defects {
                        defects.apply(y, means);
                    }
                    if factor != 1.0 {
                        means.iter_mut().for_each(|mean| *mean *= factor);
                    }
                    if let Some(gains) = self.response.as_ref().and_then(|response| response.gains(y)) {
                        means.iter_mut().zip(gains).for_each(|(mean, gain)| *mean *= gain);
                    }
                    read_out.row(means, &mut row);
                    if let Some(defects) = &seen.defects {
                        defects.apply_to_pixels(y, &mut row, saturation);
                    }
                    match format {
                        PixelFormat::U16 => bytes.extend(row.iter().flat_map(|pixel| pixel.to_le_bytes())),
                        _ => bytes.extend(row.iter().map(|pixel| *pixel as u8)),
                    }
                }
            }
        }
        Ok(Plane::owned(format, bytes, width))
    }
}

/// Renders one slice with defocus, including the surroundings, whose light spreads into it.
fn blurred(
    scene: &Scene,
    numbers: &RenderedNumbers,
    slice: Window,
    blur: &Blur,
    scratch: &mut Scratch,
) -> Result<Vec<f32>, String> {
    let [across, along] = blur.reach();
    let numbers = RenderedNumbers { origin: [-(across as f64), -(along as f64)], ..*numbers };
    let padded = Window { width: slice.width + 2 * across, height: slice.height + 2 * along, ..slice };
    let mut light = vec![0.0; padded.width * padded.height];
    for (band, light) in light.chunks_mut(padded.width * BAND_ROWS).enumerate() {
        let window = Window { y: band * BAND_ROWS, height: light.len() / padded.width, ..padded };
        scene.render(&numbers, window, scratch, light)?;
    }
    Ok(blur.apply(&light, slice.width))
}

impl FrameSource for Synthetic {
    fn next(&mut self) -> Result<Option<Captured>, SourceError> {
        let frame = self.frame;
        self.frame += 1;
        self.restage(frame);
        let seen = self.seen(frame)?;
        let planes = (0..self.scenes.len()).map(|channel| self.pixels(channel, frame, &seen));
        let planes = planes.collect::<Result<Vec<_>, _>>()?;
        let mut truth = self.truth(frame)?;
        // Targets may share a background: a set scales it once.
        let roles = self.spec.model.roles().iter();
        let light: BTreeSet<_> = roles.flat_map(|roles| roles.background.iter().chain(&roles.brightness)).collect();
        let factor = seen.exposure * seen.gain;
        for parameter in light.into_iter().filter(|_| factor != 1.0) {
            if let Some(value) = truth.get_mut(&self.spec.model.parameters()[parameter.index()].name) {
                *value *= factor;
            }
        }
        let made = Frame::new(&self.size, planes)
            .map_err(|error| SourceError::Synthetic { frame, reason: error.to_string() })?;
        let made = made.with_sequence(frame).with_time_s(Some(self.t_s(frame))).with_largest(self.spec.saturation);
        Ok(Some(Captured { frame: made, file: None, truth: Some(truth) }))
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

    fn scene(&self) -> Option<SceneKnob> {
        Some(self.knob.clone())
    }

    fn take_back(&mut self) -> bool {
        if self.frame == 0 {
            return false;
        }
        self.frame -= 1;
        // Push before pop: without latency the queue is empty.
        self.exposures.push_front(self.exposed);
        self.exposures.pop_back();
        self.knob.take_back(self.frame);
        true
    }
}
