//! Alternative branches of a pose fit: fits from mirrored poses where it may have ended on the wrong side, and fits without hidden
//! pixels where its residuals are too large. The likeliest is accepted, or all are rejected. [`super::naming`] tells alike spots
//! apart.
//!
//! ```text
//! fit ─► may be mirrored? ─► fits from mirrored poses ─► residuals too large? ─► fit without hidden pixels ─► accepted?
//! ```

use super::memory::Memory;
use super::pose_history::{PoseHistory, TURNED_LEAST};
use super::solver::{Attempt, FrameContext, Solver};
use super::window::Margin;
use crate::estimate::{Ending, Rejection};
use crate::pose::Geometry;
use crate::solve::backgrounds::MISFIT;
use crate::solve::fit::{Fit, StartKind};
use crate::solve::occlusion::{OcclusionFit, SpotNames};
use crate::solve::residuals::Over;
use crate::solve::stage_kernels::{CompileFailure, PixelHandling};

/// Largest share of a target's light that a document without earlier fits may leave unexplained, beyond the noise: a mirrored tilt
/// and a covered spot leave more.
const UNEXPLAINED: f64 = 0.02;
/// Mirrored poses are tried again when the angle to them has grown by this factor.
const GROWN: f64 = 1.5;
/// Smallest such angle, rad: with less tilt both poses look alike.
const FLAT: f64 = 0.03;
/// The target may be at the mirrored pose when that one is closer to the last pose than this times the angle it turned by.
const TURNED: f64 = 2.0;
/// A turn between frames by more than this may exchange the names of spots, rad.
const RENAMED: f64 = 0.5;
/// Margin of a fit's window around the domain: a share of it, and px.
const MARGIN: (f64, f64) = (0.1, 3.0);
/// Most rounds of mirrored poses, each from the winner of the round before.
const ROUNDS: usize = 2;

impl Solver {
    /// The accepted branch of a fit around a prediction.
    pub fn branched(
        &self,
        context: &FrameContext,
        mut attempt: Attempt,
        start: &[f64],
        memory: &Memory,
        handling: PixelHandling,
    ) -> Result<Attempt, CompileFailure> {
        let Some(geometry) = &self.geometry else { return Ok(attempt) };
        let (pose_history, turned) = (&memory.pose_history, memory.pose_history.turned().cloned());
        if !self.is_usual(&attempt, pose_history) || self.is_other_side(geometry, &attempt, memory) {
            let others = geometry.mirrored(start).into_iter().take(1).chain(turned.clone());
            attempt = self.against_mirrored(context, attempt, others.collect(), handling)?;
        }
        let starts: Vec<Vec<f64>> = std::iter::once(start.to_vec()).chain(turned).collect();
        self.without_hidden_pixels(context, attempt, &starts, pose_history)
    }

    /// The accepted branch of a cold fit.
    pub fn branched_cold(
        &self,
        context: &FrameContext,
        attempt: Attempt,
        handling: PixelHandling,
    ) -> Result<Attempt, CompileFailure> {
        if self.geometry.is_none() {
            return Ok(attempt);
        }
        let attempt = self.against_mirrored(context, attempt, Vec::new(), handling)?;
        let attempt = self.named(context, attempt, handling)?;
        let attempt = self.without_hidden_pixels(context, attempt, &[], &PoseHistory::default())?;
        let is_wrong = self.has_false_spot(context, &attempt);
        Ok(if is_wrong { Attempt { rejection: Some(Rejection::Misfit), ..attempt } } else { attempt })
    }

    /// True for a good fit whose χ²/ν is usual for the document.
    fn is_usual(&self, attempt: &Attempt, pose_history: &PoseHistory) -> bool {
        let Some(fit) = attempt.fit.as_ref().filter(|_| attempt.is_good()) else { return false };
        !self.model().has_noise()
            || attempt.reduced_chi_square().is_none_or(|reduced| reduced <= pose_history.limit(fit))
    }

    /// Whether the mirrored pose may be the true one and has to be tried again.
    fn is_other_side(&self, geometry: &Geometry, attempt: &Attempt, memory: &Memory) -> bool {
        let Some(fit) = &attempt.fit else { return false };
        let here = geometry.to_mirrored(&fit.parameters);
        if here < FLAT {
            return false;
        }
        let grown =
            memory.rival.is_none() && memory.pose_history.tried.is_none_or(|tried| here > GROWN * tried.max(FLAT));
        let last = memory.last_start().unwrap_or_else(|| fit.parameters.clone());
        // A target that turned and seems to have stopped may be at the mirrored pose, still turning.
        let before = memory.pose_history.step.map_or(0.0, |step| step.norm());
        let turned = geometry.apart(&last, &fit.parameters).max(before);
        let mut others = geometry.mirrored(&fit.parameters).into_iter();
        let other = others.next().map_or(f64::INFINITY, |other| geometry.apart(&last, &other));
        grown || (turned > TURNED_LEAST && other < TURNED * turned)
    }

    /// The likeliest of a fit, fits from `others`, and fits from mirrored poses, repeated while the pose changes.
    fn against_mirrored(
        &self,
        context: &FrameContext,
        mut best: Attempt,
        mut others: Vec<Vec<f64>>,
        handling: PixelHandling,
    ) -> Result<Attempt, CompileFailure> {
        let Some(geometry) = &self.geometry else { return Ok(best) };
        let margin = Margin::even(MARGIN.0, MARGIN.1);
        for _ in 0..ROUNDS {
            let Some(before) = best.fit.as_ref().map(|fit| fit.parameters.clone()) else { return Ok(best) };
            if context.unfinished().is_some() || !before.iter().all(|value| value.is_finite()) {
                return Ok(best);
            }
            let facing = geometry.facing(&before);
            let is_behind = facing.is_some();
            others.extend(geometry.mirrored(facing.as_ref().unwrap_or(&before)));
            others.extend(facing);
            let mut tried = Vec::new();
            for start in others.drain(..) {
                tried.push(self.attempt(context, &start, StartKind::Anywhere, handling, margin)?);
            }
            if (!best.is_good() || is_behind)
                && let Some(good) = tried.iter().position(Attempt::is_good)
            {
                best = tried.swap_remove(good);
            }
            best = self.likeliest_pose(context, best, tried)?;
            if best.fit.as_ref().is_none_or(|fit| geometry.apart(&before, &fit.parameters) < FLAT) {
                break;
            }
        }
        best.is_other_tried = context.unfinished().is_none();
        Ok(best)
    }

    /// The attempt if its χ²/ν is usual, else a fit without hidden pixels, else the attempt, possibly rejected.
    fn without_hidden_pixels(
        &self,
        context: &FrameContext,
        attempt: Attempt,
        starts: &[Vec<f64>],
        pose_history: &PoseHistory,
    ) -> Result<Attempt, CompileFailure> {
        let Some(geometry) = &self.geometry else { return Ok(attempt) };
        if attempt.ending == Ending::Budget {
            return Ok(self.judged(attempt, pose_history));
        }
        if self.is_usual(&attempt, pose_history) || !self.model().has_noise() || context.unfinished().is_some() {
            return Ok(attempt);
        }
        let view = self.view(context, context.window);
        let is_ready = self.may_be_robust(context, &view);
        let Some(predictions) = is_ready.then(|| self.compiled.predictions()).flatten() else {
            return Ok(self.judged(attempt, pose_history));
        };
        let ends = attempt.fit.iter().map(|fit| fit.parameters.clone());
        let names = if starts.is_empty() { SpotNames::Guessed } else { SpotNames::Known };
        let occlusion = OcclusionFit {
            kernels: &self.compiled,
            predictions,
            view: &view,
            constants: &self.constants,
            geometry,
            names,
        };
        let starts: Vec<Vec<f64>> = starts.iter().cloned().chain(ends).collect();
        let found = occlusion.best_fit(&starts);
        let found = found.inspect_err(|_| self.compiled.prepared_backgrounds().mark_failed()).ok().flatten();
        let clear = found.map(|fit| {
            let rejection = self.rejection(&fit, &view, context.window);
            Attempt::of(fit, rejection)
        });
        // The remaining pixels must fit as well as all did before.
        match clear.filter(|clear| self.is_usual(clear, pose_history)) {
            Some(clear) => Ok(clear),
            None => Ok(self.judged(attempt, pose_history)),
        }
    }

    /// The attempt, rejected where its χ²/ν is too large for the document.
    fn judged(&self, attempt: Attempt, pose_history: &PoseHistory) -> Attempt {
        let Some(reduced) = attempt.reduced_chi_square().filter(|_| attempt.is_good() && self.model().has_noise())
        else {
            return attempt;
        };
        let most = match pose_history.usual {
            Some(usual) if usual <= MISFIT => MISFIT * usual.max(1.0),
            usual => (1.0 + UNEXPLAINED * self.light(&attempt)).max(usual.map_or(0.0, |usual| MISFIT * usual)),
        };
        match reduced <= most {
            true => attempt,
            false => Attempt { rejection: Some(Rejection::Misfit), ..attempt },
        }
    }

    /// True when a spot leaves a larger share of its own light unexplained than a document may: it is another object.
    fn has_false_spot(&self, context: &FrameContext, attempt: &Attempt) -> bool {
        let Some(geometry) = self.geometry.as_ref().filter(|geometry| geometry.target.spots.len() > 1) else {
            return false;
        };
        let is_doubtful = attempt.is_good() && attempt.reduced_chi_square().is_some_and(|reduced| reduced > MISFIT);
        let Some(fit) = attempt.fit.as_ref().filter(|fit| is_doubtful && fit.choice.is_none()) else { return false };
        let view = self.view(context, self.window(context, &fit.parameters, Margin::NONE));
        let seen = self
            .compiled
            .predictions()
            .and_then(|predictions| predictions.residuals(&view, &fit.parameters, &self.constants, Over::Domain));
        let Some(seen) = seen else { return false };
        let mut spot_of = vec![None; view.window.pixels()];
        for (pixel, spot) in geometry.nearest(&fit.parameters, view.window, 1.0) {
            spot_of[pixel] = Some(spot);
        }
        let mut excess = vec![0.0; geometry.target.spots.len()];
        for residual in seen.iter().flat_map(|seen| &seen.residuals) {
            spot_of[residual.pixel].into_iter().for_each(|spot: usize| excess[spot] += residual.whitened.powi(2) - 1.0);
        }
        excess.into_iter().enumerate().any(|(spot, excess)| {
            let roles = geometry.roles(self.model(), spot);
            roles.and_then(|roles| self.light_of(fit, roles)).is_some_and(|light| excess > UNEXPLAINED * light)
        })
    }

    /// The increase of χ²/ν without the target's light.
    fn light(&self, attempt: &Attempt) -> f64 {
        let Some((fit, summary)) = attempt.fit.as_ref().and_then(|fit| Some((fit, fit.summary.as_ref()?))) else {
            return 0.0;
        };
        let lights = self.model().roles().iter().filter_map(|roles| self.light_of(fit, roles));
        lights.sum::<f64>() / summary.pixels.max(1) as f64
    }

    /// The increase of χ² without one spot's light.
    fn light_of(&self, fit: &Fit, roles: &isophote_symbolic::Roles) -> Option<f64> {
        let brightness = roles.brightness?;
        let row = self.compiled.last_parameters().iter().position(|&parameter| parameter == brightness)?;
        let square = fit.parameters[brightness.index()].powi(2) / fit.summary.as_ref()?.variance_alone[row];
        Some(square).filter(|square| square.is_finite())
    }

    /// True for a pose from a part of the pixels: it is not accepted far from the expected one.
    pub fn is_occluded_pose(&self, attempt: &Attempt) -> bool {
        self.fits_pose() && attempt.choice().is_some()
    }

    /// True for a pose with hidden or dark spots that turned so far that the spots may have exchanged names.
    pub fn is_renamed(&self, attempt: &Attempt, memory: &Memory) -> bool {
        let Some((geometry, last)) = self.geometry.as_ref().zip(memory.last_start()) else { return false };
        let Some(fit) = attempt.fit.as_ref().filter(|_| geometry.target.spots.len() > 1) else { return false };
        let is_turned = |from: &Vec<f64>| geometry.apart(from, &fit.parameters) > RENAMED;
        let is_whole = fit.choice.is_none() && self.dark_spots(geometry, fit).is_empty();
        !is_whole && is_turned(&last) && memory.pose_history.turned().is_none_or(is_turned)
    }

    /// True for a fit of a search that is acceptable for the document; always for models without a pose.
    pub fn is_believed(&self, attempt: &Attempt, pose_history: &PoseHistory) -> bool {
        !self.fits_pose() || self.judged(attempt.clone(), pose_history).is_good()
    }
}
