//! `TrackerOptions`: what a session says beside the model, and its check against one.

use std::collections::BTreeMap;

use isophote_jit::Window;
use isophote_symbolic::{Estimator, Model, Precision, Start};

use crate::camera::{Camera, Distortion, IntrinsicsError};
use crate::pose::{Geometry, Target, TargetError};

/// What a session says beside the model.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrackerOptions {
    /// Arithmetic of the pixel loops; the kernels must have been compiled for it.
    pub precision: Precision,
    /// The pixels to look at; all when absent. Clipped to each frame.
    pub window: Option<Window>,
    /// Numbers that take the place of a parameter's own start, by name.
    pub start: BTreeMap<String, f64>,
    /// Values of constants, by name. What is missing here comes from the camera (`gain`, `read_noise`, `fx` …), then
    /// from the target (`red_x` …), else from the model.
    pub constants: BTreeMap<String, f64>,
    /// The camera.
    pub camera: Camera,
    /// The rigid target that the spots belong to.
    pub target: Option<Target>,
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
    /// The lens cannot be.
    #[error(transparent)]
    Intrinsics(#[from] IntrinsicsError),
    /// The target cannot be.
    #[error(transparent)]
    Target(#[from] TargetError),
    /// The formulas of the model bend light otherwise than the lens.
    #[error(
        "the model's formulas have no `{wanted}`, which the camera's lens needs: take a model for lenses of this kind"
    )]
    Lens {
        /// The constant that is missing.
        wanted: String,
    },
    /// A start by `pose.…` without what a pose needs.
    #[error(
        "`{name}` starts at a pose: that needs the roles `position` and `orientation`, the constants `fx`, `fy`, `cx`, `cy`, \
         and for each spot's table of roles, `red` say, `red_x`, `red_y` and `red_radius`, all of which make sense"
    )]
    NoGeometry {
        /// The parameter.
        name: String,
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
        self.target.as_ref().map_or(Ok(()), Target::check)?;
        let is_pose =
            |start: &Start| matches!(start, Start::Estimator(Estimator::Position(_) | Estimator::Orientation(_)));
        let starts_at_pose = model.parameters().iter().find(|parameter| is_pose(&parameter.start));
        if let Some(parameter) = starts_at_pose
            && Geometry::of(model, &self.constants_of(model)).is_none()
        {
            return Err(TrackError::NoGeometry { name: parameter.name.clone() });
        }
        self.check_lens(model)
    }

    /// A model that has the lens in its formulas must have all of it.
    fn check_lens(&self, model: &Model) -> Result<(), TrackError> {
        let Some(lens) = &self.camera.intrinsics else { return Ok(()) };
        lens.check()?;
        if model.constant("fx").is_none() {
            return Ok(());
        }
        if lens.model == Distortion::Fisheye {
            return Err(TrackError::Lens { wanted: "fisheye lens".into() });
        }
        for name in ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"] {
            let wanted = format!("lens_{name}");
            if lens.coefficient(name).is_some_and(|value| value != 0.0) && model.constant(&wanted).is_none() {
                return Err(TrackError::Lens { wanted });
            }
        }
        Ok(())
    }

    /// All constants of the model, in its order.
    pub(crate) fn constants_of(&self, model: &Model) -> Vec<f64> {
        let of_target = |name: &str| self.target.as_ref().and_then(|target| target.constant(name));
        let value = |name: &str| {
            let given = self.constants.get(name).copied();
            given.or_else(|| self.camera.constant(name)).or_else(|| of_target(name))
        };
        model.constants().iter().map(|constant| value(&constant.name).unwrap_or(constant.value)).collect()
    }

    /// The given starts, in the order of the model's parameters.
    pub(crate) fn start_of(&self, model: &Model) -> Vec<Option<f64>> {
        model.parameters().iter().map(|parameter| self.start.get(&parameter.name).copied()).collect()
    }
}
