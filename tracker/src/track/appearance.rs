//! `Appearance`: the size and brightness of a target, to decide whether a later fit may be of the same object.
//!
//! A target keeps its size when light changes, it fades or is partly hidden, and models agree about it: `ln (κ V)` is a
//! [`Coordinate`] with a rate, V the volume of the outline (in a plane: the area) and κ the share of it that the light would fill
//! at full height, which follows from the document's profile. A size is compared with the predicted one, within the variances of
//! both; a much fainter object is noise, whatever its size. At the predicted position a target may differ by more, if the model
//! fits it as well as before: the rest of a partly hidden target does not. Where a fit leaves out a share of its object as hidden,
//! the tolerance shrinks by that share: a smaller outline around the rest would fit as well. A fit with an undetermined size is
//! never the target. After half a minute unseen, any object may be it.

use isophote_symbolic::{Model, ParameterId};
use serde::{Deserialize, Serialize};

use super::coordinate::Coordinate;
use super::kalman_state::KalmanState;
use super::solver::{Attempt, Solver};
use crate::outline::{inverse_shape, size_parameters};
use crate::solve::exact;

/// Fits that confirm a target.
pub(super) const CONFIRMED: u32 = 3;
/// A budget: fits in the means of brightness and χ²/ν.
const FITS: u32 = 8;
/// A definition: standard deviation of sizes between models that differ from their targets, e-folds.
const ROUGH: f64 = 0.15;
/// Physical: standard deviation of the growth rate of a new target, e-folds of its area per second: an approach by a seventh of its
/// distance.
const RATE: f64 = 0.3;
/// Largest deviation of a size, in standard deviations (one of 16,000 exceeds it).
const GATE: f64 = 4.0;
/// Largest deviation of a size, e-folds, whatever its variance: objects of half the width exceed it.
const GATE_MAX: f64 = 1.2;
/// Fits in the mean of χ²/ν while it grows: more, so that it does not follow a cover.
const WORSE_FITS: f64 = 32.0;
/// Largest χ²/ν of a whole target over the usual one: half of a target may exceed it.
const WHOLE: f64 = 1.5;
/// Largest χ²/ν of the target over the usual one: other objects exceed it.
const EXPLAINED: f64 = 4.0;
/// Largest decrease of ln brightness.
const FAINTER: f64 = 3.0;
/// The same on a background of degree 2 or more, which can imitate missing light.
const FAINTER_BENT: f64 = 1.5;
/// Longest time unseen, s: later, an object of another size at the predicted position is a coincidence.
const SOON_S: f64 = 0.2;
/// Time unseen after which any object may be the target, s.
const FORGOTTEN_S: f64 = 30.0;

/// Size, brightness and χ²/ν of a target's fits.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Appearance {
    /// ln (κ V), and its rate.
    size: Option<Coordinate>,
    /// Mean ln of the brightness.
    #[serde(with = "exact")]
    height: f64,
    /// Mean χ²/ν of fits; `None` after a change of model.
    #[serde(with = "exact")]
    unexplained: Option<f64>,
    fits: u32,
    /// Time of the last fit, s.
    #[serde(with = "exact")]
    seen_s: f64,
}

impl Appearance {
    /// True when it was seen often enough to be recognised.
    pub fn is_known(&self) -> bool {
        self.fits >= CONFIRMED
    }

    /// Adds a fit. One that leaves pixels out only sets the time; one with a large χ²/ν, as of a half hidden target, keeps size and
    /// brightness.
    pub fn update(&mut self, solver: &Solver, attempt: &Attempt, time_s: f64) {
        if self.is_forgotten(time_s) {
            *self = Appearance::default();
        }
        self.seen_s = time_s;
        let is_plain = attempt.fit.as_ref().is_some_and(|fit| fit.choice.is_none());
        let Some((size, variance)) = size(solver, attempt).filter(|_| is_plain) else { return };
        if self.explains(solver, attempt, WHOLE) {
            self.fits += 1;
            self.height += (height(solver, attempt) - self.height) / f64::from(self.fits.min(FITS));
            let variance = variance + ROUGH * ROUGH;
            match &mut self.size {
                Some(known) => known.update(size, variance, time_s),
                None => self.size = Some(Coordinate::with_speed(size, variance, time_s, None, RATE)),
            }
        }
        if let Some(now) = unexplained(solver, attempt) {
            let share = |usual: f64| 1.0 / if now > usual { WORSE_FITS } else { f64::from(FITS) };
            self.unexplained = Some(self.unexplained.map_or(now, |usual| usual + share(usual) * (now - usual)));
        }
    }

    fn is_forgotten(&self, time_s: f64) -> bool {
        time_s - self.seen_s > FORGOTTEN_S
    }

    /// The likeness for another model.
    pub fn swapped(&self) -> Appearance {
        Appearance { unexplained: None, ..self.clone() }
    }

    /// True when a fit at the predicted position may be of the target: its χ²/ν is similar to earlier ones, or, with another size,
    /// about the same and soon after them; the size is within the absolute limit, and the fit is not much fainter.
    pub fn may_have_become(&self, solver: &Solver, attempt: &Attempt, time_s: f64) -> bool {
        let fit = attempt.fit.as_ref();
        let Some((volume, _)) = fit.and_then(|fit| volume(solver.model(), &fit.parameters)) else { return false };
        let Some(expected) = self.expected(time_s) else { return false };
        let size = volume + ln_fullness(solver);
        let is_of_size = self.is_of_size((size, 0.0), time_s, 1.0);
        let most = if is_of_size { EXPLAINED } else { WHOLE };
        let is_soon = time_s - self.seen_s <= SOON_S;
        (size - expected.position).abs() <= GATE_MAX
            && (is_of_size || is_soon)
            && self.explains(solver, attempt, most)
            && !self.is_faint(solver, attempt)
    }

    /// True for a fit much fainter than the target.
    fn is_faint(&self, solver: &Solver, attempt: &Attempt) -> bool {
        let is_bent = attempt.choice().is_some_and(|choice| choice.is_bent());
        height(solver, attempt) < self.height - if is_bent { FAINTER_BENT } else { FAINTER }
    }

    /// The predicted ln (κ V).
    fn expected(&self, time_s: f64) -> Option<KalmanState> {
        Some(self.size.as_ref()?.predict(time_s))
    }

    /// True for a size within the tolerance of the predicted one, which shrinks with the visible share `seen`.
    fn is_of_size(&self, (size, variance): (f64, f64), time_s: f64, seen: f64) -> bool {
        self.expected(time_s).is_none_or(|expected| {
            let gate = GATE * (ROUGH * ROUGH + variance + expected.variance).sqrt();
            (size - expected.position).abs() <= seen * gate.min(GATE_MAX)
        })
    }

    /// True when a fit's χ²/ν is at most `most` times the usual one, or that is unknown.
    fn explains(&self, solver: &Solver, attempt: &Attempt, most: f64) -> bool {
        let is_as_usual = |usual: f64| unexplained(solver, attempt).is_some_and(|now| now <= most * usual);
        self.unexplained.is_none_or(is_as_usual)
    }

    /// True when a fit has the target's size and is not much fainter, or these are unknown or forgotten.
    pub fn may_be(&self, solver: &Solver, attempt: &Attempt, time_s: f64) -> bool {
        if !self.is_known() || self.is_forgotten(time_s) || !is_sized(solver.model()) {
            return true;
        }
        let Some(size) = size(solver, attempt) else { return false };
        let seen = attempt.choice().map_or(1.0, |choice| 1.0 - choice.hidden);
        self.is_of_size(size, time_s, seen) && !self.is_faint(solver, attempt)
    }
}

/// ln of the brightness; 0 where the model has none.
fn height(solver: &Solver, attempt: &Attempt) -> f64 {
    let brightness = solver.model().roles().first().and_then(|roles| roles.brightness);
    let fit = attempt.fit.as_ref().zip(brightness);
    fit.map_or(0.0, |(fit, brightness)| fit.parameters[brightness.index()].abs().max(f64::MIN_POSITIVE).ln())
}

/// χ²/ν, at least that of rounding; without stated noise, divided by the brightness, to which the variance is proportional.
fn unexplained(solver: &Solver, attempt: &Attempt) -> Option<f64> {
    let summary = attempt.fit.as_ref()?.summary.as_ref()?;
    let reduced = summary.reduced_chi_square?.max(summary.expected_reduced_chi_square);
    let height = if solver.model().has_noise() { 1.0 } else { height(solver, attempt).exp() };
    Some(reduced / height).filter(|value| value.is_finite())
}

/// ln (κ V) of a fit, and its variance; `None` where the model has no size or several targets.
fn size(solver: &Solver, attempt: &Attempt) -> Option<(f64, f64)> {
    let fit = attempt.fit.as_ref()?;
    let (volume, slopes) = volume(solver.model(), &fit.parameters)?;
    let order = solver.compiled.last_parameters();
    let covariance = fit.summary.as_ref()?.covariance.as_ref()?;
    let index_of = |parameter: ParameterId| order.iter().position(|one| *one == parameter);
    let free: Vec<(usize, f64)> = slopes.into_iter().filter_map(|(id, slope)| Some((index_of(id)?, slope))).collect();
    let pairs = free.iter().flat_map(|(i, a)| free.iter().map(move |(j, b)| (*i, *j, a * b)));
    let variance: f64 = pairs.map(|(i, j, ab)| ab * covariance[(i, j)]).sum();
    let size = volume + ln_fullness(solver);
    (size.is_finite() && variance >= 0.0).then_some((size, variance))
}

/// ln κ; 0 where it is unknown.
fn ln_fullness(solver: &Solver) -> f64 {
    let profile = solver.profiles.usual(solver.model(), &solver.constants).filter(|profile| profile.fullness > 0.0);
    profile.map_or(0.0, |profile| profile.fullness.ln())
}

/// True for a model of one target with a size.
fn is_sized(model: &Model) -> bool {
    matches!(model.roles(), [roles] if !roles.shape.is_empty() || size_parameters(model).count() == model.coordinates().len())
}

/// ln V up to a constant, and its derivatives.
fn volume(model: &Model, parameters: &[f64]) -> Option<(f64, Vec<(ParameterId, f64)>)> {
    let [roles] = model.roles() else { return None };
    let n = model.coordinates().len();
    if !roles.shape.is_empty() {
        let (inverse, determinant) = inverse_shape(roles, n, parameters)?;
        let entries = (0..n).flat_map(|row| (row..n).map(move |column| (row, column)));
        let slope = |at: (usize, usize)| if at.0 == at.1 { -0.5 * inverse[at] } else { -inverse[at] };
        return Some((-0.5 * determinant.ln(), roles.shape.iter().copied().zip(entries.map(slope)).collect()));
    }
    let widths = size_parameters(model).map(|id| (id, parameters[id.index()]));
    let volume = widths.clone().map(|(_, width)| width.abs().ln()).sum();
    (widths.clone().count() == n).then(|| (volume, widths.map(|(id, width)| (id, width.recip())).collect()))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::sync::Arc;

    use isophote_symbolic::Precision;

    use super::*;
    use crate::picture::{Falloff, Spot, TestPicture};
    use crate::{Compiled, TrackState, Tracker, TrackerOptions};

    /// A smaller outline around the rest of a target fits as well.
    #[test]
    fn the_size_tolerance_shrinks_with_the_visible_share() {
        let size = Some(Coordinate::with_speed(5.0, 1e-4, 0.0, None, RATE));
        let known = Appearance { size, ..Appearance::default() };
        assert!(known.is_of_size((4.45, 1e-4), 0.0, 1.0) && !known.is_of_size((4.45, 1e-4), 0.0, 0.7));
        assert!(known.is_of_size((4.8, 1e-4), 0.0, 0.5));
    }

    /// A tracker of spots as a function of number, time and spot, which returns its state.
    fn states() -> impl FnMut(u64, f64, [f64; 3]) -> TrackState {
        let model = Model::from_toml(include_str!("../../../models/spot.toml")).unwrap();
        let compiled = Arc::new(Compiled::new(Arc::new(model), Precision::F32).unwrap());
        let mut tracker = Tracker::new(compiled, TrackerOptions::default()).unwrap();
        move |number, time_s, [x, half, light]| {
            let spots = vec![Spot { profile: Falloff::Cubic(-0.5, -0.3), ..Spot::at(x, 90.8, half, light) }];
            let picture = TestPicture { noise: 1.5, seed: number, ..TestPicture::new(240, 180, spots) };
            tracker.track(&picture.frame().with_sequence(number).with_time_s(Some(time_s))).state
        }
    }

    #[test]
    fn a_fast_approaching_target_is_followed() {
        let mut state = states();
        // At the end the area grows by a third per frame.
        for number in 0..65_u64 {
            let half = 5.0 * (0.14 * number.saturating_sub(47) as f64).exp();
            assert_eq!(
                state(number, number as f64 / 30.0, [120.0, half, 60.0]),
                TrackState::Tracking,
                "{number}: {half} px"
            );
        }
    }

    /// An object of another size is not accepted at once, but after a long time: the target may have approached unseen.
    #[test]
    fn a_target_that_returns_larger_is_accepted_after_a_long_time() {
        let mut states = states();
        let mut state = |number: u64, time_s: f64, half: f64, light: f64| {
            states(number, time_s, [if half > 10.0 { 60.0 } else { 160.0 }, half, light])
        };
        (0..10).for_each(|n| assert_eq!(state(n, n as f64 / 30.0, 10.0, 100.0), TrackState::Tracking));
        (10..20).for_each(|n| assert_ne!(state(n, n as f64 / 30.0, 10.0, 0.0), TrackState::Tracking));
        assert_ne!(state(20, 0.7, 20.0, 100.0), TrackState::Tracking, "four times the area after half a second");
        let again = (21..25).map(|n| state(n, 60.0 + n as f64 / 30.0, 20.0, 100.0));
        assert_eq!(again.last(), Some(TrackState::Tracking));
    }
}
