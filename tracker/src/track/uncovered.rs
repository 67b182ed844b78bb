//! What is not covered of a target, fitted by the document itself: with its own domain and background, and pixels sampled as finely
//! as they have to be, that says the most.
//!
//! What comes in: parameters that are nearly right. What goes out: the fit of the model itself over what is not covered, and how much
//! of the target is. It never knows a track.

use super::solver::{Look, Solver};
use super::window::Margin;
use crate::estimate::Substitute;
use crate::solve::alternatives::{Cover, Covered, MISFIT, OUTLIER};
use crate::solve::fit::{Fit, fit};
use crate::solve::residuals::Over;
use crate::solve::sampling::Way;
use crate::solve::stage_kernels::Control;

/// Rounds of finding what is covered and fitting the rest.
const ROUNDS: usize = 4;

/// Where what is not covered has a mean squared residual of more than this where a fit begins, none will explain it: covered is what
/// is far off and hangs together.
const HOPELESS: f64 = 5.0;

/// A fit of what is not covered.
pub(super) struct Uncovered {
    pub fit: Fit,
    /// The share of the target that is covered.
    pub hidden: f64,
}

impl Solver {
    /// The model's own fit of what is not covered, from the parameters of another one; `None` where nothing is covered or that is not
    /// what `is_wanted` says, and where the model does not explain the rest.
    pub(super) fn uncovered(
        &self,
        look: &Look,
        from: &[f64],
        margin: Margin,
        is_wanted: &dyn Fn(Cover) -> bool,
    ) -> Option<Uncovered> {
        let predictions = self.compiled.predictions()?;
        let (mut at, mut last): (Vec<f64>, Option<(Covered, Uncovered)>) = (from.to_vec(), None);
        for _ in 0..ROUNDS {
            let view = self.view(look, self.window(look, &at, margin));
            let seen = predictions.residuals(&view, &at, &self.constants, Over::Domain)?;
            let mask = Covered::mask(&view, &seen, OUTLIER)?;
            if last.as_ref().is_some_and(|(before, _)| before.has(&mask)) {
                break;
            }
            let cover = Cover::of(&seen, &mask);
            if !is_wanted(cover) || cover.left > HOPELESS {
                return None;
            }
            let covered = Covered::of(&view, mask);
            let rest = covered.view(&view)?;
            let sampled = self.sampling(look, &rest).and_then(|sampling| {
                let before = last.as_ref().and_then(|(_, before)| before.fit.chosen.as_ref());
                let fit = self.sampled_fit(&sampling, &rest, &at, before, Way::Any);
                fit.filter(|fit| fit.ending.is_fit())
            });
            let plain = || fit(&self.compiled, &rest, &self.constants, &at, Control::Dropping).ok();
            let fit = sampled.or_else(plain).filter(|fit| fit.ending.is_fit() && fit.worth.is_some())?;
            at.clone_from(&fit.parameters);
            last = Some((covered, Uncovered { fit, hidden: cover.hidden }));
        }
        let (_, uncovered) = last?;
        let reduced = uncovered.fit.worth.as_ref()?.reduced?;
        (reduced <= MISFIT).then_some(uncovered)
    }
}

impl Uncovered {
    /// As a substitute for the model of which all pixels count.
    pub fn into_fit(self) -> Fit {
        Fit { choice: Some(Substitute { degree: 0, robust: true, hidden: self.hidden }), ..self.fit }
    }
}
