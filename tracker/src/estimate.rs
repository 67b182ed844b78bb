//! `Estimate`: what one frame says about one target, and how the fit that says so ended.

use isophote_symbolic::{Model, Parameter, ParameterId};

use serde::{Deserialize, Serialize};

use crate::budget::Stop;
use crate::exposure::ExposureAdvice;
use crate::pose::Pose;
use crate::sight::detect::Strength;

/// Whether the target is followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "kebab-case")]
pub enum TrackState {
    /// Not found yet.
    Searching,
    /// Found; the next frame starts from this estimate.
    Tracking,
    /// Predicted, not seen.
    Coasting,
    /// Was found, is not any more; every frame is searched.
    Lost,
}

/// How a fit ended, and what it leaves behind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Ending {
    /// Every parameter's step was below its tolerance, but for those that a bound holds back; that last step is taken. The one
    /// ending that is convergence.
    SmallStep,
    /// The stage's iterations are used up, or its last round still moved the fit by more than half a standard deviation. Parameters
    /// are the best point reached; their covariance includes the step that was left to take.
    IterationLimit,
    /// No step however short lowers F within constraints. Parameters are the best point reached, which may be far from a minimum: not
    /// counted as a fit.
    NoDescent,
    /// The frame's bound in work or time was reached. Parameters are the best point reached, a valid fit that is not at its
    /// minimum, where that can be the target; else the last known ones, and what is remembered of it is as it was.
    Budget,
    /// Nobody waited for the fit any longer. Parameters are the last known ones, and what is remembered of the target is as it
    /// was.
    Cancelled,
    /// The target was not near where it should be, and the search of all that may be looked at is put off: others are at it.
    /// As for `Cancelled`.
    Postponed,
    /// Too few pixels are left in the domain. Parameters are the last point that had enough of them.
    DomainVanished,
    /// F or a derivative is NaN or infinite, or no kernel could run. Parameters are the last point where all was finite.
    NonFinite,
    /// The fit ended well but its normal equations are singular: some parameters are undetermined. No covariance.
    Singular,
    /// The search used up what it may before all that stands out was fitted, and nothing that was fitted may be the target.
    /// Parameters are the last known ones.
    SearchLimit,
    /// No fit was tried: nothing in the window stands out of the background. Parameters are the last known ones.
    #[default]
    NoTarget,
    /// No fit was tried: planes or dimensions are not those of the model. Parameters are the last known ones.
    WrongFrame,
    /// No fit was tried: the kernels could not be compiled. Parameters are the last known ones.
    NoKernel,
}

impl Ending {
    /// True when the parameters are the best point that a fit has reached.
    pub fn is_fit(self) -> bool {
        self.is_converged() || matches!(self, Ending::IterationLimit | Ending::NoDescent)
    }

    /// True when they are those of a minimum, whether or not it determines all of them.
    pub fn is_converged(self) -> bool {
        matches!(self, Ending::SmallStep | Ending::Singular)
    }

    /// True when the parameters were still moving.
    pub fn is_cut_short(self) -> bool {
        matches!(self, Ending::Budget | Ending::IterationLimit)
    }

    /// True when the frame was not looked at to the end: it says nothing about the target.
    pub fn is_unfinished(self) -> bool {
        matches!(self, Ending::Budget | Ending::Cancelled | Ending::Postponed)
    }

    /// The name in documents, e.g. `small-step`.
    pub fn name(self) -> &'static str {
        match self {
            Ending::SmallStep => "small-step",
            Ending::IterationLimit => "iteration-limit",
            Ending::NoDescent => "no-descent",
            Ending::Budget => "budget",
            Ending::Cancelled => "cancelled",
            Ending::Postponed => "postponed",
            Ending::DomainVanished => "domain-vanished",
            Ending::NonFinite => "non-finite",
            Ending::Singular => "singular",
            Ending::SearchLimit => "search-limit",
            Ending::NoTarget => "no-target",
            Ending::WrongFrame => "wrong-frame",
            Ending::NoKernel => "no-kernel",
        }
    }
}

impl From<Stop> for Ending {
    fn from(stop: Stop) -> Ending {
        match stop {
            Stop::Budget => Ending::Budget,
            Stop::Cancelled => Ending::Cancelled,
            Stop::Postponed => Ending::Postponed,
        }
    }
}

/// A point that a stage has tried.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TracePoint {
    /// F there, over the pixels of the point before.
    pub objective: f64,
    /// The trust region's radius then, ‖D δ‖; absent at a start, and on the short way from a prediction, which has none.
    pub radius: Option<f64>,
    /// ρ, by how much F fell over what was promised; absent at a start.
    pub ratio: Option<f64>,
}

/// Points of a stage, and of all stages, that are kept.
pub(crate) const TRACE_MAX: usize = 256;

/// How one stage went.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StageReport {
    /// Steps tried.
    pub iterations: u32,
    /// Gradient passes; those over some rows of a large window count by their share of the pixels.
    pub passes: u32,
    /// How it ended.
    pub ending: Ending,
    /// Points at which the full Hessian was indefinite (Newton only).
    pub indefinite_steps: u32,
    /// Pixels of the first pass, …
    pub pixels_first: u64,
    /// … of the smallest, …
    pub pixels_least: u64,
    /// … and of the last.
    pub pixels_last: u64,
    /// The points that it tried, the first ones; empty where nobody asked, see [`Watch::is_traced`](crate::Watch::is_traced).
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub trace: Vec<TracePoint>,
}

impl StageReport {
    /// The report of a stage that was run again from where `earlier` had ended.
    pub(crate) fn after(self, earlier: &StageReport) -> StageReport {
        if earlier.passes == 0 {
            return self;
        }
        let trace = earlier.trace.iter().chain(&self.trace).copied().take(TRACE_MAX).collect();
        StageReport {
            trace,
            iterations: earlier.iterations + self.iterations,
            passes: earlier.passes + self.passes,
            indefinite_steps: earlier.indefinite_steps + self.indefinite_steps,
            pixels_first: earlier.pixels_first,
            pixels_least: earlier.pixels_least.min(self.pixels_least),
            ..self
        }
    }

    /// Keeps a point, while there is room.
    pub(crate) fn note(&mut self, point: TracePoint) {
        if self.trace.len() < TRACE_MAX {
            self.trace.push(point);
        }
    }

    /// True when the domain lost more than half of its pixels on the way.
    pub fn domain_shrank(&self) -> bool {
        2 * self.pixels_least < self.pixels_first
    }
}

/// Why a fit is not taken for the target.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Rejection {
    /// See the ending.
    Ending,
    /// The centre left the window.
    OutsideWindow,
    /// A semi-axis of the outline is longer than the window, or A is not positive definite: nothing of the kind was seen.
    Oversized,
    /// No brighter than noise alone may be.
    Faint,
    /// A bound or constraint does not hold.
    OutsideBounds,
    /// Other things are in view, and the probability that it is the target is less than `confidence_min`.
    Unlikely,
    /// It would be taken if it were alone: other things that may be the target leave it less than `confidence_min`.
    OneOfSeveral,
    /// It looks otherwise than the target that was followed, or is where that cannot be.
    Unlike,
    /// Of a pose: it leaves more unexplained than the document's other fits, or than its noise allows.
    Misfit,
}

impl Rejection {
    /// As documents have it.
    pub fn name(self) -> &'static str {
        match self {
            Rejection::Ending => "ending",
            Rejection::OutsideWindow => "outside-window",
            Rejection::Oversized => "oversized",
            Rejection::Faint => "faint",
            Rejection::OutsideBounds => "outside-bounds",
            Rejection::Unlikely => "unlikely",
            Rejection::OneOfSeveral => "one-of-several",
            Rejection::Unlike => "unlike",
            Rejection::Misfit => "misfit",
        }
    }
}

/// What is different about a fit that was chosen over the plain one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Substitute {
    /// Of the polynomial added to the background.
    pub degree: u32,
    /// Outliers were left out.
    pub robust: bool,
    /// Share of the target that was left out: of its light; of a pose, of the pixels of its spots.
    pub hidden: f64,
}

/// The prior probability that a pixel is an outlier. Scattered ones hide this share of a target, in the mean.
pub(crate) const OUTLIERS: f64 = 0.05;

impl Substitute {
    /// True for the model's own fit to all but scattered outliers.
    pub fn is_marginal(&self) -> bool {
        self.degree == 0 && self.hidden <= OUTLIERS
    }

    /// A background that bends can make up for much of a target.
    pub(crate) fn is_bent(&self) -> bool {
        self.degree >= 2
    }
}

/// A shortcoming of a fit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(tag = "code", rename_all = "kebab-case")]
pub enum Quality {
    /// Residuals are larger than noise.
    Misfit {
        /// By how many standard deviations of χ²/ν.
        sigma: f64,
        /// The root mean square of what noise does not account for, over the target's height; absent without a `brightness`.
        #[serde(skip_serializing_if = "Option::is_none", default)]
        share: Option<f64>,
    },
    /// The residuals are rather those of another profile than of the document's.
    RoughModel,
    /// Something else may be the target.
    Ambiguous {
        /// The centre of the likeliest other thing when it was last looked for, px.
        #[serde(skip_serializing_if = "Option::is_none", default)]
        place: Option<[f64; 2]>,
    },
    /// Pixels are saturated.
    Saturated {
        /// Of those in the domain.
        share: f64,
    },
    /// Something is in front of it.
    Covered {
        /// Of its light.
        share: f64,
    },
    /// A `min` or `max` of the document holds parameters back.
    AtBound {
        /// Their names.
        parameters: Vec<String>,
    },
    /// It reaches beyond the frame, or the window of the session.
    CutOff {
        /// Of the rectangle around its outline.
        share: f64,
    },
    /// Pixels are noisier than the document states.
    Noisier {
        /// Their standard deviation over the stated one.
        factor: f64,
    },
}

/// A fit that is not taken for the target.
#[derive(Clone, Debug, PartialEq)]
pub struct RejectedFit {
    /// In document order.
    pub parameters: Vec<f64>,
    /// The probability that it is the target, where that can be told.
    pub confidence: Option<f64>,
    /// Why it is not taken.
    pub rejection: Rejection,
    /// Its shortcomings.
    pub quality: Vec<Quality>,
}

/// How a pixel was averaged over, where a model leaves that open (`quadrature = "auto"`): Gauss points a side.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Sampled {
    /// Of the prediction.
    pub points: u32,
    /// Of its derivatives.
    pub slopes: u32,
}

/// Where a target will be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Ahead {
    /// So long after the frame, s.
    pub after_s: f64,
    /// The centre's coordinates, px; of all targets of the model, in the order of their roles. Of a model whose parameters are
    /// a pose: its position, mm. What follows then has mm in the place of px.
    pub centre: Vec<f64>,
    /// Their velocities, px/s.
    pub velocity: Vec<f64>,
    /// Of the coordinates, then the velocities, in this order; rows of px², px²/s and px²/s².
    pub covariance: Vec<Vec<f64>>,
}

/// A parameter is at a bound when it is nearer than this, in standard deviations, …
const NEAR: f64 = 0.05;
/// … or in shares of the bound, where it has none.
const NEAREST: f64 = 1e-9;

/// What one frame says about one target.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// The target's id: the name of its roles, else its number.
    pub target: String,
    /// The frame's number.
    pub sequence: u64,
    /// When the frame was taken.
    pub capture_ns: Option<u64>,
    /// Whether the target is followed.
    pub state: TrackState,
    /// All parameters in document order; predicted when `state` is coasting; of the last good frame when it is lost; empty
    /// when never found.
    pub parameters: Vec<f64>,
    /// The free parameters of the last stage.
    pub order: Vec<ParameterId>,
    /// Their covariance, rows and columns in `order`. Absent when singular or when no fit is behind it; that of the
    /// prediction when `state` is coasting.
    pub covariance: Option<Vec<Vec<f64>>>,
    /// F, without a factor ½.
    pub objective: Option<f64>,
    /// χ² over pixels minus free parameters; with `noise` near 1 for a good model.
    pub reduced_chi_square: Option<f64>,
    /// The standard deviation of pixels over that which `noise` states, as the last frames show it: `covariance` counts at
    /// least that. Absent in the first frames, and where the model has no `noise`.
    pub noise_ratio: Option<f64>,
    /// ln L of the frame's pixels in the domain.
    pub log_likelihood: Option<f64>,
    /// The probability that the thing tracked is the target; absent where the model does not say what is bright, or is that of a
    /// pose, and where nothing was seen. Of a fit that is rejected as unlikely: its own.
    pub confidence: Option<f64>,
    /// What exposure would be best, when it was asked for and the target was seen.
    pub exposure_advice: Option<ExposureAdvice>,
    /// Where the target will be, when that was asked for and its motion is known.
    pub ahead: Vec<Ahead>,
    /// Pixels that the last pass used.
    pub pixels: u64,
    /// Pixels of the domain that the camera's map of defects left out; `None` without a map.
    pub left_out: Option<u64>,
    /// The share of the domain's pixels that are saturated.
    pub saturated: f64,
    /// Steps tried, one number a stage.
    pub iterations: Vec<u32>,
    /// True when the last stage ended by a small step and the normal equations are regular.
    pub converged: bool,
    /// How the fit ended.
    pub ending: Ending,
    /// Why the fit is not taken for the target, when it is not.
    pub rejection: Option<Rejection>,
    /// Shortcomings of the tracked fit.
    pub quality: Vec<Quality>,
    /// The fit that is not taken for the target, when there is one.
    pub candidate: Option<RejectedFit>,
    /// How each stage went.
    pub stages: Vec<StageReport>,
    /// What was fitted in the model's place, when that left too much unexplained.
    pub substitute: Option<Substitute>,
    /// How pixels were sampled, where the model leaves that open.
    pub sampled: Option<Sampled>,
    /// Where nothing was found: the strongest thing that the document's own image is like.
    pub strongest: Option<Strength>,
    /// Where the target is, when lens and target are known and the model shows its spots.
    pub pose: Option<Pose>,
}

impl Estimate {
    /// The points that the fit tried, with the stage and their number in it, as many as are kept; empty where nobody asked.
    pub fn trace(&self) -> impl Iterator<Item = (usize, usize, TracePoint)> + '_ {
        let stages = self.stages.iter().enumerate();
        let points =
            stages.flat_map(|(stage, report)| report.trace.iter().enumerate().map(move |(k, at)| (stage, k, *at)));
        points.take(TRACE_MAX)
    }

    /// Points at which the full Hessian was indefinite, over all stages.
    pub fn indefinite_steps(&self) -> u32 {
        self.stages.iter().map(|stage| stage.indefinite_steps).sum()
    }

    /// True when a stage's domain lost more than half of its pixels on the way.
    pub fn domain_shrank(&self) -> bool {
        self.stages.iter().any(StageReport::domain_shrank)
    }

    /// Names of parameters that a bound of the document holds back: nearer to it than a twentieth of their standard deviation.
    pub fn at_bounds(&self, model: &Model) -> Vec<String> {
        let is_held = |(index, parameter): &(usize, &Parameter)| {
            let (id, value) = (ParameterId(*index as u32), self.parameters[*index]);
            let near = NEAR * self.deviation(id).unwrap_or(0.0);
            let bounds = parameter.min.iter().chain(&parameter.max);
            self.order.contains(&id)
                && bounds.clone().any(|bound| (value - bound).abs() <= near.max(NEAREST * bound.abs()))
        };
        let parameters = model.parameters().iter().enumerate().filter(|(index, _)| *index < self.parameters.len());
        parameters.filter(is_held).map(|(_, parameter)| parameter.name.clone()).collect()
    }

    /// The standard deviation of a free parameter.
    pub fn deviation(&self, parameter: ParameterId) -> Option<f64> {
        let index = self.order.iter().position(|&p| p == parameter)?;
        Some(self.covariance.as_ref()?.get(index)?.get(index)?.sqrt())
    }
}
