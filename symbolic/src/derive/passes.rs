//! Loops for passes of which more is known than of a step's: the one that a fit begins with, and the one that it is likely to end
//! with.
//!
//! What comes in: an [`Objective`] with Gauss–Newton's derivatives. What goes out: objectives over the same parameters, in the same
//! form. It never knows when such a pass is run.

use crate::derive::objective::{DerivationSetting, Objective};
use crate::derive::terms::referee;
use crate::language::model::{Method, Model};
use crate::program::ParameterId;
use crate::proof::Form;
use crate::proof::claim::{Claim, Part};
use isophote_syntax::diagnostic::Diagnostics;

impl Objective {
    /// The same sums for passes that are entered at the parameters themselves: of what is predicted for the weights and for the
    /// residual, which are then the same, one is worked out. Inputs at entry are not read.
    ///
    /// # Errors
    /// When it grows past a limit.
    pub fn opening(&self) -> Result<Objective, Diagnostics> {
        self.claimed(Claim::Opening)
    }

    /// F, the gradient and the Hessian's diagonal by the weights of entry: a last pass, whose Hessian is much that of the one
    /// before. Of models with noise behind them the report of its end, Σ r²/σ² + ln σ² and Σ r²/σ² at the parameters themselves.
    ///
    /// # Errors
    /// When it grows past a limit.
    pub fn closing(&self) -> Result<Objective, Diagnostics> {
        let is_weighed = self.referee().model().has_noise();
        self.claimed(if is_weighed {
            Claim::Closing
        } else {
            Claim::Derivatives { newton: false, part: Part::Diagonal }
        })
    }

    /// On the document's budget for what it can do without: where this is too much, its other programs are not.
    fn claimed(&self, claim: Claim) -> Result<Objective, Diagnostics> {
        let (model, subset) = (self.referee().model(), self.subset());
        let referee = referee(model, subset, Method::GaussNewton, claim)?;
        let form = self.proof().map_or(Form::Factored, |proof| proof.form);
        DerivationSetting::of(&referee, subset, model.budget().for_options()).objective(form)?.measured()
    }

    /// Gradient or Hessian in a loop of its own, in the form of the joint loop.
    pub(crate) fn part(
        model: &Model,
        subset: &[ParameterId],
        method: Method,
        part: Part,
    ) -> Result<Objective, Diagnostics> {
        let joint = Objective::derive(model, subset, method)?;
        match (part, joint.proof()) {
            (Part::Gradient | Part::Hessian | Part::Diagonal, Some(proof)) => {
                let claim = Claim::Derivatives { newton: method == Method::Newton, part };
                let referee = referee(model, subset, method, claim)?;
                DerivationSetting::of(&referee, subset, model.budget()).objective(proof.form)?.measured()
            }
            _ => Ok(joint),
        }
    }
}
