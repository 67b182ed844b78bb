//! `Bench`: fits of one schedule from stated starts, held against an answer.

use std::sync::Arc;

use isophote_symbolic::ParameterId;

use super::starts::{self, Offset};
use crate::options::{TrackError, TrackerOptions};
use crate::solve::compiled::Compiled;
use crate::solve::fit::Begin;
use crate::solve::stage_kernels::{CompileFailure, Control};
use crate::track::solver::{Attempt, Look, Solver};
use crate::track::window::Margin;
use crate::track::{MARGIN_PX, MARGIN_PX_MAX, MARGIN_SHARE};
use isophote_frame::Frame;

/// An end within so many standard deviations of the answer is the answer, …
const DEVIATIONS: f64 = 3.0;
/// … and so is a coordinate of a centre within this, px.
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
    /// How far from it a parameter may end, by the parameter's index; what was not free is not here.
    near: Vec<(usize, f64)>,
    pub(super) control: Control,
}

/// How a fit from a start went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Run {
    /// It is believed and ended at the answer.
    pub reached: bool,
    /// Steps tried, over all stages.
    pub iterations: u32,
    /// Gradient passes, over all stages.
    pub passes: u32,
}

impl Goal {
    /// True when a fit that ended there found the answer: each parameter within three standard deviations, a coordinate of
    /// a centre within a tenth of a pixel if that is more. Where nothing is free it cannot be found.
    pub fn is_near(&self, end: &[f64]) -> bool {
        let near = |(index, distance): &(usize, f64)| (end[*index] - self.parameters[*index]).abs() <= *distance;
        !self.near.is_empty() && self.near.iter().all(near)
    }
}

impl Bench {
    /// A schedule's kernels with the options of a session.
    ///
    /// # Errors
    /// When the options name what the model does not have, or what cannot be.
    pub fn new(compiled: Arc<Compiled>, options: TrackerOptions) -> Result<Bench, TrackError> {
        options.check(compiled.model())?;
        if options.precision != compiled.precision() {
            return Err(TrackError::Precision { wanted: options.precision, compiled: compiled.precision() });
        }
        Ok(Bench { solver: Solver::new(compiled, options) })
    }

    /// The answer of a frame: where this schedule ends from `start`, which is near it. `None` when that is no good fit, or
    /// one without a covariance, or when the frame does not suit the model.
    ///
    /// # Errors
    /// When a kernel cannot be made.
    pub fn goal(&self, frame: &Frame, start: &[f64]) -> Result<Option<Goal>, CompileFailure> {
        let frame = self.solver.mended(frame);
        let Some(look) = self.solver.look(&frame) else { return Ok(None) };
        let attempt = self.attempt(&look, start, Control::Plain, 0.0)?;
        if !attempt.is_good() {
            return Ok(None);
        }
        let Some((fit, worth)) = attempt.fit.and_then(|fit| fit.worth.clone().map(|worth| (fit, worth))) else {
            return Ok(None);
        };
        let Some(covariance) = worth.covariance else { return Ok(None) };
        let centres: Vec<ParameterId> = self.solver.model().roles().iter().flat_map(|r| r.centre.clone()).collect();
        let free = self.solver.compiled.last_parameters();
        let near = free.iter().enumerate().map(|(row, parameter)| {
            let deviations = DEVIATIONS * covariance[(row, row)].sqrt();
            let is_centre = centres.contains(parameter);
            (parameter.index(), if is_centre { deviations.max(CENTRE_PX) } else { deviations })
        });
        let control = if worth.saturated > 0.0 { Control::Dropping } else { Control::Plain };
        Ok(Some(Goal { near: near.collect(), parameters: fit.parameters, control }))
    }

    /// A point at that distance from the answer in all parameters that the model's stages free; the same for the same
    /// number.
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
        let Some(look) = self.solver.look(&frame) else {
            return Ok(Run { reached: false, iterations: 0, passes: 0 });
        };
        let attempt = self.attempt(&look, start, goal.control, offset.centre_px)?;
        let good = attempt.is_good();
        let fit = attempt.fit.as_ref();
        let stages = fit.map_or(&[][..], |fit| &fit.stages);
        Ok(Run {
            reached: good && fit.is_some_and(|fit| goal.is_near(&fit.parameters)),
            iterations: stages.iter().map(|stage| stage.iterations).sum(),
            passes: stages.iter().map(|stage| stage.passes).sum(),
        })
    }

    fn attempt(&self, look: &Look, start: &[f64], control: Control, doubt_px: f64) -> Result<Attempt, CompileFailure> {
        // As for a target that is followed, with the start's own doubt in the place of the prediction's.
        let margin = Margin::even(MARGIN_SHARE, MARGIN_PX + doubt_px.min(MARGIN_PX_MAX));
        self.solver.attempt(look, start, Begin::Anywhere, control, margin)
    }
}
