//! `TrackerOptions`: what a session says beside the model, and its check against one.

use std::collections::BTreeMap;

use isophote_jit::Window;
use isophote_symbolic::{Model, Precision};

use crate::camera::Camera;

/// What a session says beside the model.
#[derive(Clone, Debug, Default, PartialEq)]
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
}

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
