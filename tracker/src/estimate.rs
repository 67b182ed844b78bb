//! `Estimate`: the result of one frame for one target, and how its fit ended.

use isophote_symbolic::{Model, Parameter, ParameterId};

use serde::{Deserialize, Serialize};

use crate::budget::Stop;
use crate::exposure::ExposureAdvice;
use crate::photometry::Photometry;
use crate::pose::Pose;
use crate::sight::detect::Strength;

/// Tracking state of a target.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "kebab-case")]
pub enum TrackState {
    /// Not found yet.
    Searching,
    /// Found; the next frame starts from this estimate.
    Tracking,
    /// Not seen in this frame; predicted.
    Coasting,
    /// No longer found; every frame is searched.
    Lost,
}

/// How a fit ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Ending {
    /// Converged: the last step of every parameter not held at a bound was below its tolerance. That step is taken.
    SmallStep,
    /// The stage used up its iterations, or its last round still moved the fit by more than half a standard deviation. Parameters
    /// are the best point reached; their covariance includes the remaining step.
    IterationLimit,
    /// No step within the constraints lowers F, however short. Parameters are the best point reached, which may be far from a
    /// minimum: the fit is rejected.
    NoDescent,
    /// The frame's limit of work or time was reached. Parameters are the best point reached, a valid fit short of its minimum,
    /// if that can be the target; else the last known ones, and the target's track is unchanged.
    Budget,
    /// The fit was cancelled because its result was no longer needed. Parameters are the last known ones, and the target's
    /// track is unchanged.
    Cancelled,
    /// The target was not near its prediction, and the full search is postponed because other searches are running.
    /// Parameters and track as for `Cancelled`.
    Postponed,
    /// Too few pixels are left in the domain. Parameters are the last point with enough pixels.
    DomainVanished,
    /// F or a derivative is NaN or infinite, or no kernel could run. Parameters are the last point with finite values.
    NonFinite,
    /// The fit ended normally, but its normal equations are singular: some parameters are undetermined. No covariance.
    Singular,
    /// The search reached its limit before it fitted everything that stands out, and no fit may be the target. Parameters are
    /// the last known ones.
    SearchLimit,
    /// No fit was tried: nothing in the window stands out of the background. Parameters are the last known ones.
    #[default]
    NoTarget,
    /// No fit was tried: the frame's planes or dimensions do not match the model. Parameters are the last known ones.
    WrongFrame,
    /// No fit was tried: the kernels could not be compiled. Parameters are the last known ones.
    NoKernel,
}

impl Ending {
    /// True when the parameters are the best point that a fit has reached.
    pub fn is_fit(self) -> bool {
        self.is_converged() || matches!(self, Ending::IterationLimit | Ending::NoDescent)
    }

    /// True at a minimum, whether or not it determines all parameters.
    pub fn is_converged(self) -> bool {
        matches!(self, Ending::SmallStep | Ending::Singular)
    }

    /// True when the parameters were still moving.
    pub fn is_cut_short(self) -> bool {
        matches!(self, Ending::Budget | Ending::IterationLimit)
    }

    /// True when the frame was not searched to the end: it gives no evidence about the target.
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

/// A trial point of a stage.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TracePoint {
    /// F at the point, over the pixels of the point before.
    pub objective: f64,
    /// The trust region's radius ‖D δ‖; absent at a start, and for steps from a prediction, which use none.
    pub radius: Option<f64>,
    /// ρ, the actual over the predicted reduction of F; absent at a start.
    pub ratio: Option<f64>,
}

/// Limit of the trace, of each stage and of all stages.
pub(crate) const TRACE_MAX: usize = 256;

/// Statistics of one stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StageReport {
    /// Trial steps.
    pub iterations: u32,
    /// Gradient passes; passes over some rows of a large window count by their share of the pixels.
    pub passes: u32,
    /// How it ended.
    pub ending: Ending,
    /// Points with an indefinite full Hessian (Newton only).
    pub indefinite_steps: u32,
    /// Pixels of the first pass.
    pub pixels_first: u64,
    /// Pixels of the smallest pass.
    pub pixels_least: u64,
    /// Pixels of the last pass.
    pub pixels_last: u64,
    /// The first trial points; empty unless requested, see [`Watch::is_traced`](crate::Watch::is_traced).
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub trace: Vec<TracePoint>,
}

impl StageReport {
    /// The merged report of a stage that continued where `earlier` had ended.
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

    /// Appends a point, up to [`TRACE_MAX`].
    pub(crate) fn note(&mut self, point: TracePoint) {
        if self.trace.len() < TRACE_MAX {
            self.trace.push(point);
        }
    }

    /// True when the domain lost more than half of its pixels.
    pub fn domain_shrank(&self) -> bool {
        2 * self.pixels_least < self.pixels_first
    }
}

/// Reason why a fit is not accepted as the target.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Rejection {
    /// It ended without a usable fit; see `ending`.
    Ending,
    /// The centre left the window.
    OutsideWindow,
    /// A semi-axis of the outline is longer than the window, or the outline is no ellipse (A is not positive definite).
    Oversized,
    /// Not significantly brighter than noise.
    Faint,
    /// A bound or constraint is violated.
    OutsideBounds,
    /// Other objects are in view, and the probability that it is the target is below `confidence_min`.
    Unlikely,
    /// Acceptable if it were alone, but other candidates reduce its probability below `confidence_min`.
    OneOfSeveral,
    /// It differs in appearance from the tracked target, or is where that target cannot be.
    Unlike,
    /// Poses only: the residuals are larger than those of the document's other fits, or than its noise allows.
    Misfit,
}

impl Rejection {
    /// The name in documents.
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

/// Changes to the model or its pixels in a fit that was preferred to the plain one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Substitute {
    /// Degree of the polynomial added to the background.
    pub degree: u32,
    /// True if outliers were excluded.
    pub robust: bool,
    /// Excluded share of the target: of its light; for a pose, of its spots' pixels.
    pub hidden: f64,
}

/// The prior probability that a pixel is an outlier; also the mean share of a target that scattered ones hide.
pub(crate) const OUTLIERS: f64 = 0.05;

impl Substitute {
    /// True for the plain model fitted to all but scattered outliers.
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
    /// Residuals exceed the noise.
    Misfit {
        /// Excess of χ²/ν, in its standard deviations.
        sigma: f64,
        /// Root mean square of the residuals beyond noise, over the target's height; absent without a `brightness`.
        #[serde(skip_serializing_if = "Option::is_none", default)]
        share: Option<f64>,
    },
    /// The residuals suit another profile better than the document's.
    RoughModel,
    /// Something else may be the target.
    Ambiguous {
        /// Centre of the most likely alternative when it was last searched for, px.
        #[serde(skip_serializing_if = "Option::is_none", default)]
        place: Option<[f64; 2]>,
    },
    /// Pixels are saturated.
    Saturated {
        /// Saturated share of the domain's pixels.
        share: f64,
    },
    /// Part of the target is covered.
    Covered {
        /// Covered share of its light; for a pose, of its spots' pixels.
        share: f64,
    },
    /// A `min` or `max` of the document holds parameters back.
    AtBound {
        /// Names of these parameters.
        parameters: Vec<String>,
    },
    /// The target extends beyond the frame or the session's window.
    CutOff {
        /// Share of the rectangle around its outline that lies outside.
        share: f64,
    },
    /// Pixels are noisier than the document states.
    Noisier {
        /// Measured over stated standard deviation.
        factor: f64,
    },
    /// The variance of pixels is less than a tenth of the one that the document states.
    Quieter {
        /// Measured over stated standard deviation.
        factor: f64,
    },
}

/// A rejected fit.
#[derive(Clone, Debug, PartialEq)]
pub struct RejectedFit {
    /// In document order.
    pub parameters: Vec<f64>,
    /// The probability that it is the target, where known.
    pub confidence: Option<f64>,
    /// The reason of the rejection.
    pub rejection: Rejection,
    /// Its shortcomings.
    pub quality: Vec<Quality>,
}

/// Gauss points per pixel side, for models that leave the number open (`quadrature = "auto"`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Sampled {
    /// For the prediction.
    pub points: u32,
    /// For its derivatives.
    pub slopes: u32,
}

/// Predicted position and velocity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Ahead {
    /// Time after the frame, s.
    pub after_s: f64,
    /// Centre coordinates of all targets of the model, in the order of their roles, px. For a model whose parameters are a
    /// pose: its position, mm; `velocity` and `covariance` then use mm instead of px.
    pub centre: Vec<f64>,
    /// Velocities of these coordinates, px/s.
    pub velocity: Vec<f64>,
    /// Covariance of the coordinates followed by the velocities, row by row; px², px²/s and px²/s².
    pub covariance: Vec<Vec<f64>>,
}

/// A parameter is at a bound when it is nearer than this, in standard deviations.
const NEAR: f64 = 0.05;
/// The same as a share of the bound, for parameters without a standard deviation.
const NEAREST: f64 = 1e-9;

/// The result of one frame for one target.
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
    /// All parameters in document order: predicted when `state` is coasting, of the last good frame when lost, empty
    /// when never found.
    pub parameters: Vec<f64>,
    /// The free parameters of the last stage.
    pub order: Vec<ParameterId>,
    /// Their covariance, rows and columns in `order`; predicted when `state` is coasting. Absent when singular or without a fit.
    pub covariance: Option<Vec<Vec<f64>>>,
    /// F, without a factor ½.
    pub objective: Option<f64>,
    /// χ² over pixels minus free parameters; with `noise` near 1 for a good model.
    pub reduced_chi_square: Option<f64>,
    /// The standard deviation of pixels over the one that `noise` states, measured in the last frames: `covariance` is
    /// scaled by it where it exceeds 1. Absent in the first frames, and without `noise` in the model.
    pub noise_ratio: Option<f64>,
    /// ln L of the frame's pixels in the domain.
    pub log_likelihood: Option<f64>,
    /// The probability that the tracked object is the target; absent for models without a brightness, for poses, and
    /// where nothing was seen. Of a fit that is rejected as unlikely: its own.
    pub confidence: Option<f64>,
    /// The best exposure, if advice was requested and the target was seen.
    pub exposure_advice: Option<ExposureAdvice>,
    /// Predicted positions, if requested and the motion is known.
    pub ahead: Vec<Ahead>,
    /// Pixels of the last pass.
    pub pixels: u64,
    /// Pixels of the domain that the defect map excluded; `None` without a map.
    pub left_out: Option<u64>,
    /// The saturated share of the domain's pixels.
    pub saturated: f64,
    /// Trial steps of each stage.
    pub iterations: Vec<u32>,
    /// True when the last stage ended by a small step and the normal equations are regular.
    pub converged: bool,
    /// How the fit ended.
    pub ending: Ending,
    /// Why the fit was rejected, if it was.
    pub rejection: Option<Rejection>,
    /// Shortcomings of the tracked fit.
    pub quality: Vec<Quality>,
    /// The rejected fit, if there is one.
    pub candidate: Option<RejectedFit>,
    /// Statistics of each stage.
    pub stages: Vec<StageReport>,
    /// The substitute that was fitted because the plain model left large residuals.
    pub substitute: Option<Substitute>,
    /// Quadrature of the pixels, where the model leaves it open.
    pub sampled: Option<Sampled>,
    /// Where nothing was found: the strongest response to the document's own image.
    pub strongest: Option<Strength>,
    /// Flux, width and axes while the target is tracked, for a single elliptical target with brightness in a plane.
    pub photometry: Option<Photometry>,
    /// The target's pose, where lens and target are known and the model fits its spots.
    pub pose: Option<Pose>,
}

impl Estimate {
    /// Trial points with their stage and index in it, up to the limit; empty unless requested.
    pub fn trace(&self) -> impl Iterator<Item = (usize, usize, TracePoint)> + '_ {
        let stages = self.stages.iter().enumerate();
        let points =
            stages.flat_map(|(stage, report)| report.trace.iter().enumerate().map(move |(k, at)| (stage, k, *at)));
        points.take(TRACE_MAX)
    }

    /// Points with an indefinite full Hessian, over all stages.
    pub fn indefinite_steps(&self) -> u32 {
        self.stages.iter().map(|stage| stage.indefinite_steps).sum()
    }

    /// True when a stage's domain lost more than half of its pixels.
    pub fn domain_shrank(&self) -> bool {
        self.stages.iter().any(StageReport::domain_shrank)
    }

    /// Names of parameters at a bound of the document: nearer to it than a twentieth of their standard deviation.
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
