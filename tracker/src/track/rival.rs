//! Two poses that explain a picture nearly alike: both are followed until the pictures have decided.
//!
//! What comes in: fits of a model whose parameters are a pose. What goes out: the likelier one, with the other as its
//! [`Rival`]. The differences of their log-likelihoods add up from frame to frame, so that noise does not make the pose flip.

use serde::{Deserialize, Serialize};

use super::solver::{Attempt, Look, Solver};
use super::window::Margin;
use crate::pose::{Alternative, DELTA_CHI_SQUARE_MAX, Geometry};
use crate::sight::view::View;
use crate::solve::exact;
use crate::solve::fit::{Begin, difference};
use crate::solve::stage_kernels::{CompileFailure, Control};

/// The runner-up.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Rival {
    #[serde(with = "exact")]
    parameters: Vec<f64>,
    /// χ² by which it is worse, in all frames since both were found.
    #[serde(with = "exact")]
    delta: f64,
}

/// A rival that is worse by this is followed no more: it had a chance of one in three hundred thousand.
const DECIDED: f64 = 25.0;
/// A target that turned by this share of the angle between both poses may have gone from the one to the other.
const CROSSING: f64 = 0.25;
/// Poses whose axes differ by less are one, rad.
const SAME: f64 = 3e-3;

impl Rival {
    /// All of the model's.
    pub fn parameters(&self) -> &Vec<f64> {
        &self.parameters
    }

    /// For publication, while it is close.
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
    /// Of believable fits the one of the largest likelihood, with the next as its rival. Each has a pixel set of its own, so
    /// that their χ² cannot be compared as they are. Models that fit no pose keep what they have.
    pub fn likeliest_pose(
        &self,
        look: &Look,
        mut best: Attempt,
        others: Vec<Attempt>,
    ) -> Result<Attempt, CompileFailure> {
        let Some(geometry) = &self.geometry else { return Ok(best) };
        let view = self.view(look, look.window);
        let mut rival: Option<Rival> = best.rival.take();
        for other in others.into_iter().filter(Attempt::is_good) {
            let Some(delta) = self.delta(&view, geometry, &best, &other)? else { continue };
            let loser = if delta < 0.0 { std::mem::replace(&mut best, other) } else { other };
            let Some(fit) = loser.fit else { continue };
            // Whoever lost to the old best loses to the new one by more.
            let before = rival.take().map(|rival| Rival { delta: rival.delta + (-delta).max(0.0), ..rival });
            let next = Rival { parameters: fit.parameters, delta: delta.abs() };
            rival = Some(before.filter(|before| before.delta <= next.delta).unwrap_or(next));
        }
        best.rival = rival.filter(|rival| rival.delta < DECIDED);
        Ok(best)
    }

    /// A warm fit and its rival's, on one more frame.
    pub fn against_rival(
        &self,
        look: &Look,
        mut warm: Attempt,
        (rival, last): (Option<&Rival>, impl FnOnce() -> Option<Vec<f64>>),
        control: Control,
    ) -> Result<Attempt, CompileFailure> {
        // What is hidden from one is hidden from the other: such a picture decides nothing.
        let is_veiled = warm.choice().is_some();
        let Some(rival) = rival.filter(|_| warm.is_good() && warm.rival.is_none()) else { return Ok(warm) };
        if is_veiled {
            return Ok(Attempt { rival: Some(rival.clone()), ..warm });
        }
        let Some(geometry) = &self.geometry else { return Ok(warm) };
        let mut other = self.attempt(look, &rival.parameters, Begin::Nearby(None), control, Margin::NONE)?;
        let view = self.view(look, look.window);
        let delta = if other.is_good() { self.delta(&view, geometry, &warm, &other)? } else { None };
        if look.unfinished().is_some() {
            return Ok(Attempt { rival: Some(rival.clone()), ..warm }); // the picture has not decided
        }
        let Some(delta) = delta else { return Ok(warm) };
        // A target that turns by as much as lies between the two may have become the other: what was decided before counts for
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

    /// χ² by which `b` is worse than `a`; `None` when they are the same pose.
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
        let unit = if self.compiled.model().has_noise() { 1.0 } else { a.reduced().unwrap_or(1.0) };
        Ok(more.map(|more| more / unit).filter(|delta| delta.is_finite()))
    }
}
