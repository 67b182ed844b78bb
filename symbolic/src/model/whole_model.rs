//! Diagnostics about the model as a whole, which point at its intensity: it exceeds a limit, or its programs are wrong.

use crate::graph::Graph;
use crate::graph::budget::Budget;
use crate::model::Summand;
use crate::program::{Level, LoopNest};
use isophote_syntax::diagnostic::{Diagnostic, Diagnostics};
use isophote_syntax::limits::LIMITS;

/// What helps where formulas are too large.
const FEWER: &str = "free fewer parameters per stage, or give shared parts a definition";

impl Summand {
    fn fault(&self, code: &str, message: impl Into<String>, help: &str) -> Diagnostics {
        let model = self.model();
        let span = model.formulas.graph.span(self.first().intensity).unwrap_or_default();
        vec![Diagnostic::error(&model.text, code, "model.intensity", span, message).help(help)]
    }

    /// No program passes: a bug, unless the formulas have a value nowhere.
    pub(crate) fn unproved(&self, is_blind: bool) -> Diagnostics {
        if is_blind {
            let message = "the formulas have no finite value at any place that was tried";
            let help =
                "look for roots and logarithms of what is negative; `start` and `[roles]` say where a target may be";
            return self.fault("undefined", message, help);
        }
        let message =
            "no program that was derived for this model passes its check: a fault of isophote, not of the document";
        self.fault("bug", message, "please report the document; spelling the formula in another way may help")
    }

    /// The derivatives are too large.
    pub(crate) fn growth(&self, parameters: usize) -> Diagnostics {
        let most = LIMITS.nodes;
        let message = format!("the derivatives for {parameters} parameters grow past {most} distinct operations");
        self.fault("limit", message, FEWER)
    }

    /// Past the budget, or too large.
    pub(crate) fn outgrown(&self, graph: &Graph, parameters: usize) -> Diagnostics {
        if graph.budget().is_spent() { self.spent(graph.budget()) } else { self.growth(parameters) }
    }

    /// The document's budget is spent.
    pub(crate) fn spent(&self, budget: &Budget) -> Diagnostics {
        let message = match budget.is_spent() {
            true => format!("deriving what the stages need takes more than {} units of work", LIMITS.work),
            false => format!("the programs of all stages hold more than {} operations", LIMITS.kept),
        };
        let help = "free fewer parameters per stage, merge stages, or give shared parts a definition";
        self.fault("limit", message, help)
    }

    /// The check of the document's programs would take too long.
    pub(crate) fn costly(&self) -> Diagnostics {
        let message =
            format!("checking the derivatives of all stages would take more than {} operations", LIMITS.proof);
        self.fault("limit", message, FEWER)
    }

    /// The loop nest, if it is within the limits.
    pub(crate) fn within_limits(&self, graph: &Graph, nest: LoopNest) -> Result<LoopNest, Diagnostics> {
        let (count, most) = match nest.instructions().iter().filter(|i| i.level == Level::Pixel).count() {
            pixel if pixel > LIMITS.instructions => (pixel, LIMITS.instructions),
            _ => (nest.instructions().len(), LIMITS.nodes),
        };
        if graph.budget().is_spent() {
            return Err(self.spent(graph.budget()));
        }
        let message = match graph.overflowed() {
            true => format!("the loop grows past {} distinct operations", LIMITS.nodes),
            false if count > most => format!("the loop takes {count} instructions; at most {most} are compiled"),
            false => return Ok(nest),
        };
        Err(self.fault("limit", message, FEWER))
    }
}
