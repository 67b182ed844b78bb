//! Loops for the first pass of a fit and for its probable last one, over the same parameters and in the same form as a
//! Gauss–Newton [`Objective`]. They exploit that more is known of these passes than of a step's.

use crate::graph::budget::Budget;
use crate::likelihood::claim::{Claim, Part};
use crate::model::{Method, Summand};
use crate::objective::{DerivationSetting, Objective};
use crate::program::ParameterId;
use crate::proof::Form;
use crate::proof::referee::Referee;
use isophote_syntax::diagnostic::Diagnostics;

impl Objective {
    /// The same sums for passes entered at the parameters themselves: the predictions for weights and residual are the
    /// same and computed once. Inputs at entry are not read.
    ///
    /// # Errors
    /// When it grows past a limit.
    pub fn opening(&self) -> Result<Objective, Diagnostics> {
        self.optional(Claim::Opening)
    }

    /// F, the gradient and the Hessian's diagonal with the weights of entry: a last pass, whose Hessian is close to
    /// that of the one before. Models with noise append the final report: Σ r²/σ² + ln σ² and Σ r²/σ² at the parameters
    /// themselves.
    ///
    /// # Errors
    /// When it grows past a limit.
    pub fn closing(&self) -> Result<Objective, Diagnostics> {
        let is_weighed = self.referee().summand().model().has_noise();
        let own = Claim::Derivatives { newton: false, part: Part::Diagonal };
        self.optional(if is_weighed { Claim::Closing } else { own })
    }

    /// Draws on the document's budget for optional programs: exceeding it does not affect the others.
    fn optional(&self, claim: Claim) -> Result<Objective, Diagnostics> {
        self.claimed(claim, self.referee().summand().budget().for_options())
    }

    /// Other sums of the same parameters, in the same form.
    fn claimed(&self, claim: Claim, budget: Budget) -> Result<Objective, Diagnostics> {
        let referee = Referee::of(self.referee().summand(), self.subset(), claim)?;
        let form = self.proof().map_or(Form::Factored, |proof| proof.form);
        DerivationSetting::of(&referee, self.subset(), budget).objective(form)?.measured()
    }
}

impl Summand {
    /// Gradient or Hessian in a loop of its own, to compare with the joint loop and in its form; its programs are
    /// checked as well.
    pub fn part_objective(&self, subset: &[ParameterId], method: Method, part: Part) -> Result<Objective, Diagnostics> {
        let joint = self.objective(subset, method)?;
        let claim = Claim::Derivatives { newton: method == Method::Newton, part };
        if part == Part::Both { Ok(joint) } else { joint.claimed(claim, self.budget()) }
    }
}
