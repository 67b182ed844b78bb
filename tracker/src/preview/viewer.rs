//! `Viewer`: previews of the frames of one session and model. `FrameScene`: one frame with its estimates.

use std::sync::{Arc, OnceLock};

use isophote_frame::Frame;
use isophote_jit::{PlaneView, Slices, Window};
use isophote_symbolic::Model;

use super::predicted::{PredictedPlanes, PredictedValue};
use crate::estimate::{Estimate, TrackState};
use crate::options::TrackerOptions;
use crate::pose::Pose;
use crate::sight::gaps::overlap;
use crate::sight::grey::Grey;
use crate::solve::compiled::Compiled;
use crate::track::solver::{FrameContext, Solver};
use crate::track::window::Margin;
use crate::track::{MARGIN_PX, MARGIN_SHARE};

/// Standard deviation over the median magnitude of a normal distribution.
const NORMAL: f64 = 1.4826;

/// Renders previews for a tracker's model and options. Cheap to make by [`Tracker::viewer`](crate::Tracker::viewer):
/// the first viewer to need an expensive part builds it, on its own thread.
pub struct Viewer {
    compiled: Arc<Compiled>,
    options: TrackerOptions,
    solver: OnceLock<Solver>,
    predicted: OnceLock<PredictedPlanes>,
}

/// One frame with the data of its preview.
pub struct FrameScene<'a> {
    pub(super) viewer: &'a Viewer,
    /// The frame as fitted: defects mended, and one plane where the model has one channel.
    pub(super) fitted: Frame,
    /// The frame as shown: unmended, colours as luma.
    pub(super) grey: Frame,
    /// The original frame.
    pub(super) frame: Frame,
    /// z, w.
    pub(super) slice: [usize; 2],
    /// Found or predicted targets.
    pub(super) targets: Vec<SeenTarget>,
    /// Window of all targets, in the slice shown; else the session's window, if it has one.
    pub(super) window: Option<Window>,
    /// Clipping value of each channel of the model.
    pub(super) limits: Vec<f64>,
}

/// A found or predicted target.
pub(super) struct SeenTarget {
    pub parameters: Vec<f64>,
    /// In the slice shown.
    pub window: Window,
    pub pose: Option<Pose>,
    /// The standard deviation of pixels when the model does not state it: √(χ²/ν).
    deviation: Option<f64>,
}

/// Residuals of a target in its window.
pub(super) struct Unexplained {
    /// Observed − intensity, in σ; NaN outside the domain, and for pixels without a value.
    pub residuals: Vec<f32>,
    pub observed: Vec<f64>,
    /// NaN outside of the domain.
    pub intensity: Vec<f32>,
    pub deviation: Vec<f32>,
    /// Observed values are clipped from here on.
    pub limit: f64,
}

impl Viewer {
    pub(crate) fn new(compiled: Arc<Compiled>, options: TrackerOptions) -> Viewer {
        Viewer { compiled, options, solver: OnceLock::new(), predicted: OnceLock::new() }
    }

    pub(super) fn model(&self) -> &Model {
        self.compiled.model()
    }

    pub(super) fn solver(&self) -> &Solver {
        self.solver.get_or_init(|| Solver::new(self.compiled.clone(), self.options.clone()))
    }

    /// Predictions of pixels; compiled on first use.
    pub(super) fn predicted(&self) -> &PredictedPlanes {
        self.predicted.get_or_init(|| PredictedPlanes::new(self.model(), &self.solver().constants))
    }

    /// A frame with its estimates by the tracker that made this viewer. Any other frame can be shown as well, then
    /// without an overlay.
    pub fn scene(&self, frame: &Frame, estimates: &[Estimate]) -> FrameScene<'_> {
        let solver = self.solver();
        let mended = solver.mended(frame);
        let is_luma = self.model().channels().len() == 1 && frame.planes().len() == 3;
        let fitted = if is_luma { mended.luma() } else { mended.into_owned() };
        let grey = if is_luma && frame.names().is_none() { fitted.clone() } else { frame.luma() };
        let known = self.model().parameters().len();
        let is_seen = |one: &&Estimate| {
            matches!(one.state, TrackState::Tracking | TrackState::Coasting) && one.parameters.len() == known
        };
        let seen: Vec<&Estimate> = estimates.iter().filter(is_seen).collect();
        let mut scene = FrameScene {
            viewer: self,
            slice: middle(frame),
            grey,
            frame: frame.clone(),
            fitted: fitted.clone(),
            targets: Vec::new(),
            window: None,
            limits: Vec::new(),
        };
        if let Some(context) = solver.context(&fitted) {
            scene.slice = self.slice(&context, seen.first().copied(), scene.slice);
            scene.targets = seen.iter().filter_map(|one| self.target(&context, one, scene.slice)).collect();
            let given = solver.options.window.and_then(|_| in_slice(context.window, scene.slice));
            let all = scene.targets.iter().map(|target| target.window).reduce(hull);
            scene.window = all.or(given);
            scene.limits = solver.view(&context, scene.window.unwrap_or(context.window)).saturation.to_vec();
        }
        scene
    }

    /// The slice through the first target's centre; the middle one without a centre or a target.
    fn slice(&self, context: &FrameContext, first: Option<&Estimate>, middle: [usize; 2]) -> [usize; 2] {
        let centre = self.model().roles().first().map(|roles| &roles.centre[..]).unwrap_or_default();
        std::array::from_fn(|axis| {
            let value = first.zip(centre.get(axis + 2)).map(|(one, id)| one.parameters[id.index()].round());
            let (first_edge, count) = (context.window.slices.first[axis], context.window.slices.count[axis]);
            value.map_or(middle[axis], |value| value.max(0.0) as usize).clamp(first_edge, first_edge + count - 1)
        })
    }

    fn target(&self, context: &FrameContext, estimate: &Estimate, slice: [usize; 2]) -> Option<SeenTarget> {
        let (solver, parameters) = (self.solver(), &estimate.parameters);
        let window = match &solver.geometry {
            Some(geometry) => {
                let windows = geometry.windows(self.model(), parameters, &solver.constants, context.window);
                windows.into_iter().reduce(hull)?
            }
            None => solver.window(context, parameters, Margin::even(MARGIN_SHARE, MARGIN_PX)),
        };
        let deviation = estimate.reduced_chi_square.filter(|_| !self.model().has_noise()).map(f64::sqrt);
        let (pose, parameters) = (estimate.pose.clone(), parameters.clone());
        Some(SeenTarget { parameters, window: in_slice(window, slice)?, pose, deviation })
    }
}

impl FrameScene<'_> {
    /// The frame's planes that the model reads; `None` when it lacks any.
    pub(super) fn planes(&self) -> Option<Vec<PlaneView<'_>>> {
        let planes = self.fitted.planes_of(self.viewer.model().channels())?;
        Some(planes.into_iter().map(|plane| self.fitted.plane_view(plane)).collect())
    }

    /// Residuals of one target in a part of its window, for each observed value.
    pub(super) fn unexplained(&self, target: &SeenTarget, window: Window) -> Vec<Unexplained> {
        let Some(planes) = self.planes().filter(|planes| planes.len() == self.limits.len()) else { return Vec::new() };
        let gaps = self.viewer.solver().gaps.as_ref().map(|gaps| gaps.inside(window)).unwrap_or_default();
        let one = |PredictedValue { mixture, intensity, deviation }: PredictedValue<'_>| {
            let mut grey = Grey::read_with_nan(&planes, window, &self.limits, mixture);
            grey.blank(window, &gaps);
            let limit = grey.saturation;
            let difference = |(value, predicted): (&f64, &f32)| {
                let difference = value.min(limit) - f64::from(*predicted);
                // A clipped pixel is at least as bright as the limit.
                if *value >= limit && difference < 0.0 { 0.0 } else { difference }
            };
            let differences: Vec<f64> = grey.values.iter().zip(&intensity).map(difference).collect();
            let deviation = deviation.unwrap_or_else(|| {
                let stated = target.deviation.or_else(|| spread(&differences)).unwrap_or(1.0);
                vec![stated as f32; differences.len()]
            });
            let whitened = differences.iter().zip(&deviation).map(|(d, sigma)| (d / f64::from(*sigma)) as f32);
            Unexplained { residuals: whitened.collect(), observed: grey.values, intensity, deviation, limit }
        };
        self.viewer.predicted().of(&target.parameters, window).into_iter().map(one).collect()
    }
}

/// A robust standard deviation; `None` without finite values, or without spread.
fn spread(values: &[f64]) -> Option<f64> {
    let mut known: Vec<f64> = values.iter().filter(|value| value.is_finite()).map(|value| value.abs()).collect();
    if known.is_empty() {
        return None;
    }
    let middle = known.len() / 2;
    Some(NORMAL * *known.select_nth_unstable_by(middle, f64::total_cmp).1).filter(|spread| *spread > 0.0)
}

/// z, w of the middle slice.
fn middle(frame: &Frame) -> [usize; 2] {
    let [_, _, depth, length] = frame.sides();
    [(depth - 1) / 2, (length - 1) / 2]
}

/// The part of a window in one slice.
fn in_slice(window: Window, slice: [usize; 2]) -> Option<Window> {
    overlap(window, Window { slices: Slices { first: slice, count: [1, 1] }, ..window })
}

/// The bounding window of two windows of one slice.
fn hull(a: Window, b: Window) -> Window {
    let (x, y) = (a.x.min(b.x), a.y.min(b.y));
    let (right, bottom) = ((a.x + a.width).max(b.x + b.width), (a.y + a.height).max(b.y + b.height));
    Window { x, y, width: right - x, height: bottom - y, slices: a.slices }
}
