//! The scene of a synthetic camera: `StagedScene`, parsed and checked, and `SceneKnob`, which changes it while the camera
//! runs.
//!
//! A change needs no model compilation: it is parsed outside the camera thread and takes effect between two frames.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::light::defects::LightDefects;
use crate::light::{self, Light};
use crate::movement::{Movement, MovementFault};
use crate::moving::{Law, Moving};
use crate::noise::Sensor;
use crate::spec::{SyntheticError, SyntheticSpec, check, numbers, unknown, wrong_light};

/// The part of a [`SyntheticSpec`] that may change while the camera runs.
#[derive(Clone, Debug)]
pub struct SceneSpec {
    /// As [`SyntheticSpec::set`].
    pub set: BTreeMap<String, f64>,
    /// As [`SyntheticSpec::motion`].
    pub motion: BTreeMap<String, String>,
    /// As [`SyntheticSpec::exposure`].
    pub exposure: Moving,
    /// As [`SyntheticSpec::gain`].
    pub gain: Moving,
    /// As [`SyntheticSpec::full_well_e`].
    pub full_well_e: f64,
    /// As [`SyntheticSpec::read_noise_e`].
    pub read_noise_e: f64,
    /// As [`SyntheticSpec::row_noise_e`].
    pub row_noise_e: f64,
    /// As [`SyntheticSpec::light`].
    pub light: Light,
}

/// A parsed and checked scene.
pub(crate) struct StagedScene {
    motion: Movement,
    light: Light<Law>,
    exposure: Law,
    gain: Law,
    parameters: Vec<f64>,
    /// The model's constants.
    pub constants: Vec<f64>,
    /// Sensor that reads the light.
    pub sensor: Sensor,
}

/// Exposure, gain and light defects of one frame.
pub(crate) struct FrameLight {
    /// Factor of the light; the session's [`Exposure`](crate::Exposure) multiplies it.
    pub exposure: f64,
    /// Amplification after the electrons are counted.
    pub gain: f64,
    /// `None` without light defects.
    pub defects: Option<LightDefects>,
}

impl StagedScene {
    /// Checks the numbers and parses the formulas.
    pub fn read(spec: &SyntheticSpec) -> Result<StagedScene, SyntheticError> {
        check(spec)?;
        let motion = Movement::parse(&spec.model, &spec.motion).map_err(|fault| match fault {
            MovementFault::UnknownName(name) => unknown(&spec.model, "parameter", name),
            MovementFault::Formula { name, diagnostics } => SyntheticError::Motion { name, diagnostics },
        })?;
        let (parameters, constants) = numbers(spec)?;
        let light = light::read(&spec.light).map_err(wrong_light)?;
        let exposure = light::read_factor("exposure", &spec.exposure).map_err(wrong_light)?;
        let gain = light::read_factor("gain", &spec.gain).map_err(wrong_light)?;
        let light_dn = spec.response.as_ref().map_or(spec.saturation, |_| spec.saturation - spec.black);
        let electrons_per_dn = spec.full_well_e / light_dn;
        let SyntheticSpec { saturation, read_noise_e, row_noise_e, .. } = *spec;
        let sensor = Sensor { saturation, electrons_per_dn, read_noise_e, row_noise_e };
        Ok(StagedScene { motion, light, exposure, gain, parameters, constants, sensor })
    }

    /// The model's parameters at time `t_s`; a message if one is not finite.
    pub fn parameters_at(&self, t_s: f64) -> Result<Vec<f64>, String> {
        let mut parameters = self.parameters.clone();
        self.motion.apply(t_s, &mut parameters)?;
        Ok(parameters)
    }

    /// Evaluates a frame of `size` at time `t_s`.
    pub fn seen_at(&self, t_s: f64, size: [usize; 2]) -> Result<FrameLight, String> {
        let exposure = light::factor_at("exposure", &self.exposure, t_s)?;
        let gain = light::factor_at("gain", &self.gain, t_s)?;
        let defects = match self.light.is_clean() {
            true => None,
            false => Some(LightDefects::at(&self.light, t_s, size, self.sensor.saturation)?),
        };
        Ok(FrameLight { exposure, gain, defects })
    }
}

impl FrameLight {
    /// Standard deviation of the blur, px, if there is any.
    pub fn defocus_px(&self) -> Option<f64> {
        self.defects.as_ref().map(LightDefects::defocus_px).filter(|sigma_px| *sigma_px > 0.0)
    }
}

/// Changes the scene of a camera from another thread. Clones share their state.
#[derive(Clone)]
pub struct SceneKnob {
    spec: Arc<SyntheticSpec>,
    slot: Arc<Mutex<Slot>>,
}

#[derive(Default)]
struct Slot {
    /// Pending scene, taken by the next frame; a newer one replaces it.
    wanted: Option<Box<StagedScene>>,
    /// Number of the next frame.
    next_frame: u64,
}

impl SceneKnob {
    pub(crate) fn new(spec: &SyntheticSpec) -> SceneKnob {
        SceneKnob { spec: Arc::new(spec.clone()), slot: Arc::default() }
    }

    fn lock(&self) -> MutexGuard<'_, Slot> {
        self.slot.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes the scene from the next rendered frame, whose number is returned. Time continues.
    ///
    /// # Errors
    /// The errors of a camera with this scene, or the next frame cannot be evaluated. The scene is then unchanged.
    pub fn set(&self, scene: SceneSpec) -> Result<u64, SyntheticError> {
        let SceneSpec { set, motion, exposure, gain, full_well_e, read_noise_e, row_noise_e, light } = scene;
        let spec = SyntheticSpec {
            set,
            motion,
            exposure,
            gain,
            full_well_e,
            read_noise_e,
            row_noise_e,
            light,
            ..SyntheticSpec::clone(&self.spec)
        };
        let staged = StagedScene::read(&spec)?;
        let t_s = self.lock().next_frame as f64 / spec.rate_hz;
        let unseen = |reason| SyntheticError::Unseen { reason };
        staged.parameters_at(t_s).map_err(unseen)?;
        staged.seen_at(t_s, [spec.width, spec.height]).map_err(unseen)?;
        let mut slot = self.lock();
        slot.wanted = Some(Box::new(staged));
        Ok(slot.next_frame)
    }

    /// Number of the next rendered frame.
    pub fn next_frame(&self) -> u64 {
        self.lock().next_frame
    }

    /// Called by the camera at the start of a frame: takes a pending scene.
    pub(crate) fn begin(&self, frame: u64) -> Option<Box<StagedScene>> {
        let mut slot = self.lock();
        slot.next_frame = frame + 1;
        slot.wanted.take()
    }

    /// Called by the camera: `frame` will be rendered again.
    pub(crate) fn take_back(&self, frame: u64) {
        self.lock().next_frame = frame;
    }
}
