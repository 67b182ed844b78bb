//! `TrackerOptions`: the settings of a session beside the model, and their validation.

use std::collections::BTreeMap;

use isophote_frame::{Frame, LIGHT_MAX, NUMBER_MAX, ResponseError, plain};
use isophote_jit::Window;
use isophote_symbolic::{Estimator, Model, Precision, Start};

use crate::budget::WORK_MAX;
use crate::camera::{Camera, DefectMapError, Distortion, IntrinsicsError};
use crate::exposure::ExposureGoal;
use crate::pose::{Geometry, PoseMismatch, Target, TargetError};
use crate::solve::prepare::Preparing;

/// A definition: one of several candidates is accepted when it is more likely the target than not.
pub const CONFIDENCE_MIN: f64 = 0.5;

/// Settings of a session beside the model.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackerOptions {
    /// Arithmetic of the pixel loops; the kernels must have been compiled for it.
    pub precision: Precision,
    /// Region of interest; the whole frame when absent. Clipped to each frame.
    pub window: Option<Window>,
    /// Start values that override the model's own, by parameter name.
    pub start: BTreeMap<String, f64>,
    /// Values of constants, by name. Missing ones come from the camera (`gain`, `read_noise`, `fx` …), then from the
    /// target (`red_x` …), else from the model.
    pub constants: BTreeMap<String, f64>,
    /// The camera.
    pub camera: Camera,
    /// The rigid target that the spots belong to.
    pub target: Option<Target>,
    /// Number of targets, each an instance of the model.
    pub targets: usize,
    /// Motion model.
    pub motion: MotionOptions,
    /// Prediction beyond the frame; none when absent.
    pub predict: Option<PredictOptions>,
    /// Goal of the exposure advice; no advice when absent.
    pub exposure: Option<ExposureGoal>,
    /// Least confidence, 0 … 1, for one of several candidates to be accepted; a lone candidate is accepted whatever its
    /// confidence.
    pub confidence_min: f64,
    /// Least signal-to-noise ratio of targets. Where it is given, everything with at least this response to a matched filter is
    /// fitted, and every fit whose brightness is at least this many standard deviations is accepted: confidence is not asked.
    pub snr_min: Option<f64>,
    /// Least and greatest size of targets: the geometric mean of their outline's half widths, px.
    pub sizes_px: Option<[f64; 2]>,
    /// When kernels beyond the model's own are compiled: alternatives, finer sampling.
    pub preparing: Preparing,
    /// Work limit of a frame; a unit is a pixel of one pass.
    pub work_max: u64,
}

/// Motion of targets, and how long an unseen target is predicted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionOptions {
    /// Standard deviation of the acceleration, px/s² (mm/s² for a pose), redrawn every `period_s`. Learned from the
    /// track when absent.
    pub acceleration_px_s2: Option<f64>,
    /// Time from frame to frame where frames carry no time, s.
    pub period_s: f64,
    /// A target that was seen at least three times in a row is predicted for this long while unseen, then lost; s.
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
            target: None,
            targets: 1,
            motion: MotionOptions::default(),
            predict: None,
            exposure: None,
            confidence_min: CONFIDENCE_MIN,
            snr_min: None,
            sizes_px: None,
            preparing: Preparing::default(),
            work_max: WORK_MAX,
        }
    }
}

/// Prediction beyond the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictOptions {
    /// Horizon, s.
    pub horizon_s: f64,
    /// Number of equal steps to the horizon.
    pub steps: usize,
}

/// Largest number of steps of a prediction.
pub const PREDICT_STEPS_MAX: usize = 256;

/// Longest horizon, s: no learned motion holds for longer.
pub const PREDICT_HORIZON_S_MAX: f64 = 3600.0;

/// Range of the acceleration's deviation, px/s²: 10 kHz and a pixel a frame are 1e8.
const ACCELERATIONS: [f64; 2] = [1e-12, 1e12];

/// Range of the period of frames without a time, s.
const PERIODS_S: [f64; 2] = [1e-9, 1e9];

/// Longest coasting time, s: eleven days.
const COAST_S_MAX: f64 = 1e6;

/// Range of the electrons per DN: pixel values that are fractions may have any unit.
const ELECTRONS_PER_DN: [f64; 2] = [1e-30, NUMBER_MAX];

/// The least black level; it rounds to 0.
const BLACK_MIN: f64 = -0.5;

/// A definition: the lowest `snr_min`. In a frame of a million pixels noise exceeds 3 σ at a thousand places.
const SNR_LEAST: f64 = 3.0;

/// Largest number of targets of one tracker.
pub const TARGETS_MAX: usize = 1000;

/// Why options do not fit a model.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TrackError {
    /// A start value for an unknown parameter.
    #[error("the model has no parameter `{name}`{}", suggestion(.nearest))]
    UnknownParameter {
        /// As given.
        name: String,
        /// The most similar name.
        nearest: Option<String>,
    },
    /// A value for an unknown constant.
    #[error("the model has no constant `{name}`{}", suggestion(.nearest))]
    UnknownConstant {
        /// As given.
        name: String,
        /// The most similar name.
        nearest: Option<String>,
    },
    /// A start value that is out of the parameter's bounds or not a number.
    #[error("start of `{name}` = {} is not {range}", plain(*value))]
    OutsideBounds {
        /// The parameter.
        name: String,
        /// As given.
        value: f64,
        /// The valid range.
        range: String,
    },
    /// A constant that is not finite or exceeds `NUMBER_MAX`.
    #[error("constant `{name}` = {} is no number from -{max} to {max}", plain(*value), max = plain(NUMBER_MAX))]
    OutsideNumbers {
        /// The constant.
        name: String,
        /// As given.
        value: f64,
    },
    /// Invalid intrinsics.
    #[error(transparent)]
    Intrinsics(#[from] IntrinsicsError),
    /// An invalid defect map, or one for another image size.
    #[error(transparent)]
    DefectMap(#[from] DefectMapError),
    /// An invalid response, or one for another image size.
    #[error(transparent)]
    Response(#[from] ResponseError),
    /// An invalid target.
    #[error(transparent)]
    Target(#[from] TargetError),
    /// Target and model, or lens and frames, do not match.
    #[error(transparent)]
    Pose(#[from] PoseMismatch),
    /// The model's formulas lack a distortion term of the lens.
    #[error(
        "the model's formulas have no `{wanted}`, which the camera's lens needs: take a model for lenses of this kind"
    )]
    Lens {
        /// The constant that is missing.
        wanted: String,
    },
    /// A start by `pose.…` without the roles or constants of a pose.
    #[error(
        "`{name}` starts at a pose: that needs the roles `position` and `orientation`, the constants `fx`, `fy`, `cx`, `cy`, \
         and for each spot's table of roles, `red` say, `red_x`, `red_y` and `red_radius`, all of which make sense"
    )]
    NoGeometry {
        /// The parameter.
        name: String,
    },
    /// A number out of its range.
    #[error("{name} = {} must be {range}", plain(*value))]
    Range {
        /// The key in a session's options, or in the session: `camera.…`, `constants.…`.
        name: &'static str,
        /// As given.
        value: f64,
        /// The valid range.
        range: String,
    },
    /// The window and the frames do not overlap.
    #[error(
        "the window lies outside of the frames: it begins at {}, they have {} px",
        joined(first, ","),
        joined(size, "×")
    )]
    Window {
        /// Its first pixel.
        first: Vec<usize>,
        /// Of the frames.
        size: Vec<usize>,
    },
    /// The kernels were compiled for another precision.
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

/// True for finite numbers of at most `NUMBER_MAX`.
fn is_number(value: f64) -> bool {
    value.abs() <= NUMBER_MAX
}

impl MotionOptions {
    /// The density of the acceleration as white noise, unit²/s³, where it is given.
    pub(crate) fn density(&self) -> Option<f64> {
        self.acceleration_px_s2.map(|deviation| deviation * deviation * self.period_s)
    }

    fn check(&self) -> Result<(), TrackError> {
        let inside = |name, value: f64, [least, most]: [f64; 2], note: &str| match (least..=most).contains(&value) {
            true => Ok(()),
            false => {
                let range = format!("from {}{note} to {}", plain(least), plain(most));
                Err(TrackError::Range { name, value, range })
            }
        };
        inside("motion.period_s", self.period_s, PERIODS_S, "")?;
        inside("motion.acceleration_px_s2", self.acceleration_px_s2.unwrap_or(1.0), ACCELERATIONS, "")?;
        inside("motion.coast_s", self.coast_s, [0.0, COAST_S_MAX], " (lost at once)")
    }
}

impl TrackerOptions {
    /// Checks names and values against a model.
    ///
    /// # Errors
    /// For the first unknown name or invalid value.
    pub fn check(&self, model: &Model) -> Result<(), TrackError> {
        let nearest = |name: &str| model.nearest_name(name).map(str::to_string);
        for (name, &value) in &self.start {
            let Some(id) = model.parameter(name) else {
                return Err(TrackError::UnknownParameter { name: name.clone(), nearest: nearest(name) });
            };
            let parameter = &model.parameters()[id.index()];
            let inside = parameter.min.is_none_or(|min| value > min) && parameter.max.is_none_or(|max| value < max);
            if !inside || !is_number(value) {
                let (min, max) = (parameter.min.unwrap_or(-NUMBER_MAX), parameter.max.unwrap_or(NUMBER_MAX));
                let range = format!("between {} and {}, its bounds (exclusive)", plain(min), plain(max));
                return Err(TrackError::OutsideBounds { name: name.clone(), value, range });
            }
        }
        self.motion.check()?;
        if !(1..=TARGETS_MAX).contains(&self.targets) {
            let range = format!("1 to {TARGETS_MAX}");
            return Err(TrackError::Range { name: "targets", value: self.targets as f64, range });
        }
        if let Some(PredictOptions { horizon_s, steps }) = self.predict {
            if !(horizon_s > 0.0 && horizon_s <= PREDICT_HORIZON_S_MAX) {
                let range = format!("above 0 and at most {PREDICT_HORIZON_S_MAX}");
                return Err(TrackError::Range { name: "predict.horizon_s", value: horizon_s, range });
            }
            if !(1..=PREDICT_STEPS_MAX).contains(&steps) {
                let range = format!("1 to {PREDICT_STEPS_MAX}");
                return Err(TrackError::Range { name: "predict.steps", value: steps as f64, range });
            }
        }
        if !(0.0..=1.0).contains(&self.confidence_min) {
            let range = "0 to 1".to_string();
            return Err(TrackError::Range { name: "confidence_min", value: self.confidence_min, range });
        }
        if let Some(value) = self.snr_min.filter(|snr| !(*snr >= SNR_LEAST && *snr <= NUMBER_MAX)) {
            return Err(TrackError::Range { name: "snr_min", value, range: format!("at least {SNR_LEAST}") });
        }
        if let Some([least, most]) = self.sizes_px
            && !(least > 0.0 && least <= most && most <= NUMBER_MAX)
        {
            let range = "above 0, the smaller one first".to_string();
            return Err(TrackError::Range { name: "sizes_px", value: least, range });
        }
        let is_several = model.roles().len() > 1 || model.roles().iter().any(|roles| !roles.position.is_empty());
        if self.targets > 1 && is_several {
            let range = "1 for a model that has several targets of its own, or a pose".to_string();
            return Err(TrackError::Range { name: "targets", value: self.targets as f64, range });
        }
        for (name, &value) in &self.constants {
            if model.constant(name).is_none() {
                return Err(TrackError::UnknownConstant { name: name.clone(), nearest: nearest(name) });
            }
            if !is_number(value) {
                return Err(TrackError::OutsideNumbers { name: name.clone(), value });
            }
        }
        if let Some(target) = &self.target {
            target.check()?;
            PoseMismatch::check_target(model, target)?;
        }
        self.check_camera(model)?;
        if let Some(map) = &self.camera.defect_map {
            map.check()?;
        }
        self.camera.linear_response()?;
        let is_share = |share: &f64| (0.0..1.0).contains(share);
        let of_model =
            model.defects().map(|constant| ("constants.defects", self.constants_of(model)[constant.index()]));
        let of_camera = self.camera.defects.map(|value| ("camera.defects", value));
        if let Some((name, value)) = of_camera.into_iter().chain(of_model).find(|(_, value)| !is_share(value)) {
            let range = "a share of all pixels, from 0 to less than 1".to_string();
            return Err(TrackError::Range { name, value, range });
        }
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

    /// Checks the options against a frame size, px, inner dimension first: the window overlaps, the defect map and the
    /// gains are for this size, and poses can be computed.
    ///
    /// # Errors
    /// When the window does not overlap, or the map or the lens is for another size.
    pub fn check_size(&self, model: &Model, size: &[usize]) -> Result<(), TrackError> {
        if let Some(map) = &self.camera.defect_map {
            map.check_size(size)?;
        }
        if let Some(response) = &self.camera.response {
            response.check_size(size)?;
        }
        if let Some(window) = &self.window {
            let first = [window.x, window.y, window.slices.first[0], window.slices.first[1]];
            if first.iter().zip(size).any(|(first, side)| first >= side) {
                let first = first[..size.len().min(4)].to_vec();
                return Err(TrackError::Window { first, size: size.to_vec() });
            }
        }
        let is_pose = self.target.is_some() || model.roles().iter().any(|roles| !roles.position.is_empty());
        match &self.camera.intrinsics {
            Some(lens) if is_pose => Ok(PoseMismatch::check_size(lens, size)?),
            _ => Ok(()),
        }
    }

    /// The first row of a table whose error has no finite positive variance, from 0, with that variance; `None` when
    /// all have one, and for pictures.
    pub fn row_without_weight(&self, model: &Model, frame: &Frame) -> Option<(usize, f64)> {
        let planes = frame.planes_of(model.channels()).filter(|_| frame.names().is_some() && model.has_noise())?;
        let views: Vec<_> = planes.into_iter().map(|plane| frame.plane_view(plane)).collect();
        let constants = self.constants_of(model);
        let is_weight = |variance: &f64| variance.is_finite() && *variance > 0.0;
        (0..frame.width()).find_map(|row| {
            let channels: Vec<f64> = views.iter().map(|view| view.pixel(row, 0)).collect();
            let variances = model.stated_variances(&[row as f64], &channels, &constants);
            variances.into_iter().find(|variance| !is_weight(variance)).map(|variance| (row, variance))
        })
    }

    /// Checks the ranges of the camera's figures, and of the model's constants of the same meaning.
    fn check_camera(&self, model: &Model) -> Result<(), TrackError> {
        let camera = &self.camera;
        // Without `noise` these constants may have any meaning.
        let constant = |name: &str| self.constants.get(name).copied().filter(|_| model.has_noise());
        if let (Some(value), None) = (camera.row_noise_e, camera.electrons_per_dn) {
            let range = "given together with `electrons_per_dn`".to_string();
            return Err(TrackError::Range { name: "camera.row_noise_e", value, range });
        }
        let above_black = [camera.black.max(BLACK_MIN).next_up(), LIGHT_MAX];
        let rows: [(&str, Option<f64>, [f64; 2], &str); 7] = [
            ("camera.black", Some(camera.black), [BLACK_MIN, LIGHT_MAX], "no less than 0 but for rounding"),
            ("camera.saturation", camera.saturation, above_black, "above `black`"),
            ("camera.electrons_per_dn", camera.electrons_per_dn, ELECTRONS_PER_DN, "a positive number"),
            ("camera.read_noise_e", camera.read_noise_e, [0.0, LIGHT_MAX], "0 or a positive number"),
            ("camera.row_noise_e", camera.row_noise_e, [0.0, LIGHT_MAX], "0 or a positive number"),
            ("constants.gain", constant("gain"), [0.0, NUMBER_MAX], "0 or a positive number"),
            ("constants.read_noise", constant("read_noise"), [0.0, NUMBER_MAX], "0 or a positive number"),
        ];
        let wrong = rows.into_iter().find_map(|(name, value, [least, most], range)| {
            let value = value.filter(|value| !(least..=most).contains(value))?;
            Some(TrackError::Range { name, value, range: format!("{range}, and {} at most", plain(most)) })
        });
        wrong.map_or(Ok(()), Err)
    }

    /// Checks that a model with a lens in its formulas has all terms of this lens.
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

    /// Values of all constants, in the model's order.
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

/// Numbers joined by a separator.
fn joined(numbers: &[usize], between: &str) -> String {
    numbers.iter().map(usize::to_string).collect::<Vec<_>>().join(between)
}
