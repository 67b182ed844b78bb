//! The pixels of a target and those beside it: how far residuals hang together, how much of them the ground explains, how noisy it is.
//!
//! Input: a fit, a frame. Output: [`Ground`]. It never knows whether it is the target.

use isophote_symbolic::Model;
use serde::{Deserialize, Serialize};

use super::solver::{Attempt, Look, Solver};
use super::uneven::{self, Uneven};
use crate::solve::exact;
use crate::solve::fit::Fit;
use crate::solve::passes::Worth;
use crate::solve::structure::Structure;

/// A budget: a target's pixels are looked at one by one again when χ²/ν has changed by this factor since.
pub(super) const GROWN: f64 = 1.35;
/// A definition: a χ²/ν that is larger than 1 by this leaves something unexplained.
const LEFT: f64 = 0.3;
/// A definition: a χ²/ν that is larger than 1 by so many standard deviations, √(2/ν), is significant.
pub(super) const SCATTER: f64 = 3.0;

/// The pixels of a target and those beside it, as a search saw them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Ground {
    /// Of the target's own pixels, when they were last looked at one by one.
    pub own: Option<Own>,
    /// The unevenness of the ground, once residuals have asked for it.
    pub uneven: Option<Uneven>,
}

/// A target's own pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Own {
    pub structure: Structure,
    /// χ²/ν of that fit.
    #[serde(with = "exact")]
    pub reduced: f64,
    /// The variance of what rows are off by, pixel values², where the fit did not know of that.
    #[serde(with = "exact", default)]
    pub rows: Option<f64>,
}

impl Ground {
    /// True where the ground explains the residuals of a fit: nothing else need do so.
    pub fn explains(&self, attempt: &Attempt) -> bool {
        let share = self.own.map_or(0.0, |own| own.structure.share());
        let excess = attempt.reduced().map_or(f64::INFINITY, |reduced| reduced - 1.0);
        let has_rows = self.own.is_some_and(|own| own.rows.is_some());
        attempt.is_good()
            && !has_rows
            && self.uneven.is_some_and(|uneven| share <= uneven.share && excess <= uneven.excess)
    }

    /// With the pixels of a fit looked at one by one, unless they were and χ²/ν is about as it was then.
    pub fn looked_at(self, solver: &Solver, look: &Look, attempt: &Attempt) -> Ground {
        let fit = attempt.fit.as_ref().filter(|_| attempt.is_good() && !solver.fits_pose());
        let Some((fit, reduced)) = fit.zip(attempt.reduced()) else { return self };
        let is_as_it_was = |own: Own| reduced <= GROWN * own.reduced && own.reduced <= GROWN * reduced;
        // Offsets of rows are no unevenness, and are fitted otherwise.
        let has_rows = look.row_variance().is_some();
        let measured = || if has_rows { None } else { uneven::of(solver, look, fit) };
        let uneven = || Some(measured().unwrap_or_default());
        let is_left = solver.model().has_noise() && reduced > 1.0 + LEFT;
        if fit.choice.is_some() {
            let uneven = if is_left { self.uneven.or_else(uneven) } else { self.uneven };
            return Ground { uneven, ..self };
        }
        if self.own.is_some_and(is_as_it_was) {
            return self;
        }
        let own = solver.structure(look, fit).map(|(structure, rows)| Own { structure, reduced, rows });
        let is_told = own.is_some_and(|own| own.structure.is_told() && own.rows.is_none());
        let is_asked = (is_told || is_left) && (self.uneven.is_none() || self.own.is_some());
        let uneven = if is_asked { uneven() } else { self.uneven };
        Ground { own: own.or(self.own), uneven }
    }
}

/// Pixels beyond what parameters take.
pub(super) fn freedom(solver: &Solver, worth: &Worth) -> f64 {
    worth.pixels.saturating_sub(solver.compiled.last_parameters().len() as u64).max(1) as f64
}

/// By how much χ²/ν may be larger than it should.
fn scatter(solver: &Solver, worth: &Worth) -> f64 {
    SCATTER * (2.0 / freedom(solver, worth)).sqrt()
}

/// By how much a covariance is larger than that of independent pixels with their noise as stated. `noise`: the variance of pixels over
/// that, as frames have shown it. What this frame leaves counts as far as such noise cannot look so, and as many times as pixels
/// have it in common; without `noise` in the model the covariance follows χ²/ν already.
pub(super) fn scale(solver: &Solver, fit: &Fit, ground: Ground, noise: f64) -> f64 {
    let Some(worth) = &fit.worth else { return noise };
    let own = ground.own.filter(|_| fit.choice.is_none() && !solver.fits_pose());
    let [independent, hanging] = own.map_or([1.0, 0.0], |own| [own.structure.independent, own.structure.hanging]);
    match worth.reduced.filter(|_| solver.model().has_noise()) {
        Some(reduced) => noise.max(reduced * independent - noise * scatter(solver, worth)) + reduced * hanging,
        None => noise + hanging,
    }
}

/// ln L: `−½ (χ² + Σ ln σ² + n ln 2π)`; without `noise` with the variance that fits best, `−½ n (ln (2π F/n) + 1)`.
pub(crate) fn log_likelihood(worth: &Worth, model: &Model) -> Option<f64> {
    let n = worth.pixels as f64;
    let turn = std::f64::consts::TAU;
    let value = match model.has_noise() {
        true => -0.5 * (worth.objective + n * turn.ln()),
        false => -0.5 * n * ((turn * worth.objective / n).ln() + 1.0),
    };
    value.is_finite().then_some(value)
}
