//! Names of spots that look alike: which of them is which only the fit can tell, and a cold start may not have tried the right ones.
//!
//! What comes in: a cold fit of a pose. What goes out: the likeliest of that fit and of those with the spots named otherwise; or,
//! where several names explain the picture alike, none. It never knows earlier frames.
//!
//! Outlines of spots that are cut off, covered or dark say too little of a pose, so that starts with the right names may be missing
//! among those that were tried. A fit with the wrong ones shows: it leaves more unexplained than noise does, or a spot is dark.

use super::past::is_doubtful;
use super::solver::{Attempt, Look, Solver};
use super::window::Margin;
use crate::estimate::Rejection;
use crate::pose::{self, DELTA_CHI_SQUARE_MAX, Five, Geometry};
use crate::solve::fit::Begin;
use crate::solve::stage_kernels::{CompileFailure, Control};

/// The window of a fit is larger than the domain by this share, and by so many px.
const MARGIN: (f64, f64) = (0.1, 3.0);
/// Poses farther apart are two, rad.
const OTHER: f64 = 0.1;

impl Solver {
    /// Of a cold fit and those with other names the likeliest; not believed where one spot is dark and three poses or more suit.
    pub fn named(&self, look: &Look, attempt: Attempt, control: Control) -> Result<Attempt, CompileFailure> {
        let Some(geometry) = self.geometry.as_ref().filter(|geometry| geometry.target.spots.len() > 1) else {
            return Ok(attempt);
        };
        let Some(fit) = attempt.fit.as_ref().filter(|_| attempt.is_good() && look.unfinished().is_none()) else {
            return Ok(attempt);
        };
        let dark = self.dark_spots(geometry, fit);
        if dark.is_empty() && !(self.model().has_noise() && is_doubtful(fit)) {
            return Ok(attempt);
        }
        let mut tried = Vec::new();
        for start in self.named_otherwise(look, geometry, &fit.parameters, &dark) {
            tried.push(self.attempt(look, &start, Begin::Anywhere, control, Margin::even(MARGIN.0, MARGIN.1))?);
        }
        tried.retain(Attempt::is_good);
        let best = self.likeliest_pose(look, attempt, tried.clone())?;
        let others = if dark.is_empty() { 0 } else { self.as_likely(look, geometry, &best, &tried)? };
        Ok(if others > 1 { Attempt { rejection: Some(Rejection::Ending), ..best } } else { best })
    }

    /// Poses to begin with, in which the spots that are seen have other names.
    fn named_otherwise(&self, look: &Look, geometry: &Geometry, parameters: &[f64], dark: &[usize]) -> Vec<Vec<f64>> {
        let outlines = geometry.outlines(parameters).into_iter().enumerate();
        let seen: Vec<Five> = outlines.filter(|(spot, _)| !dark.contains(spot)).filter_map(|(_, seen)| seen).collect();
        let brightest = pose::brightest(self.model(), parameters);
        let start = |other: pose::PoseStart| {
            let mut start = parameters.to_vec();
            pose::lights(self.model()).for_each(|light| start[light] = brightest);
            geometry.put(&other.pose, &mut start);
            start
        };
        pose::namings(geometry, &seen, &|units| look.spend(units)).into_iter().map(start).collect()
    }

    /// How many other poses explain the picture as well as one does.
    fn as_likely(
        &self,
        look: &Look,
        geometry: &Geometry,
        best: &Attempt,
        tried: &[Attempt],
    ) -> Result<usize, CompileFailure> {
        let Some(fit) = &best.fit else { return Ok(0) };
        let view = self.view(look, look.window);
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
