//! `TrackerOptions`: what a session says beside the model, and its check against one.

use std::collections::BTreeMap;

use isophote_jit::Window;
use isophote_symbolic::{Model, Precision};

use crate::camera::Camera;

/// What a session says beside the model.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackerOptions {
    /// Arithmetic of the pixel loops; the kernels must have been compiled for it.
    pub precision: Precision,
    /// The pixels to look at; all when absent. Clipped to each frame.
    pub window: Option<Window>,
    /// Numbers that take the place of a parameter's own start, by name.
    pub start: BTreeMap<String, f64>,
    /// Values of constants, by name. What is missing here comes from the camera (`gain`, `read_noise`), else from the model.
    pub constants: BTreeMap<String, f64>,
    /// The camera.
    pub camera: Camera,
    /// How many targets to follow, each an instance of the model.
    pub targets: usize,
    /// How they move.
    pub motion: MotionOptions,
    /// What a search finds is taken for the target from this confidence on, 0 … 1.
    pub confidence_min: f64,
}

/// How targets move, and for how long one that is not seen is believed to go on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionOptions {
    /// Standard deviation of the acceleration, px/s². Follows what is seen when absent.
    pub acceleration_px_s2: Option<f64>,
    /// Time from frame to frame where frames carry no time, s.
    pub period_s: f64,
    /// For so long a target that was seen at least three times in a row is predicted while it is not seen; then it is lost. s.
    pub coast_s: f64,
}

impl Default for MotionOptions {
    fn default() -> MotionOptions {
        MotionOptions { acceleration_px_s2: None, period_s: 1.0 / 60.0, coast_s: 0.5 }
    }
}

impl Default for TrackerOptions {
    fn default() -> TrackerOptions {
        TrackerOptions {
            precision: Precision::default(),
            window: None,
            start: BTreeMap::new(),
            constants: BTreeMap::new(),
            camera: Camera::default(),
            targets: 1,
            motion: MotionOptions::default(),
            confidence_min: 0.0,
        }
    }
}

/// Targets that one tracker may follow.
pub const TARGETS_MAX: usize = 64;

/// Why options do not fit a model.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TrackError {
    /// A start for what is no parameter.
    #[error("the model has no parameter `{name}`{}", suggestion(.nearest))]
    UnknownParameter {
        /// As given.
        name: String,
        /// What may be meant.
        nearest: Option<String>,
    },
    /// A value for what is no constant.
    #[error("the model has no constant `{name}`{}", suggestion(.nearest))]
    UnknownConstant {
        /// As given.
        name: String,
        /// What may be meant.
        nearest: Option<String>,
    },
    /// A start that is not between the parameter's bounds, or not a number.
    #[error("start of `{name}` = {value} is not inside its bounds (exclusive)")]
    OutsideBounds {
        /// The parameter.
        name: String,
        /// As given.
        value: f64,
    },
    /// A constant that is infinite or not a number.
    #[error("constant `{name}` = {value} is not a finite number")]
    NotFinite {
        /// The constant.
        name: String,
        /// As given.
        value: f64,
    },
    /// A number of the options that cannot be.
    #[error("{name} = {value} must be {range}")]
    Range {
        /// As in a session's options.
        name: &'static str,
        /// As given.
        value: f64,
        /// What would be right.
        range: String,
    },
    /// Kernels and options disagree.
    #[error("the options say {wanted:?}, the kernels are for {compiled:?}")]
    Precision {
        /// In the options.
        wanted: Precision,
        /// Of the kernels.
        compiled: Precision,
    },
}

fn suggestion(nearest: &Option<String>) -> String {
    nearest.as_ref().map(|name| format!("; did you mean `{name}`?")).unwrap_or_default()
}

impl MotionOptions {
    fn check(&self) -> Result<(), TrackError> {
        let positive = |name, value: f64| match value > 0.0 && value.is_finite() {
            true => Ok(()),
            false => Err(TrackError::Range { name, value, range: "a positive number".into() }),
        };
        positive("motion.period_s", self.period_s)?;
        positive("motion.acceleration_px_s2", self.acceleration_px_s2.unwrap_or(1.0))?;
        match self.coast_s >= 0.0 && self.coast_s.is_finite() {
            true => Ok(()),
            false => Err(TrackError::Range {
                name: "motion.coast_s",
                value: self.coast_s,
                range: "0 (lost at once) or positive".into(),
            }),
        }
    }
}

impl TrackerOptions {
    /// Checks names and values against a model.
    ///
    /// # Errors
    /// The first name that the model does not have, or value that cannot be.
    pub fn check(&self, model: &Model) -> Result<(), TrackError> {
        let nearest = |name: &str| model.nearest_name(name).map(str::to_string);
        for (name, &value) in &self.start {
            let Some(id) = model.parameter(name) else {
                return Err(TrackError::UnknownParameter { name: name.clone(), nearest: nearest(name) });
            };
            let parameter = &model.parameters()[id.index()];
            let inside = parameter.min.is_none_or(|min| value > min) && parameter.max.is_none_or(|max| value < max);
            if !inside || !value.is_finite() {
                return Err(TrackError::OutsideBounds { name: name.clone(), value });
            }
        }
        self.motion.check()?;
        if !(1..=TARGETS_MAX).contains(&self.targets) {
            let range = format!("1 to {TARGETS_MAX}");
            return Err(TrackError::Range { name: "targets", value: self.targets as f64, range });
        }
        if !(0.0..=1.0).contains(&self.confidence_min) {
            let range = "0 to 1".to_string();
            return Err(TrackError::Range { name: "confidence_min", value: self.confidence_min, range });
        }
        if self.targets > 1 && model.roles().len() > 1 {
            let range = "1 for a model that has several targets of its own".to_string();
            return Err(TrackError::Range { name: "targets", value: self.targets as f64, range });
        }
        for (name, &value) in &self.constants {
            if model.constant(name).is_none() {
                return Err(TrackError::UnknownConstant { name: name.clone(), nearest: nearest(name) });
            }
            if !value.is_finite() {
                return Err(TrackError::NotFinite { name: name.clone(), value });
            }
        }
        Ok(())
    }

    /// All constants of the model, in its order.
    pub(crate) fn constants_of(&self, model: &Model) -> Vec<f64> {
        let value = |name: &str| self.constants.get(name).copied().or_else(|| self.camera.constant(name));
        model.constants().iter().map(|constant| value(&constant.name).unwrap_or(constant.value)).collect()
    }

    /// The given starts, in the order of the model's parameters.
    pub(crate) fn start_of(&self, model: &Model) -> Vec<Option<f64>> {
        model.parameters().iter().map(|parameter| self.start.get(&parameter.name).copied()).collect()
    }
}
