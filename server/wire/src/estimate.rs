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

/// What is not known is absent: no `session` and no `capture_ns` offline, no `truth` from a camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct EstimateView {
    /// The session that made it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub session: Option<String>,
    /// Where that runs, see [`SessionView::node`](crate::SessionView::node).
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub node: Option<String>,
    /// The start of the session that made it: no other estimate of the node has this epoch, this frame and this target.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub epoch: Option<u64>,
    /// The target's id.
    pub target: String,
    /// The source's frame number.
    pub frame: u64,
    /// The file the frame came from.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub file: Option<String>,
    /// When the frame was captured, CLOCK_MONOTONIC.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub capture_ns: Option<u64>,
    /// When the frame was captured, nanoseconds since 1970 by the wall clock; only where the camera says when that was.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub capture_unix_ns: Option<u64>,
    /// When the frame was taken, s on its source's own clock; velocities are per second of it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub time_s: Option<f64>,
    /// When the estimate was handed to subscribers, CLOCK_MONOTONIC.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub publish_ns: Option<u64>,
    /// Frames lost to this subscriber since its last message: frame(n+1) − frame(n) = 1 + dropped(n+1).
    #[serde(default)]
    pub dropped: u64,
    /// `name@sha256:…` of the model that made it.
    pub model: String,
    /// What is known of the target.
    pub state: TrackState,
    /// All parameters of the model, in document order.
    #[schema(value_type = BTreeMap<String, f64>)]
    pub parameters: Named,
    /// The free parameters of the last stage: the order of `covariance`.
    pub order: Vec<String>,
    /// Row-major, in the units of the parameters.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub covariance: Option<Vec<Vec<f64>>>,
    /// F, without a factor ½.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub objective: Option<f64>,
    /// The sum of r²/σ² (r² without noise) over pixels less free parameters.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub reduced_chi_square: Option<f64>,
    /// The noise of pixels over that which the model states, as frames show it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub noise_ratio: Option<f64>,
    /// ln L of the pixels that took part.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub log_likelihood: Option<f64>,
    /// The probability that the thing tracked is the target.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub confidence: Option<f64>,
    /// Pixels that took part in the last pass.
    pub pixels: u64,
    /// Pixels of the domain that the camera's map of defects left out, where it has one.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub left_out: Option<u64>,
    /// Share of the domain's pixels that are saturated, 0 … 1.
    pub saturated: f64,
    /// Iterations of each stage.
    pub iterations: Vec<u32>,
    /// Whether the last stage met its tolerance.
    pub converged: bool,
    /// How the last stage ended.
    pub ending: Ending,
    /// Why the fit is not taken for the target, when it is not.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub rejection: Option<Rejection>,
    /// Shortcomings of the tracked fit.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub quality: Vec<Quality>,
    /// The fit that is not taken for the target, when there is one.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub candidate: Option<CandidateView>,
    /// Points at which the full Hessian was indefinite, over all stages.
    #[serde(default)]
    pub indefinite_steps: u32,
    /// Background and brightness, when the model has a role for one of them.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub illumination: Option<Illumination>,
    /// Where the target is, when the lens and the target are known.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub pose: Option<tracker::Pose>,
    /// What exposure would be best.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub exposure_advice: Option<ExposureAdvice>,
    /// Where the target will be, when the session asks for it.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub predict: Vec<Ahead>,
    /// What was fitted in the model's place, when that left too much unexplained.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub substitute: Option<Substitute>,
    /// Parameters that a bound of the document holds back.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub at_bounds: Vec<String>,
    /// How pixels were sampled, when the model leaves that open.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub sampled: Option<Sampled>,
    /// Where nothing was found: the strongest thing that the model's own image is like.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub strongest: Option<Strength>,
    /// Bits of the vectors that its kernels are made for, where no session says so.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub vector_width: Option<usize>,
    /// What a synthetic source knows.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<BTreeMap<String, f64>>)]
    pub truth: Option<Named>,
    /// Where the time went.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub timing_us: Option<Timing>,
    /// What the session's shadow says of the frame, in a stream that asks for it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub shadow: Option<ShadowEstimate>,
    /// The points that the fit tried, the first 256, where that is asked for.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub trace: Vec<TraceView>,
}

/// A fit that is not taken for the target.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CandidateView {
    /// All parameters of the model, in document order.
    #[schema(value_type = BTreeMap<String, f64>)]
    pub parameters: Named,
    /// The probability that it is the target, where that can be told.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub confidence: Option<f64>,
    /// Its shortcomings.
    pub quality: Vec<Quality>,
    /// Why it is not taken.
    pub rejection: Rejection,
}

/// A point that a fit tried.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TraceView {
    /// The stage, counted from 0.
    pub stage: usize,
    /// The point, counted from 0, where the stage begins.
    pub pass: usize,
    /// F there.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub objective: Option<f64>,
    /// The trust region's radius; none at a start, and on the short way from a prediction.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub radius: Option<f64>,
    /// ρ: by how much F fell over what was promised. A step is taken from 0.0001 on.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub ratio: Option<f64>,
}

/// The points that a fit tried, where they were kept. Numbers that are not finite are absent.
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

/// The illumination by roles, in pixel values.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Illumination {
    /// The parameter with the role `background`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub background: Option<f64>,
    /// The parameter with the role `brightness`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub brightness: Option<f64>,
}

/// Microseconds that one frame took.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Timing {
    /// From capture to the start of the fit.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub wait: Option<i64>,
    /// The fit.
    pub fit: u64,
}

impl EstimateView {
    /// The tracker's result in the wire's form. `model_id` is `name@sha256:…`; the caller adds what only it knows
    /// (session, file, times, vectors, truth). Numbers that are not finite are absent.
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

/// The id by which estimates name a model: `name@sha256:…`.
pub fn model_id(name: &str, digest: &str) -> String {
    format!("{name}@{digest}")
}
