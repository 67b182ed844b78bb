//! What a synthetic camera sees: `StagedScene`, read and checked, and `SceneKnob`, by which it is changed while the camera runs.
//!
//! In: the numbers and formulas of a [`SceneSpec`]. Out: for a time, parameters and how they are seen. A change needs no model to
//! be compiled: it is read beside the camera, and taken between two frames. It knows no pixels.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::light::shine::Shine;
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

/// A scene that was read.
pub(crate) struct StagedScene {
    motion: Movement,
    light: Light<Law>,
    exposure: Law,
    gain: Law,
    parameters: Vec<f64>,
    /// The model's constants.
    pub constants: Vec<f64>,
    /// Who counts its electrons.
    pub sensor: Sensor,
}

/// How one frame is seen.
pub(crate) struct FrameLight {
    /// So many times the light; the knob of a session comes on top.
    pub exposure: f64,
    /// DN for each DN.
    pub gain: f64,
    /// `None` where nothing is wrong with the light.
    pub shine: Option<Shine>,
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

    /// The model's parameters at time `t_s`; a sentence when one is no number then.
    pub fn parameters_at(&self, t_s: f64) -> Result<Vec<f64>, String> {
        let mut parameters = self.parameters.clone();
        self.motion.apply(t_s, &mut parameters)?;
        Ok(parameters)
    }

    /// How a frame of so many columns and rows is seen at time `t_s`.
    pub fn seen_at(&self, t_s: f64, size: [usize; 2]) -> Result<FrameLight, String> {
        let exposure = light::factor_at("exposure", &self.exposure, t_s)?;
        let gain = light::factor_at("gain", &self.gain, t_s)?;
        let shine = match self.light.is_clean() {
            true => None,
            false => Some(Shine::at(&self.light, t_s, size, self.sensor.saturation)?),
        };
        Ok(FrameLight { exposure, gain, shine })
    }
}

impl FrameLight {
    /// Standard deviation of the blur, px, where there is one.
    pub fn defocus_px(&self) -> Option<f64> {
        self.shine.as_ref().map(Shine::defocus_px).filter(|sigma_px| *sigma_px > 0.0)
    }
}

/// Changes the scene of a camera from another thread. Clones turn the same knob.
#[derive(Clone)]
pub struct SceneKnob {
    spec: Arc<SyntheticSpec>,
    slot: Arc<Mutex<Slot>>,
}

#[derive(Default)]
struct Slot {
    /// Until the next frame takes it: the newest wins.
    wanted: Option<Box<StagedScene>>,
    /// The number of the next frame.
    next_frame: u64,
}

impl SceneKnob {
    pub(crate) fn new(spec: &SyntheticSpec) -> SceneKnob {
        SceneKnob { spec: Arc::new(spec.clone()), slot: Arc::default() }
    }

    fn lock(&self) -> MutexGuard<'_, Slot> {
        self.slot.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Another scene, from the next frame on that is rendered, whose number is answered. Time goes on.
    ///
    /// # Errors
    /// What a camera with such a scene is refused with; or the next frame could not be seen. The scene is as it was then.
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

    /// The number of the next frame that is rendered.
    pub fn next_frame(&self) -> u64 {
        self.lock().next_frame
    }

    /// For the camera, at the beginning of a frame: another scene, if there is one.
    pub(crate) fn begin(&self, frame: u64) -> Option<Box<StagedScene>> {
        let mut slot = self.lock();
        slot.next_frame = frame + 1;
        slot.wanted.take()
    }

    /// For the camera: that frame is rendered again.
    pub(crate) fn take_back(&self, frame: u64) {
        self.lock().next_frame = frame;
    }
}
