//! `Bench`: fits of one schedule from given starts, compared with an answer.

use std::sync::Arc;

use isophote_symbolic::ParameterId;

use super::starts::{self, Offset};
use crate::options::{TrackError, TrackerOptions};
use crate::solve::compiled::Compiled;
use crate::solve::fit::StartKind;
use crate::solve::stage_kernels::{CompileFailure, PixelHandling};
use crate::track::solver::{Attempt, FrameContext, Solver};
use crate::track::window::Margin;
use crate::track::{MARGIN_PX, MARGIN_PX_MAX, MARGIN_SHARE};
use isophote_frame::Frame;

/// A fit reached the answer when each parameter is within this many standard deviations.
const DEVIATIONS: f64 = 3.0;
/// A coordinate of a centre within this distance counts as reached too, px.
const CENTRE_PX: f64 = 0.1;

/// One schedule, ready to fit.
pub struct Bench {
    pub(super) solver: Solver,
}

/// The answer of a frame: where a fit should end.
#[derive(Clone, Debug)]
pub struct Goal {
    /// All parameters.
    pub parameters: Vec<f64>,
    /// Tolerance of each free parameter, by index.
    near: Vec<(usize, f64)>,
    pub(super) handling: PixelHandling,
}

/// Result of a fit from a start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Run {
    /// The fit was accepted and ended at the answer.
    pub reached: bool,
    /// Trial steps, over all stages.
    pub iterations: u32,
    /// Gradient passes, over all stages.
    pub passes: u32,
}

impl Goal {
    /// True when a fit that ended there found the answer: each parameter within three standard deviations, or a
    /// coordinate of a centre within a tenth of a pixel if that is more. False when nothing is free.
    pub fn is_near(&self, end: &[f64]) -> bool {
        let near = |(index, distance): &(usize, f64)| (end[*index] - self.parameters[*index]).abs() <= *distance;
        !self.near.is_empty() && self.near.iter().all(near)
    }
}

impl Bench {
    /// A schedule's kernels with the options of a session.
    ///
    /// # Errors
    /// When the options have unknown names or invalid values.
    pub fn new(compiled: Arc<Compiled>, options: TrackerOptions) -> Result<Bench, TrackError> {
        options.check(compiled.model())?;
        if options.precision != compiled.precision() {
            return Err(TrackError::Precision { wanted: options.precision, compiled: compiled.precision() });
        }
        Ok(Bench { solver: Solver::new(compiled, options) })
    }

    /// The answer of a frame: the end of this schedule from `start`, which is near it. `None` when the fit is not good,
    /// has no covariance, or the frame does not suit the model.
    ///
    /// # Errors
    /// When a kernel cannot be made.
    pub fn goal(&self, frame: &Frame, start: &[f64]) -> Result<Option<Goal>, CompileFailure> {
        let frame = self.solver.mended(frame);
        let Some(context) = self.solver.context(&frame) else { return Ok(None) };
        let attempt = self.attempt(&context, start, PixelHandling::All, 0.0)?;
        if !attempt.is_good() {
            return Ok(None);
        }
        let Some((fit, summary)) = attempt.fit.and_then(|fit| fit.summary.clone().map(|summary| (fit, summary))) else {
            return Ok(None);
        };
        let Some(covariance) = summary.covariance else { return Ok(None) };
        let centres: Vec<ParameterId> = self.solver.model().roles().iter().flat_map(|r| r.centre.clone()).collect();
        let free = self.solver.compiled.last_parameters();
        let near = free.iter().enumerate().map(|(row, parameter)| {
            let deviations = DEVIATIONS * covariance[(row, row)].sqrt();
            let is_centre = centres.contains(parameter);
            (parameter.index(), if is_centre { deviations.max(CENTRE_PX) } else { deviations })
        });
        let handling = if summary.saturated > 0.0 { PixelHandling::SkipSaturated } else { PixelHandling::All };
        Ok(Some(Goal { near: near.collect(), parameters: fit.parameters, handling }))
    }

    /// A point at distance `offset` from the answer in all parameters that the model's stages free; deterministic in `number`.
    pub fn start(&self, goal: &Goal, offset: Offset, number: u64) -> Vec<f64> {
        let model = self.solver.model();
        let varied = super::subsets(model).pop().map_or_else(Vec::new, |all| all.parameters);
        starts::start(model, &self.solver.constants, &goal.parameters, &varied, offset, number)
    }

    /// Fits from `start`, which is `offset` away.
    ///
    /// # Errors
    /// When a kernel cannot be made.
    pub fn run(&self, frame: &Frame, goal: &Goal, start: &[f64], offset: Offset) -> Result<Run, CompileFailure> {
        let frame = self.solver.mended(frame);
        let Some(context) = self.solver.context(&frame) else {
            return Ok(Run { reached: false, iterations: 0, passes: 0 });
        };
        let attempt = self.attempt(&context, start, goal.handling, offset.centre_px)?;
        let good = attempt.is_good();
        let fit = attempt.fit.as_ref();
        let stages = fit.map_or(&[][..], |fit| &fit.stages);
        Ok(Run {
            reached: good && fit.is_some_and(|fit| goal.is_near(&fit.parameters)),
            iterations: stages.iter().map(|stage| stage.iterations).sum(),
            passes: stages.iter().map(|stage| stage.passes).sum(),
        })
    }

    fn attempt(
        &self,
        context: &FrameContext,
        start: &[f64],
        handling: PixelHandling,
        doubt_px: f64,
    ) -> Result<Attempt, CompileFailure> {
        // As for a tracked target, with the start's uncertainty instead of the prediction's.
        let margin = Margin::even(MARGIN_SHARE, MARGIN_PX + doubt_px.min(MARGIN_PX_MAX));
        self.solver.attempt(context, start, StartKind::Anywhere, handling, margin)
    }
}
