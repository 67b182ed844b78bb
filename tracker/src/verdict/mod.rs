//! Whether something that was fitted is the target.
//!
//! What comes in: a fit and the picture around it. What goes out: a few numbers about it, and from them the odds. It never knows a
//! track, nor how a search came to the fit.
//!
//! Most of it is one quantity, the *evidence*: a Bayes factor between "this profile, `deviation` off" and "something else, 20 % off", of
//! what the residuals have in common with Zernike's functions and the fit could not have taken up, against the scatter that the same
//! functions have elsewhere in the frame.

mod alarm;
mod learned;
mod modes;
mod patch;
mod zernike;

use isophote_jit::Window;
use isophote_symbolic::Model;
use serde::{Deserialize, Serialize};

use crate::sight::cold::FALSE_ALARMS;
use crate::sight::view::View;
use crate::solve::exact;
use crate::solve::residuals::Predictions;
pub(crate) use alarm::ln_beyond;
pub use modes::DeviationLikelihood;
use patch::Patch;

/// A definition: the `deviation` of a document that states none.
pub(crate) const DEVIATION: f64 = 0.02;

/// What a fit shows of whether it is of the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signs {
    /// ln of the likelihood of the residuals if this is the document's profile, over that if it is something else.
    pub evidence: f64,
    /// The likelihood of the residuals for each deviation of the profile from the document's; `None` of too few pixels.
    pub deviations: Option<DeviationLikelihood>,
    /// ln of the number of fits in noise, a frame, that are as significant.
    pub noise: f64,
    /// Other things in the frame that have a tenth of its energy at least.
    pub others: f64,
    /// The fit ended before it had converged.
    pub unconverged: bool,
    /// The share of the profile's light that lies outside of the frame.
    pub cut_off: f64,
    /// The share of the profile's light under pixels that nothing but a thing in front of it explains.
    pub covered: f64,
}

impl Signs {
    /// Names of [`Signs::numbers`].
    pub const NAMES: [&str; 5] = ["evidence", "ln (1 + others)", "unconverged", "cut off", "covered"];

    /// The features of the logistic line: ln odds against other things.
    pub fn numbers(&self) -> [f64; 5] {
        let unconverged = if self.unconverged { 1.0 } else { 0.0 };
        [self.evidence, self.others.ln_1p(), unconverged, self.cut_off, self.covered]
    }

    /// ln of the odds of the target against another thing.
    pub fn log_odds(&self) -> f64 {
        let terms = learned::WEIGHTS.iter().zip(self.numbers()).map(|(weight, number)| weight * number);
        learned::PRIOR + terms.sum::<f64>()
    }

    /// The probability that it is the target, and neither another thing nor noise.
    pub fn probability(&self) -> f64 {
        Verdict::of(self).probability()
    }
}

/// A budget: the odds of a track are the mean of so many looks. Their sum would make a still thing certain in a few frames.
const LOOKS: u32 = 8;

/// A definition: a size or a brightness that somebody states is right within a factor of two, one standard deviation.
const STATED: f64 = std::f64::consts::LN_2;

/// How likely something is the target.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// ln of the odds of the target against another thing: the mean of all looks.
    #[serde(with = "exact")]
    log_odds: f64,
    /// ln of the number of fits in noise that are as significant in each of the frames: the sum of all looks.
    #[serde(with = "exact")]
    noise: f64,
    /// Odds of all other things that were fitted.
    #[serde(with = "exact")]
    rivals: f64,
    /// The centre of the likeliest of them, px.
    #[serde(with = "exact")]
    rival: Option<[f64; 2]>,
    /// Other things in view that have a tenth of its energy.
    #[serde(with = "exact")]
    others: f64,
    looks: u32,
}

impl Verdict {
    /// Of one look.
    pub fn of(signs: &Signs) -> Verdict {
        let Signs { noise, others, .. } = *signs;
        Verdict { log_odds: signs.log_odds(), noise, rivals: 0.0, rival: None, others, looks: 1 }
    }

    /// The odds that it is the target, were nothing else fitted.
    pub fn odds(&self) -> f64 {
        ((-self.log_odds).exp() + self.noise.exp()).recip()
    }

    /// The probability that it is the target.
    pub fn probability(&self) -> f64 {
        1.0 / (1.0 + (1.0 + self.rivals) * ((-self.log_odds).exp() + self.noise.exp()))
    }

    /// True for what stands out of noise where nothing else does.
    pub fn is_alone(&self) -> bool {
        self.others == 0.0 && self.noise <= FALSE_ALARMS.ln()
    }

    /// Other things in view.
    pub fn others(&self) -> f64 {
        self.others
    }

    /// The same of what is so many e-folds off the size and brightness that were stated.
    pub fn off_stated(self, off: f64) -> Verdict {
        Verdict { log_odds: self.log_odds - 0.5 * (off / STATED).powi(2), ..self }
    }

    /// The same beside other things of those odds, the likeliest of which is there.
    pub fn among(self, rivals: f64, rival: Option<[f64; 2]>) -> Verdict {
        Verdict { rivals, rival, ..self }
    }

    /// Odds of all other things that were fitted.
    pub fn rivals(&self) -> f64 {
        self.rivals
    }

    /// The centre of the likeliest of them, px.
    pub fn rival(&self) -> Option<[f64; 2]> {
        self.rival
    }

    /// The same where the search's own filter has found it: noise is as strong in so large a share of frames at most.
    pub fn detected(self) -> Verdict {
        Verdict { noise: self.noise.min(FALSE_ALARMS.ln()), ..self }
    }

    /// With another look at it.
    pub fn joined(self, next: Verdict) -> Verdict {
        let looks = (self.looks + 1).min(LOOKS);
        let log_odds = self.log_odds + (next.log_odds - self.log_odds) / f64::from(looks);
        Verdict { log_odds, noise: self.noise.min(0.0) + next.noise, looks, ..self }
    }
}

/// The model that was fitted, and where.
pub(crate) struct Pictured<'a> {
    pub model: &'a Model,
    pub constants: &'a [f64],
    pub predictions: &'a Predictions,
    /// How far the domain reaches, in semi-axes of the outline.
    pub reach: f64,
    /// All that may be looked at.
    pub whole: Window,
    /// Other things in it that have a tenth of the target's energy at least.
    pub others: f64,
    /// A part of it.
    pub view: &'a dyn Fn(Window) -> View<'a>,
}

/// A fit, as far as it matters here.
pub(crate) struct FittedModel<'a> {
    pub parameters: &'a [f64],
    /// Numbers of those that were free.
    pub free: &'a [usize],
    pub is_converged: bool,
    /// Of the polynomial that was fitted beside the model.
    pub degree: u32,
}

/// The signs of a fit; `None` for models that are no single target with an outline in two dimensions.
pub(crate) fn signs(subject: &Pictured, fitted: &FittedModel) -> Option<Signs> {
    Patch::of(subject, fitted)?.signs(subject, fitted)
}
