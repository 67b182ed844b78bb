//! Names of spots that look alike: only a fit can tell which is which, and a cold start may not have tried the right
//! names. Refits a cold fit of a pose with other names and keeps the likeliest; a dark spot with several equally likely
//! poses rejects the fit.
//!
//! Outlines of spots that are cut off, covered or dark constrain a pose too weakly, so that starts with the right names
//! may be missing. A fit with wrong names shows: it leaves more unexplained than noise does, or a spot is dark.

use super::pose_history::is_doubtful;
use super::solver::{Attempt, FrameContext, Solver};
use super::window::Margin;
use crate::estimate::Rejection;
use crate::pose::{self, DELTA_CHI_SQUARE_MAX, Five, Geometry};
use crate::solve::fit::StartKind;
use crate::solve::stage_kernels::{CompileFailure, PixelHandling};

/// Margin of a fit's window: share of the domain, and px.
const MARGIN: (f64, f64) = (0.1, 3.0);
/// Poses farther apart are different poses, rad.
const OTHER: f64 = 0.1;

impl Solver {
    /// The likeliest of a cold fit and of the fits with other names; rejected where a spot is dark and three or more
    /// poses fit alike.
    pub fn named(
        &self,
        context: &FrameContext,
        attempt: Attempt,
        handling: PixelHandling,
    ) -> Result<Attempt, CompileFailure> {
        let Some(geometry) = self.geometry.as_ref().filter(|geometry| geometry.target.spots.len() > 1) else {
            return Ok(attempt);
        };
        let Some(fit) = attempt.fit.as_ref().filter(|_| attempt.is_good() && context.unfinished().is_none()) else {
            return Ok(attempt);
        };
        let dark = self.dark_spots(geometry, fit);
        if dark.is_empty() && !(self.model().has_noise() && is_doubtful(fit)) {
            return Ok(attempt);
        }
        let mut tried = Vec::new();
        for start in self.named_otherwise(context, geometry, &fit.parameters, &dark) {
            tried.push(self.attempt(
                context,
                &start,
                StartKind::Anywhere,
                handling,
                Margin::even(MARGIN.0, MARGIN.1),
            )?);
        }
        tried.retain(Attempt::is_good);
        let best = self.likeliest_pose(context, attempt, tried.clone())?;
        let others = if dark.is_empty() { 0 } else { self.as_likely(context, geometry, &best, &tried)? };
        Ok(if others > 1 { Attempt { rejection: Some(Rejection::Ending), ..best } } else { best })
    }

    /// Start parameters in which the spots that shine have other names.
    fn named_otherwise(
        &self,
        context: &FrameContext,
        geometry: &Geometry,
        parameters: &[f64],
        dark: &[usize],
    ) -> Vec<Vec<f64>> {
        let outlines = geometry.outlines(parameters).into_iter().enumerate();
        let seen: Vec<Five> = outlines.filter(|(spot, _)| !dark.contains(spot)).filter_map(|(_, seen)| seen).collect();
        let brightest = pose::brightest(self.model(), parameters);
        let start = |other: pose::PoseStart| {
            let mut start = parameters.to_vec();
            pose::lights(self.model()).for_each(|light| start[light] = brightest);
            geometry.put(&other.pose, &mut start);
            start
        };
        pose::namings(geometry, &seen, &|units| context.spend(units)).into_iter().map(start).collect()
    }

    /// Counts the other poses that explain the picture as well as `best`.
    fn as_likely(
        &self,
        context: &FrameContext,
        geometry: &Geometry,
        best: &Attempt,
        tried: &[Attempt],
    ) -> Result<usize, CompileFailure> {
        let Some(fit) = &best.fit else { return Ok(0) };
        let view = self.view(context, context.window);
        let mut poses = vec![&fit.parameters];
        for other in tried {
            let Some(parameters) = other.fit.as_ref().map(|fit| &fit.parameters) else { continue };
            let is_new = poses.iter().all(|pose| geometry.apart(pose, parameters) > OTHER);
            let delta = if is_new { self.delta(&view, geometry, best, other)? } else { None };
            if delta.is_some_and(|delta| delta < DELTA_CHI_SQUARE_MAX) {
                poses.push(parameters);
            }
        }
        Ok(poses.len() - 1)
    }
}
