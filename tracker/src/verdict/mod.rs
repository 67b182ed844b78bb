//! The probability that a fit is the target, from a few features of the fit and of the image around it.
//!
//! The main feature is the *evidence*: a Bayes factor between "this profile, `deviation` off" and "something else, 20 %
//! off". It compares the projections of the residuals on Zernike functions, beyond what the fit could absorb, with the
//! scatter of the same projections elsewhere in the frame.

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
pub use modes::DeviationLikelihood;
use patch::Patch;

/// A definition: the default `deviation` of a document.
pub(crate) const DEVIATION: f64 = 0.02;

/// Features of a fit that discriminate the target from other objects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signs {
    /// ln of the likelihood ratio of the residuals: the document's profile over another one.
    pub evidence: f64,
    /// The likelihood of the residuals for each deviation of the profile from the document's; `None` with too few pixels.
    pub deviations: Option<DeviationLikelihood>,
    /// ln of the expected number of fits in noise per frame that are as significant.
    pub noise: f64,
    /// Other objects in the frame with at least a tenth of its energy.
    pub others: f64,
    /// The fit did not converge.
    pub unconverged: bool,
    /// The share of the profile's light outside the frame.
    pub cut_off: f64,
    /// The share of the profile's light under pixels whose residuals only an occluder explains.
    pub covered: f64,
}

impl Signs {
    /// Names of [`Signs::numbers`].
    pub const NAMES: [&str; 5] = ["evidence", "ln (1 + others)", "unconverged", "cut off", "covered"];

    /// The features of the logistic regression: ln odds against other objects.
    pub fn numbers(&self) -> [f64; 5] {
        let unconverged = if self.unconverged { 1.0 } else { 0.0 };
        [self.evidence, self.others.ln_1p(), unconverged, self.cut_off, self.covered]
    }

    /// ln of the odds of the target against another object.
    pub fn log_odds(&self) -> f64 {
        let terms = learned::WEIGHTS.iter().zip(self.numbers()).map(|(weight, number)| weight * number);
        learned::PRIOR + terms.sum::<f64>()
    }

    /// The probability that it is the target, and neither another object nor noise.
    pub fn probability(&self) -> f64 {
        Verdict::of(self).probability()
    }
}

/// A budget: the odds of a track are the mean of up to this many frames. Their sum would make a still object certain
/// within a few frames.
const OBSERVATIONS_MAX: u32 = 8;

/// A definition: a stated size or brightness is right within a factor of two, one standard deviation.
const STATED: f64 = std::f64::consts::LN_2;

/// The odds that a candidate is the target.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// ln of the odds of the target against another object: the mean over frames.
    #[serde(with = "exact")]
    log_odds: f64,
    /// ln of the expected number of fits in noise that are as significant in each frame: the sum over frames.
    #[serde(with = "exact")]
    noise: f64,
    /// Summed odds of all other fitted candidates.
    #[serde(with = "exact")]
    rivals: f64,
    /// Centre of the likeliest of them, px.
    #[serde(with = "exact")]
    rival: Option<[f64; 2]>,
    /// Other objects in view with at least a tenth of its energy.
    #[serde(with = "exact")]
    others: f64,
    #[serde(rename = "looks")]
    observations: u32,
}

impl Verdict {
    /// The verdict of one frame.
    pub fn of(signs: &Signs) -> Verdict {
        let Signs { noise, others, .. } = *signs;
        Verdict { log_odds: signs.log_odds(), noise, rivals: 0.0, rival: None, others, observations: 1 }
    }

    /// The odds that it is the target, ignoring other candidates.
    pub fn odds(&self) -> f64 {
        ((-self.log_odds).exp() + self.noise.exp()).recip()
    }

    /// The probability that it is the target.
    pub fn probability(&self) -> f64 {
        1.0 / (1.0 + (1.0 + self.rivals) * ((-self.log_odds).exp() + self.noise.exp()))
    }

    /// True for a significant candidate with no other object in view.
    pub fn is_alone(&self) -> bool {
        self.others == 0.0 && self.noise <= FALSE_ALARMS.ln()
    }

    /// Its surroundings, as far as they are remembered.
    pub fn surroundings(&self) -> Surroundings {
        Surroundings { others: self.others, targets: Vec::new() }
    }

    /// Lowers the odds for a size and brightness that are `off` e-folds from the stated ones.
    pub fn off_stated(self, off: f64) -> Verdict {
        Verdict { log_odds: self.log_odds - 0.5 * (off / STATED).powi(2), ..self }
    }

    /// Sets the odds of other candidates and the centre of the likeliest.
    pub fn among(self, rivals: f64, rival: Option<[f64; 2]>) -> Verdict {
        Verdict { rivals, rival, ..self }
    }

    /// Summed odds of all other fitted candidates.
    pub fn rivals(&self) -> f64 {
        self.rivals
    }

    /// Centre of the likeliest of them, px.
    pub fn rival(&self) -> Option<[f64; 2]> {
        self.rival
    }

    /// Caps the noise term at the detection filter's false alarms per frame.
    pub fn detected(self) -> Verdict {
        Verdict { noise: self.noise.min(FALSE_ALARMS.ln()), ..self }
    }

    /// Combines with the verdict of another frame.
    pub fn joined(self, next: Verdict) -> Verdict {
        let observations = (self.observations + 1).min(OBSERVATIONS_MAX);
        let log_odds = self.log_odds + (next.log_odds - self.log_odds) / f64::from(observations);
        Verdict { log_odds, noise: self.noise.min(0.0) + next.noise, observations, ..self }
    }
}

/// Objects around a fit.
#[derive(Clone, Debug, Default)]
pub(crate) struct Surroundings {
    /// Others with at least a tenth of its energy, less the other wanted targets.
    pub others: f64,
    /// Where several targets are wanted: the centres of all objects, px. They are no background of each other.
    pub targets: Vec<[f64; 2]>,
}

/// The fitted model and its surroundings.
pub(crate) struct VerdictContext<'a> {
    pub model: &'a Model,
    pub constants: &'a [f64],
    pub predictions: &'a Predictions,
    /// Reach of the domain, in semi-axes of the outline.
    pub reach: f64,
    /// The region of interest.
    pub region: Window,
    pub surroundings: &'a Surroundings,
    /// View of a part of it.
    pub view: &'a dyn Fn(Window) -> View<'a>,
}

/// The relevant part of a fit.
pub(crate) struct FittedModel<'a> {
    pub parameters: &'a [f64],
    /// Indices of the free parameters.
    pub free: &'a [usize],
    pub is_converged: bool,
    /// Degree of the polynomial background that was fitted beside the model.
    pub degree: u32,
}

/// The features of a fit; `None` unless the model is a single target with an outline in two dimensions.
pub(crate) fn signs(subject: &VerdictContext, fitted: &FittedModel) -> Option<Signs> {
    Patch::of(subject, fitted)?.signs(subject, fitted)
}
