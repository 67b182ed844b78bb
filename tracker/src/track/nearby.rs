//! Searches for a target near its expected position when the whole window cannot be searched now: a target that moved
//! while others were searched for is found again at a fraction of the cost.

use super::candidate::Candidate;
use super::search::Search;
use super::solver::{FrameContext, Solver};
use super::window::Margin;
use super::{Finding, MARGIN_DEVIATIONS, Track};
use crate::solve::stage_kernels::CompileFailure;

/// Least and largest margin around the domain at the prediction, px.
const MARGIN_PX: [f64; 2] = [24.0, 96.0];
/// The whole window has at least this many times the pixels of the nearby one.
const SHARE: usize = 2;

impl Track {
    /// A candidate near the expected position; `None` where there is none, where the position is unknown, and where the
    /// nearby window exceeds half of the whole one. `avoided`: parameters of the other targets.
    pub fn nearby(
        &self,
        solver: &Solver,
        context: &FrameContext,
        avoided: &[Vec<f64>],
        time_s: f64,
    ) -> Result<Option<Box<Candidate>>, CompileFailure> {
        let predicted = self.memory.predicted(time_s);
        let Some(start) = self.memory.start(solver, predicted.as_ref()) else { return Ok(None) };
        let [least, most] = MARGIN_PX;
        let mut margin = Margin::even(0.0, least);
        if let Some(predicted) = predicted {
            for (axis, px) in margin.px.iter_mut().enumerate().take(solver.model().coordinates().len()) {
                *px = (MARGIN_DEVIATIONS * predicted.deviation(axis)).clamp(least, most);
            }
        }
        let window = solver.reach_window(&start, margin, context.window);
        let small = window.filter(|window| SHARE * window.pixels() <= context.window.pixels());
        let Some(near) = small.and_then(|window| context.narrowed(window)) else { return Ok(None) };
        let given = vec![None; start.len()];
        let size_px = self.memory.size_px(solver);
        let mut search = Search::run(solver, &near, &given, avoided.to_vec(), size_px)?;
        if near.unfinished().is_some() {
            return Ok(None);
        }
        Ok(match self.decide(solver, &near, None, &mut search, time_s) {
            Finding::Seen(candidate) => Some(candidate),
            Finding::Coasting(..) | Finding::Missing(..) => None,
        })
    }
}
