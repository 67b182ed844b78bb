//! One estimate, as streamed and as printed by `fit --json`.

use isophote_symbolic::Model;
use isophote_tracker as tracker;
pub use isophote_tracker::{
    Ahead, Ending, ExposureAdvice, Quality, Rejection, Sampled, Strength, Substitute, TrackState,
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::Named;
use crate::shadow::ShadowEstimate;

/// One estimate. Unknown fields are absent: no `session` and no `capture_ns` offline, no `truth` from a camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct EstimateView {
    /// Session that made the estimate.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub session: Option<String>,
    /// Node of the session, see [`SessionView::node`](crate::SessionView::node).
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub node: Option<String>,
    /// Epoch of the session; epoch, frame and target together are unique on the node.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub epoch: Option<u64>,
    /// Id of the target.
    pub target: String,
    /// The source's frame number.
    pub frame: u64,
    /// File of the frame.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub file: Option<String>,
    /// Capture time, CLOCK_MONOTONIC.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub capture_ns: Option<u64>,
    /// Capture time, nanoseconds since 1970 by the wall clock; only if the source reports when it captured the frame.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub capture_unix_ns: Option<u64>,
    /// Capture time on the source's own clock, s; velocities are per second of it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub time_s: Option<f64>,
    /// Time of publication to subscribers, CLOCK_MONOTONIC.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub publish_ns: Option<u64>,
    /// Frames lost to this subscriber since its last message: frame(n+1) − frame(n) = 1 + dropped(n+1).
    #[serde(default)]
    pub dropped: u64,
    /// `name@sha256:…` of the model.
    pub model: String,
    /// State of the target.
    pub state: TrackState,
    /// All parameters of the model, in document order.
    #[schema(value_type = BTreeMap<String, f64>)]
    pub parameters: Named,
    /// Free parameters of the last stage, in the order of `covariance`.
    pub order: Vec<String>,
    /// Covariance of the parameters in `order`, row by row, in their units.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub covariance: Option<Vec<Vec<f64>>>,
    /// Objective F, without a factor ½.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub objective: Option<f64>,
    /// Sum of r²/σ² (r² without `noise`), divided by pixels less free parameters.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub reduced_chi_square: Option<f64>,
    /// Measured noise of the pixels over the noise that the model states.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub noise_ratio: Option<f64>,
    /// ln L of the pixels of the fit.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub log_likelihood: Option<f64>,
    /// Probability that the fit is of the target, 0 … 1.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub confidence: Option<f64>,
    /// Number of pixels in the last pass.
    pub pixels: u64,
    /// Number of pixels of the domain that the camera's defect map excludes; absent without a map.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub left_out: Option<u64>,
    /// Share of saturated pixels in the domain, 0 … 1.
    pub saturated: f64,
    /// Iterations of each stage.
    pub iterations: Vec<u32>,
    /// Whether the last stage met its tolerance.
    pub converged: bool,
    /// How the last stage ended.
    pub ending: Ending,
    /// Reason why the fit was not accepted as the target, if so.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub rejection: Option<Rejection>,
    /// Shortcomings of the tracked fit.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub quality: Vec<Quality>,
    /// Fit that was not accepted as the target, if any.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub candidate: Option<CandidateView>,
    /// Number of points at which the full Hessian was indefinite, over all stages.
    #[serde(default)]
    pub indefinite_steps: u32,
    /// Background and brightness, if the model has a role for either.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub illumination: Option<Illumination>,
    /// Flux, width and axes while the target is tracked, if the model is one elliptical target with a brightness.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub photometry: Option<tracker::Photometry>,
    /// Pose of the target, if lens and target are known.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub pose: Option<tracker::Pose>,
    /// Advice on the best exposure.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub exposure_advice: Option<ExposureAdvice>,
    /// Predictions of the target, if the session requests them.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub predict: Vec<Ahead>,
    /// Substitute that was fitted because the model left too much unexplained.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub substitute: Option<Substitute>,
    /// Parameters at a bound of the document.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub at_bounds: Vec<String>,
    /// Sampling of the pixels, if the model leaves it open.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub sampled: Option<Sampled>,
    /// If nothing was found: the position most like the model's own image, and its strength.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub strongest: Option<Strength>,
    /// Vector width of the kernels, bits; only offline.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub vector_width: Option<usize>,
    /// True parameters of a rendered frame.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<BTreeMap<String, f64>>)]
    pub truth: Option<Named>,
    /// Times of the frame, µs.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub timing_us: Option<Timing>,
    /// Estimate of the session's shadow, in streams that request it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub shadow: Option<ShadowEstimate>,
    /// Points that the fit tried, at most the first 256, on request.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub trace: Vec<TraceView>,
}

/// A fit that was not accepted as the target.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CandidateView {
    /// All parameters of the model, in document order.
    #[schema(value_type = BTreeMap<String, f64>)]
    pub parameters: Named,
    /// Probability that the fit is of the target, 0 … 1, if known.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub confidence: Option<f64>,
    /// Shortcomings of the fit.
    pub quality: Vec<Quality>,
    /// Reason why the fit was not accepted.
    pub rejection: Rejection,
}

/// A point that a fit tried.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TraceView {
    /// Index of the stage, from 0.
    pub stage: usize,
    /// Index of the point in its stage; 0 is the start.
    pub pass: usize,
    /// Objective F at the point.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub objective: Option<f64>,
    /// Radius of the trust region; absent at a start, and for steps from a prediction.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub radius: Option<f64>,
    /// ρ: the decrease of F over the predicted decrease. Steps with at least 0.0001 are accepted.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub ratio: Option<f64>,
}

/// The points that a fit tried, if they were traced. Non-finite numbers are omitted.
pub fn trace(result: &tracker::Estimate) -> Vec<TraceView> {
    let view = |(stage, pass, point): (usize, usize, tracker::TracePoint)| TraceView {
        stage,
        pass,
        objective: Some(point.objective).filter(|value| value.is_finite()),
        radius: point.radius.filter(|value| value.is_finite()),
        ratio: point.ratio.filter(|value| value.is_finite()),
    };
    result.trace().map(view).collect()
}

/// Illumination by role, in pixel values.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Illumination {
    /// Parameter with the role `background`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub background: Option<f64>,
    /// Parameter with the role `brightness`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub brightness: Option<f64>,
}

/// Times of one frame, µs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Timing {
    /// Time from capture to the start of the fit, µs.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub wait: Option<i64>,
    /// Duration of the fit, µs.
    pub fit: u64,
}

impl EstimateView {
    /// Converts the tracker's result. `model_id` is `name@sha256:…`; the caller adds session, file, times, vector
    /// width and truth. Non-finite numbers are omitted.
    pub fn new(model: &Model, model_id: &str, frame: u64, result: &tracker::Estimate) -> EstimateView {
        let names = model.parameters();
        let roles = model.roles().first();
        let value = |id: Option<isophote_symbolic::ParameterId>| {
            id.and_then(|id| result.parameters.get(id.index()).copied()).filter(|v| v.is_finite())
        };
        let background = value(roles.and_then(|r| r.background));
        let brightness = value(roles.and_then(|r| r.brightness));
        let named = |parameters: &[f64]| -> Named {
            let pairs = names.iter().zip(parameters).filter(|(_, v)| v.is_finite());
            pairs.map(|(p, v)| (p.name.as_str(), *v)).collect()
        };
        let at_bounds = result.quality.iter().find_map(|quality| match quality {
            Quality::AtBound { parameters } => Some(parameters.clone()),
            _ => None,
        });
        let candidate = result.candidate.as_ref().map(|fit| CandidateView {
            parameters: named(&fit.parameters),
            confidence: fit.confidence.filter(|v| v.is_finite()),
            quality: fit.quality.clone(),
            rejection: fit.rejection,
        });
        EstimateView {
            session: None,
            node: None,
            epoch: None,
            target: result.target.clone(),
            frame,
            file: None,
            capture_ns: None,
            capture_unix_ns: None,
            time_s: None,
            publish_ns: None,
            dropped: 0,
            model: model_id.to_string(),
            state: result.state,
            parameters: named(&result.parameters),
            order: result.order.iter().map(|id| names[id.index()].name.clone()).collect(),
            covariance: result.covariance.clone().filter(|rows| rows.iter().flatten().all(|v| v.is_finite())),
            objective: result.objective.filter(|v| v.is_finite()),
            photometry: result.photometry,
            reduced_chi_square: result.reduced_chi_square.filter(|v| v.is_finite()),
            noise_ratio: result.noise_ratio.filter(|v| v.is_finite()),
            log_likelihood: result.log_likelihood,
            confidence: result.confidence.filter(|v| v.is_finite()),
            pixels: result.pixels,
            left_out: result.left_out,
            saturated: if result.saturated.is_finite() { result.saturated } else { 0.0 },
            iterations: result.iterations.clone(),
            converged: result.converged,
            ending: result.ending,
            rejection: result.rejection,
            quality: result.quality.clone(),
            candidate,
            indefinite_steps: result.indefinite_steps(),
            illumination: (background.is_some() || brightness.is_some())
                .then_some(Illumination { background, brightness }),
            pose: result.pose.clone(),
            exposure_advice: result.exposure_advice.clone(),
            predict: result.ahead.clone(),
            substitute: result.substitute,
            at_bounds: at_bounds.unwrap_or_default(),
            sampled: result.sampled,
            strongest: result.strongest.filter(|strongest| strongest.score.is_finite()),
            vector_width: None,
            truth: None,
            timing_us: None,
            shadow: None,
            trace: Vec::new(),
        }
    }
}

/// The id of a model in estimates: `name@sha256:…`.
pub fn model_id(name: &str, digest: &str) -> String {
    format!("{name}@{digest}")
}
