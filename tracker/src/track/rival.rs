//! Two poses that explain a picture nearly alike: both are followed until the pictures decide. The differences of their
//! log-likelihoods add up from frame to frame, so that noise does not make the pose flip.

use serde::{Deserialize, Serialize};

use super::solver::{Attempt, FrameContext, Solver};
use super::window::Margin;
use crate::pose::{Alternative, DELTA_CHI_SQUARE_MAX, Geometry};
use crate::sight::view::View;
use crate::solve::exact;
use crate::solve::fit::{StartKind, difference};
use crate::solve::stage_kernels::{CompileFailure, PixelHandling};

/// The less likely pose.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Rival {
    #[serde(with = "exact")]
    parameters: Vec<f64>,
    /// Excess χ², summed over all frames since both were found.
    #[serde(with = "exact")]
    delta: f64,
}

/// A rival with this excess χ² is dropped: its chance is one in three hundred thousand.
const DECIDED: f64 = 25.0;
/// A target that turned by this share of the angle between both poses may have crossed from one to the other.
const CROSSING: f64 = 0.25;
/// Poses that differ by less are the same, rad.
const SAME: f64 = 3e-3;

impl Rival {
    /// All parameters of the model.
    pub fn parameters(&self) -> &Vec<f64> {
        &self.parameters
    }

    /// The alternative to publish, while its Δχ² is small.
    pub fn alternative(&self, geometry: &Geometry) -> Option<Alternative> {
        let pose = geometry.pose(&self.parameters);
        (self.delta < DELTA_CHI_SQUARE_MAX).then(|| Alternative {
            position_mm: pose.translation.into(),
            orientation_xyzw: pose.quaternion(),
            delta_chi_square: self.delta,
        })
    }
}

impl Solver {
    /// The accepted fit of the largest likelihood, with the next as its rival. Each fit has its own pixel set, so that
    /// their χ² cannot be compared directly. Models that fit no pose keep `best`.
    pub fn likeliest_pose(
        &self,
        context: &FrameContext,
        mut best: Attempt,
        others: Vec<Attempt>,
    ) -> Result<Attempt, CompileFailure> {
        let Some(geometry) = &self.geometry else { return Ok(best) };
        let view = self.view(context, context.window);
        let mut rival: Option<Rival> = best.rival.take();
        for other in others.into_iter().filter(Attempt::is_good) {
            let Some(delta) = self.delta(&view, geometry, &best, &other)? else { continue };
            let loser = if delta < 0.0 { std::mem::replace(&mut best, other) } else { other };
            let Some(fit) = loser.fit else { continue };
            // An earlier rival loses to the new best by more.
            let before = rival.take().map(|rival| Rival { delta: rival.delta + (-delta).max(0.0), ..rival });
            let next = Rival { parameters: fit.parameters, delta: delta.abs() };
            rival = Some(before.filter(|before| before.delta <= next.delta).unwrap_or(next));
        }
        best.rival = rival.filter(|rival| rival.delta < DECIDED);
        Ok(best)
    }

    /// Compares a warm fit with its rival's on one more frame; returns the likelier.
    pub fn against_rival(
        &self,
        context: &FrameContext,
        mut warm: Attempt,
        (rival, last): (Option<&Rival>, impl FnOnce() -> Option<Vec<f64>>),
        handling: PixelHandling,
    ) -> Result<Attempt, CompileFailure> {
        // An occluder affects both poses: such a picture decides nothing.
        let is_veiled = warm.choice().is_some();
        let Some(rival) = rival.filter(|_| warm.is_good() && warm.rival.is_none()) else { return Ok(warm) };
        if is_veiled {
            return Ok(Attempt { rival: Some(rival.clone()), ..warm });
        }
        let Some(geometry) = &self.geometry else { return Ok(warm) };
        let mut other = self.attempt(context, &rival.parameters, StartKind::Nearby(None), handling, Margin::NONE)?;
        let view = self.view(context, context.window);
        let delta = if other.is_good() { self.delta(&view, geometry, &warm, &other)? } else { None };
        if context.unfinished().is_some() {
            return Ok(Attempt { rival: Some(rival.clone()), ..warm }); // the picture has not decided
        }
        let Some(delta) = delta else { return Ok(warm) };
        // A target that turns by about the angle between the two may have become the other: the sum so far belongs to
        // another pair.
        let sides = warm.fit.as_ref().zip(other.fit.as_ref()).zip(last());
        let has_crossed = sides.is_some_and(|((warm, other), last)| {
            let moved = [warm, other].map(|fit| geometry.apart(&last, &fit.parameters));
            moved[0].min(moved[1]) > CROSSING * geometry.apart(&warm.parameters, &other.parameters)
        });
        let total = if has_crossed { delta } else { rival.delta + delta };
        if total < 0.0 {
            std::mem::swap(&mut warm, &mut other);
        }
        let parameters = other.fit.map(|fit| fit.parameters);
        warm.rival = parameters.map(|parameters| Rival { parameters, delta: total.abs() });
        warm.rival = warm.rival.filter(|rival| rival.delta < DECIDED);
        Ok(warm)
    }

    /// Excess χ² of `b` over `a`; `None` when they are the same pose.
    pub(super) fn delta(
        &self,
        view: &View,
        geometry: &Geometry,
        a: &Attempt,
        b: &Attempt,
    ) -> Result<Option<f64>, CompileFailure> {
        let (Some(fit_a), Some(fit_b)) = (&a.fit, &b.fit) else { return Ok(None) };
        if geometry.pose(&fit_a.parameters).angle_to(&geometry.pose(&fit_b.parameters)) < SAME {
            return Ok(None);
        }
        let more = difference(&self.compiled, view, &self.constants, &fit_a.parameters, &fit_b.parameters)?;
        let unit = if self.compiled.model().has_noise() { 1.0 } else { a.reduced_chi_square().unwrap_or(1.0) };
        Ok(more.map(|more| more / unit).filter(|delta| delta.is_finite()))
    }
}
