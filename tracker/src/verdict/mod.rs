//! Whether something that was fitted is the target.
//!
//! What comes in: a fit and the picture around it. What goes out: a few numbers about it, and from them the odds. It never knows a
//! track, nor how a search came to the fit.
//!
//! Most of it is one quantity, the *evidence*: a Bayes factor between "this profile, 2 % off" and "something else, 20 % off", of
//! what the residuals have in common with Zernike's functions and the fit could not have taken up, against the scatter that the same
//! functions have elsewhere in the frame.

mod alarm;
mod modes;
mod patch;
mod zernike;

use isophote_jit::Window;
use isophote_symbolic::Model;

use crate::sight::view::View;
use crate::solve::residuals::Predictions;
pub(crate) use alarm::ln_beyond;
use patch::Patch;

/// What a fit shows of whether it is of the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signs {
    /// ln of the likelihood of the residuals if this is the document's profile, over that if it is something else.
    pub evidence: f64,
    /// ln of the number of fits in noise, a frame, that are as significant.
    pub noise: f64,
    /// Other things in the frame that have a tenth of its energy at least.
    pub others: f64,
    /// The share of the profile's light that lies outside of the frame.
    pub cut_off: f64,
    /// The share of the profile's area whose pixels are saturated.
    pub saturated: f64,
    /// The share of the profile's light under pixels that nothing but a thing in front of it explains.
    pub covered: f64,
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
    /// Of the polynomial that was fitted beside the model.
    pub degree: u32,
}

/// The signs of a fit; `None` for models that are no single target with an outline in two dimensions, and where too few pixels say
/// something.
pub(crate) fn signs(subject: &Pictured, fitted: &FittedModel) -> Option<Signs> {
    Patch::of(subject, fitted)?.signs(subject, fitted)
}
