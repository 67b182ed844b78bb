//! How sure: what a fit says for and against having the target, and the probability that follows.
//!
//! What comes in: a fit, and what was expected. What goes out: [`Evidence`], whose log odds order things, and from which the
//! confidence follows ([`odds`]).
//!
//! 1. *Contrast*, `ln (F₀/F)`: F₀ is F without the target, brightness 0 and the background fitted anew. F is a parabola in
//!    both, so `F₀ − F = v²/var(v)`, where var(v) is the brightness' variance at unit noise when nothing but the background
//!    is unknown beside it: no pass over pixels is needed. `½ (F₀ − F)` is the log-likelihood ratio against background alone.
//! 2. *Misfit*, `ln (e/e₀)`, at least 0, with e the share of the target's light that the model leaves unexplained, over the
//!    number of places where it does so independently: a thing of another shape. No model is quite right, so e₀ is forgiven.
//!    What hangs together in the residuals of the frame in which the target was found says it ([`Structure`]), without any
//!    knowledge of the noise; in frames after that one, what χ²/ν has grown by as well. Where it says hardly anything, χ²/ν by
//!    the model's own noise does: a few sharp pixels leave nothing that hangs together. Where there are too few pixels for
//!    that it is `(χ²/ν − 1)/((F₀ − F)/ν)`, over no number of places, and without `noise` in
//!    the model the noise is that at the border of what was searched, with a variance that grows as the light.
//!    What the ground leaves elsewhere under the same pixels ([`uneven`]) is taken off.
//!    A substitute, which may leave out what does not suit it, is held to the noise itself: e is what χ²/ν exceeds 1 by,
//!    and the more it leaves out, the less it says.
//! 3. *Distance* from where the target should be, √(yᵀS⁻¹y / n), beyond the gate; none for a target that moved by less than
//!    its own size.
//! 4. *Strangeness*: by how many e-folds size and brightness differ from those of the last frame, or from given ones.
//! 5. *Oddity*: log odds that its looks take away when nothing is known of the target yet: corners
//!    ([`asymmetry`]), a frame that is full of such things ([`prominence`]), a substitute that hides more than may be, or its middle
//!    ([`hole`]), or that pretends a part of the target ([`deviation`]), a profile that is not the document's, and looks that are
//!    nearly the target's among things that are no targets (`peers`), or cut off by the border on uneven ground. What is taken for
//!    the target keeps it.
//! 6. *Rivals*: odds of what else is in the frame in which it was found, times by how much that is larger and brighter. They order
//!    nothing; one thing is the target.
//!
//! The weights were fitted to seeded frames with and without distractors; docs/confidence.md shows how well they hold.

use isophote_symbolic::{Model, ParameterId, Roles};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::around::Around;
use super::asymmetry;
use super::deviation;
use super::hole;
use super::odds;
use super::prominence;
use super::solver::{Attempt, Look, Solver};
use super::uneven::{self, Uneven};
use crate::estimate::Ending;
use crate::solve::exact;
use crate::solve::fit::Fit;
use crate::solve::passes::Worth;
use crate::solve::structure::Structure;

/// What contrast, misfit, distance and strangeness count for the order of things, and the constant.
const ORDER: ([f64; 4], f64) = ([2.4, -4.0, -0.7, -1.5], -3.0);
/// The same for the odds: things of which much speaks are ordered more sharply than they differ.
const ODDS: ([f64; 4], f64) = ([1.8, -1.5, -0.4, -0.25], -1.91);

/// What an e-fold of the log-likelihood ratio counts when one of two likely things must be taken: the larger, brighter one.
const LARGER: f64 = 1.0;
/// e₀, of models that say nothing of noise, and of those that say how noisy pixels are, which counts them by that, …
const PRETENDED: [f64; 2] = [2e-4, 1.1e-4];
/// … and where nothing is known of how residuals hang together.
const IMPERFECT: f64 = 0.002;
/// What a model says of noise may be so far wrong where there is light, and right where there is none.
const MISSTATED: f64 = 2.0;
/// So many times what is forgiven of residuals that hang together is hardly any.
const LOOSE: f64 = 2.0;
/// e₀ of χ²/ν, for substitutes.
const EXCESS: f64 = 0.02;
/// e-folds for a substitute that leaves all pixels out.
const HIDDEN: f64 = 2.5;
/// A target's pixels are looked at one by one again when χ²/ν has changed by this factor since.
const GROWN: f64 = 1.35;
/// A height of so many times what pixels hold can still be told.
const HEIGHT_MAX: f64 = 3.0;
/// χ²/ν that is larger than 1 by this leaves something.
const LEFT: f64 = 0.3;
/// More e-folds beyond that say nothing more: what is that bright is doubted, not refused.
const BEYOND_MAX: f64 = 2.5;
/// What a rough model leaves of the variance of a target's light, …
const UNEXPLAINED: f64 = 0.08;
/// … or one that says how noisy pixels are, and so means what it says of their light, …
const UNEXPLAINED_STATED: f64 = 0.018;
/// … and what all of it takes of the log odds.
const OTHERWISE: f64 = 80.0;
/// So many pixels a parameter are few, …
const PIXELS_FEW: u64 = 12;
/// … and where they leave parameters undetermined, that takes so much of the log odds.
const UNDETERMINED: f64 = 8.0;
/// A substitute that hides no more than this share hides nothing.
const HIDDEN_LEAST: f64 = 0.1;
/// What hides nothing deviates from the document by no more than this share of its height, …
const DEVIATION_MAX: f64 = 0.03;
/// … and what all of it takes of the log odds.
const PRETENCE: f64 = 60.0;
/// Whoever lost so much of the log odds has no need to be looked at any further.
const HOPELESS: f64 = 12.0;
/// What a frame full of things like it counts at most where several are looked for.
const ODD_MOST: f64 = 1.0;
/// Degrees of freedom that the ground counts where a fit's own residuals are less, …
const LUCK: f64 = 10.0;
/// … and how many times their variance that of the ground is at most: a texture is no noise.
const LUCK_MAX: f64 = 20.0;
/// χ²/ν may be larger than 1 by so many of its standard deviations, √(2/ν).
const SCATTER: f64 = 3.0;

/// What a search saw of the pixels beside the target.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Ground {
    /// Of a pixel of the background; of no use to models that say it.
    #[serde(with = "exact")]
    pub variance: f64,
    /// The largest value that a pixel may have.
    #[serde(with = "exact")]
    pub limit: f64,
    /// Of the target's own pixels, when they were last looked at one by one.
    pub own: Option<Own>,
    /// What it leaves in residuals, where these leave something.
    #[serde(default)]
    pub uneven: Option<Uneven>,
    /// Log odds that its looks took away when it was first found.
    #[serde(with = "exact", default)]
    pub oddity: f64,
    /// Odds of all else that was there then and may have been the target.
    #[serde(with = "exact", default)]
    pub rivals: f64,
}

/// A target's own pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Own {
    pub structure: Structure,
    /// χ²/ν of that fit.
    #[serde(with = "exact")]
    pub reduced: f64,
    /// By which factor its pixels are brighter than the background.
    #[serde(with = "exact")]
    pub light: f64,
    /// The variance of what rows are off by, pixel values², where the fit did not know of that.
    #[serde(with = "exact", default)]
    pub rows: Option<f64>,
    /// How many times the variance that the model says pixels without light have, once at least; of a model that says it, and a
    /// picture that was searched.
    #[serde(with = "exact", default)]
    pub noisier: Option<f64>,
}

/// For and against having the target.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Evidence {
    /// ln (F₀/F).
    pub contrast: f64,
    /// ln (e/e₀).
    pub misfit: f64,
    /// Standard deviations beyond the gate.
    pub distance: f64,
    /// e-folds.
    pub strangeness: f64,
    /// Log odds.
    pub oddity: f64,
    /// Odds.
    pub rivals: f64,
    /// It was seen three times and more: that it is faint by now says less.
    pub is_confirmed: bool,
    /// ln of the log-likelihood ratio against background alone; it says that there is something, not that it is the target.
    pub significance: f64,
}

impl Evidence {
    /// More contrast than this says nothing more.
    pub const CONTRAST_MAX: f64 = 4.0;
    /// Less contrast than this makes nothing less likely: it is faint, which is told otherwise. …
    pub const CONTRAST_MIN: f64 = 1.2;
    /// … So it is with a target that was seen before.
    pub const CONTRAST_KNOWN: f64 = 1.6;

    /// Of a fit alone; `ground` is for models that say nothing of noise. `None` when the model has no free brightness,
    /// and for poses: the weights were not fitted to any.
    pub(crate) fn of(solver: &Solver, fit: &Fit, ground: Option<Ground>) -> Option<Evidence> {
        let worth = fit.worth.as_ref().filter(|_| !solver.fits_pose())?;
        let gain = gain(solver, fit, worth, ground.map(|ground| ground.variance))?;
        let contrast = (1.0 + gain).ln();
        let own = ground.and_then(|ground| Some((ground.own?, light(solver, fit, ground.limit))));
        let unit = match (own, solver.model().has_noise()) {
            (Some((own, light)), _) => Some(own.reduced * (light / own.light).max(1.0)),
            (None, true) => Some(1.0),
            (None, false) => ground.map(|ground| ground.variance * light(solver, fit, ground.limit)),
        };
        let freedom = freedom(solver, worth);
        let unexplained = |unit: f64| share_left(solver, worth, gain, [unit; 2]);
        let uneven = ground.and_then(|ground| ground.uneven);
        let misfit = match fit.choice {
            Some(choice) => {
                let forgiven = uneven.map_or(0.0, |uneven| uneven.excess);
                let excess = worth.reduced? - 1.0 - forgiven - scatter(solver, worth);
                (excess.max(0.0) / EXCESS).ln_1p() + HIDDEN * choice.hidden
            }
            None => {
                let grown = unit.map_or(Some(0.0), unexplained)?;
                // A few sharp pixels leave much unexplained, and nothing that hangs together.
                let is_loose = |own: &Own| own.structure.share() <= LOOSE * pretended(solver);
                let noisier = own.map(|(own, _)| own).filter(is_loose).and_then(|own| own.noisier);
                let stated = noisier.and_then(|noisier| unexplained(MISSTATED * noisier)).unwrap_or(0.0);
                let forgiven = uneven.map_or(0.0, |uneven| uneven.share);
                let share = own.map_or(grown / IMPERFECT, |(own, _)| {
                    (own.structure.share().max(grown * own.structure.cell) - forgiven) / pretended(solver)
                });
                share.max(stated / IMPERFECT).max(1.0).ln()
            }
        };
        let misfit = misfit + ground.map_or(0.0, |ground| beyond(solver, fit, ground.limit));
        let [oddity, rivals] = ground.map_or([0.0; 2], |ground| [ground.oddity, ground.rivals]);
        let significance = (0.5 * gain * freedom).max(1.0).ln();
        Some(Evidence { contrast, misfit, oddity, rivals, significance, ..Evidence::default() })
    }

    /// By which one of several things is taken.
    pub(crate) fn rank(&self) -> f64 {
        self.log_odds() + LARGER * self.significance
    }

    /// The odds that something else in the frame is the target instead, beside this: of two that look alike the larger, brighter one.
    pub(crate) fn odds_against(&self, other: &Evidence) -> f64 {
        other.odds() * (LARGER * (other.significance - self.significance)).exp()
    }

    /// The highest rank that anything with such a log-likelihood ratio can have.
    pub(crate) fn most(log_likelihood_ratio: f64) -> f64 {
        let significance = log_likelihood_ratio.max(1.0).ln();
        Evidence { contrast: Self::CONTRAST_MAX, significance, ..Evidence::default() }.rank()
    }

    /// The log odds, by which things are ordered; the confidence follows from the same, with other weights.
    pub fn log_odds(&self) -> f64 {
        self.weighed(ORDER, self.contrast)
    }

    /// The odds that the thing fitted is the target, were nothing else in the frame.
    pub fn odds(&self) -> f64 {
        let least = if self.is_confirmed { Self::CONTRAST_KNOWN } else { Self::CONTRAST_MIN };
        odds::of(self.weighed(ODDS, self.contrast.max(least)))
    }

    /// The probability that the thing fitted is the target, were nothing else in the frame.
    pub fn confidence_alone(&self) -> f64 {
        let odds = self.odds();
        odds / (1.0 + odds)
    }

    /// The probability that the thing fitted is the target.
    pub fn confidence(&self) -> f64 {
        let odds = self.odds();
        odds / (1.0 + odds + self.rivals)
    }

    fn weighed(&self, (weights, constant): ([f64; 4], f64), contrast: f64) -> f64 {
        let seen = [contrast.min(Self::CONTRAST_MAX), self.misfit, self.distance, self.strangeness];
        constant + weights.iter().zip(seen).map(|(weight, seen)| weight * seen).sum::<f64>() - self.oddity
    }
}

impl Solver {
    /// What is beside a target that nobody has searched for, where the model says how noisy pixels are.
    pub fn stated_ground(&self, look: &Look, attempt: &Attempt) -> Option<Ground> {
        let fit = attempt.fit.as_ref().filter(|_| self.model().has_noise() && !self.fits_pose())?;
        let limit = self.limit(look, &fit.parameters)?;
        Some(Ground::new(f64::NAN, limit))
    }
}

impl Ground {
    /// Of which nothing else is known yet.
    pub fn new(variance: f64, limit: f64) -> Ground {
        Ground { variance, limit, own: None, uneven: None, oddity: 0.0, rivals: 0.0 }
    }

    /// What a fit leaves is what the ground leaves as well: nothing else need explain it.
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
        let Some((fit, reduced)) = attempt.fit.as_ref().zip(attempt.reduced()) else { return self };
        let is_as_it_was = |own: Own| reduced <= GROWN * own.reduced && own.reduced <= GROWN * reduced;
        // What rows are off by is no unevenness, and is fitted otherwise.
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
        let light = light(solver, fit, self.limit);
        let own = solver.structure(look, fit).map(|(structure, rows, dark)| {
            let noisier = (self.variance / dark).max(1.0);
            let noisier = Some(noisier).filter(|_| solver.model().has_noise() && self.variance.is_finite());
            Own { structure, reduced, light, rows, noisier }
        });
        let is_told = own.is_some_and(|own| own.structure.share() > pretended(solver) && own.rows.is_none());
        let is_asked = (is_told || is_left) && (self.uneven.is_none() || self.own.is_some()) && self.oddity < HOPELESS;
        let uneven = if is_asked { uneven() } else { self.uneven };
        Ground { own: own.or(self.own), uneven, ..self }
    }

    /// With what its looks say of a thing that may be the target, of which nothing is known yet.
    pub fn seen_first(self, solver: &Solver, look: &Look, attempt: &Attempt) -> Ground {
        let Some(fit) = attempt.fit.as_ref().filter(|_| attempt.is_good() && !solver.fits_pose()) else { return self };
        let own = match Around::of(solver, look, fit) {
            Some(around) => self.odd_looks(fit, &around),
            None => fit.choice.map_or(0.0, hole::veiled),
        };
        if own >= HOPELESS {
            return Ground { oddity: own, ..self };
        }
        // Where several are looked for, others like it may be those.
        let most = if solver.options.targets > 1 { ODD_MOST } else { f64::INFINITY };
        let common = prominence::of(solver, look, fit).map_or(0.0, prominence::against).min(most);
        Ground { oddity: own + common, ..self }
    }

    /// What a thing's looks take of the log odds.
    fn odd_looks(&self, fit: &Fit, around: &Around) -> f64 {
        let Some(choice) = fit.choice else {
            return asymmetry::of(around, f64::INFINITY).map_or(0.0, asymmetry::against);
        };
        let place = if choice.robust { hole::against(around, self.limit) } else { 0.0 };
        // What hides nothing looks as the document says, on a background that does not pretend it.
        let deviation = Some(around).filter(|_| choice.hidden <= HIDDEN_LEAST).and_then(deviation::of).unwrap_or(0.0);
        hole::veiled(choice) + place + PRETENCE * (deviation - DEVIATION_MAX).max(0.0)
    }

    /// With what is held against a profile that is not the document's, and against a few pixels that say too little.
    pub fn with_profile(self, solver: &Solver, attempt: &Attempt) -> Ground {
        let Some(fit) = attempt.fit.as_ref().filter(|_| attempt.is_good()) else { return self };
        let most = if solver.model().has_noise() { UNEXPLAINED_STATED } else { UNEXPLAINED };
        let profile = OTHERWISE * (self.unexplained(solver, fit) - most).max(0.0);
        let few = PIXELS_FEW * solver.compiled.last_parameters().len() as u64;
        let is_few = fit.worth.as_ref().is_some_and(|worth| worth.pixels < few);
        let undetermined = if is_few && attempt.ending == Ending::Singular { UNDETERMINED } else { 0.0 };
        Ground { oddity: self.oddity + profile + undetermined, ..self }
    }

    /// The share of the light's variance that a fit of the document itself leaves, the larger one of what hangs together and of what
    /// exceeds the noise where the model says that; what the ground leaves, and how much noisier it is than stated, taken off.
    pub fn unexplained(&self, solver: &Solver, fit: &Fit) -> f64 {
        let (Some(own), Some(worth), None) = (self.own, fit.worth.as_ref(), fit.choice) else { return 0.0 };
        let uneven = self.uneven.unwrap_or_default();
        let hanging = (own.structure.share() - uneven.share).max(0.0) / own.structure.cell;
        let exceeding = own.noisier.filter(|_| own.rows.is_none()).and_then(|noisier| {
            let gain = gain(solver, fit, worth, Some(self.variance))?;
            share_left(solver, worth, gain, [noisier.max(1.0 + uneven.excess), noisier])
        });
        hanging.max(exceeding.unwrap_or(0.0))
    }
}

/// Pixels beyond what parameters take.
fn freedom(solver: &Solver, worth: &Worth) -> f64 {
    worth.pixels.saturating_sub(solver.compiled.last_parameters().len() as u64).max(1) as f64
}

/// e₀ of residuals that hang together.
fn pretended(solver: &Solver) -> f64 {
    PRETENDED[usize::from(solver.model().has_noise())]
}

/// By how much χ²/ν may be larger than it should.
fn scatter(solver: &Solver, worth: &Worth) -> f64 {
    SCATTER * (2.0 / freedom(solver, worth)).sqrt()
}

/// By how much a covariance is larger than that of independent pixels with their noise as stated. `noise`: the variance of pixels over
/// that, as frames have shown it. What this frame leaves counts as far as such noise cannot look so, and as many times as pixels
/// have it in common; without `noise` in the model the covariance follows χ²/ν already.
pub(super) fn scale(solver: &Solver, fit: &Fit, ground: Option<Ground>, noise: f64) -> f64 {
    let Some(worth) = &fit.worth else { return noise };
    let own = ground.and_then(|ground| ground.own).filter(|_| fit.choice.is_none() && !solver.fits_pose());
    let [independent, hanging] = own.map_or([1.0, 0.0], |own| [own.structure.independent, own.structure.hanging]);
    match worth.reduced.filter(|_| solver.model().has_noise()) {
        Some(reduced) => noise.max(reduced * independent - noise * scatter(solver, worth)) + reduced * hanging,
        None => noise + hanging,
    }
}

/// The share of the target's light that a fit leaves, which is `gain` times as much as what it leaves: χ²/ν beyond what the picture
/// has without a target, and beyond the scatter of such noise.
fn share_left(solver: &Solver, worth: &Worth, gain: f64, [without, noise]: [f64; 2]) -> Option<f64> {
    let reduced = worth.reduced?;
    Some((reduced - without - noise * scatter(solver, worth)) / (gain * reduced))
}

/// By which factor a target's pixels are brighter than the background, on average: half its height, as far as the camera
/// sees it.
fn light(solver: &Solver, fit: &Fit, limit: f64) -> f64 {
    let value = |parameter: Option<ParameterId>| parameter.map(|parameter| fit.parameters[parameter.index()]);
    let factor = |roles: &Roles| {
        let (ground, height) = (value(roles.background)?, value(roles.brightness)?);
        Some(1.0 + (0.5 * height.min(limit - ground) / ground.max(1.0)).max(0.0))
    };
    solver.model().roles().iter().filter_map(factor).fold(1.0, f64::max)
}

/// e-folds, twice, by which a target is higher than a camera lets one say: a height of many times what pixels hold is an
/// extrapolation from a rim alone, and the rim of everything that is overexposed looks alike.
fn beyond(solver: &Solver, fit: &Fit, limit: f64) -> f64 {
    let value = |parameter: Option<ParameterId>| parameter.map(|parameter| fit.parameters[parameter.index()]);
    let excess = |roles: &Roles| {
        let seen = limit - value(roles.background)?;
        Some(2.0 * (value(roles.brightness)? / (HEIGHT_MAX * seen.max(1.0))).max(1.0).ln())
    };
    solver.model().roles().iter().filter_map(excess).fold(0.0, f64::max).min(BEYOND_MAX)
}

/// `F₀/F − 1`, the least of all targets of the model. `ground`: the variance of a pixel beside them.
fn gain(solver: &Solver, fit: &Fit, worth: &Worth, ground: Option<f64>) -> Option<f64> {
    let order = solver.compiled.last_parameters();
    let place = |parameter| order.iter().position(|&p| p == parameter);
    let mut least = f64::INFINITY;
    for roles in solver.model().roles() {
        let brightness = place(roles.brightness?)?;
        let background = roles.background.and_then(place);
        // Where that cannot be said, nothing else is known than what a brightness is by itself.
        let variance = match &worth.information {
            Some(information) => alone(information, brightness, background)?,
            None => worth.variance_alone[brightness],
        };
        least = least.min(fit.parameters[order[brightness].index()].powi(2) / variance);
    }
    // Covariances of a model without noise are in units of χ²/ν, so F is ν there. With noise χ²/ν is 1 on average: less is
    // luck, and of a dozen pixels a lot of it.
    let freedom = worth.pixels.checked_sub(order.len() as u64).filter(|&n| n > 0)? as f64;
    let ground = ground.filter(|ground| ground.is_finite());
    let luck = |reduced: f64| ground.map_or(1.0, |ground| lucky(reduced, ground, freedom) / reduced);
    let reduced = match solver.model().has_noise() {
        true => worth.reduced?.max(1.0),
        false => worth.reduced.filter(|reduced| *reduced > 0.0 && reduced.is_finite()).map_or(1.0, luck),
    };
    (least.is_finite() && reduced > 0.0).then(|| least / (freedom * reduced))
}

/// A variance that was found with so many degrees of freedom, as if ten more had found that of the ground, where it is less.
fn lucky(reduced: f64, ground: f64, freedom: f64) -> f64 {
    let ground = ground.clamp(reduced, LUCK_MAX * reduced);
    (freedom * reduced + LUCK * ground) / (freedom + LUCK)
}

/// The variance of a parameter when only `other` is unknown beside it.
fn alone(information: &DMatrix<f64>, parameter: usize, other: Option<usize>) -> Option<f64> {
    let own = information[(parameter, parameter)];
    let shared = other.map_or(0.0, |other| information[(parameter, other)].powi(2) / information[(other, other)]);
    Some(1.0 / (own - shared)).filter(|variance| *variance > 0.0 && variance.is_finite())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dozen_pixels_that_agree_by_chance_do_not_make_a_thing_clear() {
        assert!(lucky(0.08, 1.7, 3.0) > 1.0);
        assert_eq!(lucky(2.0, 1.7, 3.0), 2.0, "what is noisier than the ground is so");
        assert!(lucky(2.0, 100.0, 300.0) < 3.5, "a texture is no noise");
    }

    #[test]
    fn a_rough_model_is_better_than_none() {
        let seen = Evidence { contrast: Evidence::CONTRAST_MAX, ..Evidence::default() };
        let confidence = |misfit: f64| Evidence { misfit, ..seen }.confidence_alone();
        assert!((0.4..0.7).contains(&confidence(3.0)), "{}", confidence(3.0));
        assert!(confidence(6.0) < 0.05, "{}", confidence(6.0));
        assert!(Evidence { oddity: 12.0, ..seen }.confidence_alone() < 2e-3);
    }
}
