//! Looking for a target near where it should be, when all that may be looked at cannot be searched now: a target that has moved
//! while others were searched for is found again at a fraction of the price.
//!
//! What comes in: a frame, and what is remembered of the target. What goes out: a candidate that may be it. It never knows why
//! there is no other search.

use super::candidate::Candidate;
use super::search::Search;
use super::solver::{Look, Solver};
use super::window::Margin;
use super::{Finding, MARGIN_DEVIATIONS, Track};
use crate::solve::stage_kernels::CompileFailure;

/// The window is larger than the domain around the prediction by so many px at least, and at most.
const MARGIN_PX: [f64; 2] = [24.0, 96.0];
/// What is larger than this share of all that may be looked at is not near.
const SHARE: usize = 2;

impl Track {
    /// What may be the target near where it should be; `None` where nothing is, where that is not known, and where it is about
    /// all that may be looked at. `avoided`: parameters of the other targets.
    pub fn nearby(
        &self,
        solver: &Solver,
        look: &Look,
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
        let window = solver.reach_window(&start, margin, look.window);
        let small = window.filter(|window| SHARE * window.pixels() <= look.window.pixels());
        let Some(near) = small.and_then(|window| look.narrowed(window)) else { return Ok(None) };
        let given = vec![None; start.len()];
        let size_px = self.memory.size_px(solver);
        let mut search = Search::run(solver, &near, &given, avoided.to_vec(), size_px)?;
        if near.unfinished().is_some() {
            return Ok(None);
        }
        Ok(match self.settle(solver, &near, None, &mut search, time_s) {
            Finding::Seen(candidate) => Some(candidate),
            Finding::Coasting(..) | Finding::Missing(..) => None,
        })
    }
}
