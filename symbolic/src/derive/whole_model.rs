//! Faults that concern the model as a whole: what it asks for is too much, or its programs are wrong.
//!
//! What comes in: a model, and what was derived. What goes out: diagnostics that point at its intensity.

use std::sync::Arc;

use crate::language::budget::Budget;
use crate::language::graph::Graph;
use crate::language::model::Model;
use crate::program::Level;
use crate::proof::draft::Draft;
use crate::proof::referee::Referee;
use isophote_syntax::diagnostic::{Diagnostic, Diagnostics, Span};
use isophote_syntax::limits::LIMITS;

/// Where the model's intensity stands, for faults that concern the model as a whole.
#[derive(Clone, Debug)]
pub(crate) struct WholeModel {
    text: Arc<str>,
    span: Span,
}

impl WholeModel {
    pub fn of(model: &Model) -> WholeModel {
        let span = model.formulas.graph.span(model.formulas.intensity).unwrap_or_default();
        WholeModel { text: model.text.clone(), span }
    }

    fn fault(&self, code: &'static str, message: String) -> Diagnostics {
        let help = "free fewer parameters per stage, or give shared parts a definition";
        vec![Diagnostic::error(&self.text, code, "model.intensity", self.span, message).help(help)]
    }

    /// No program passes: ours is the fault, if the formulas have a value anywhere.
    pub fn unproved(&self, referee: &Referee) -> Diagnostics {
        if referee.is_blind() { self.undefined() } else { self.bug() }
    }

    pub fn undefined(&self) -> Diagnostics {
        let message = "the formulas have no finite value at any place that was tried";
        let help = "look for roots and logarithms of what is negative; `start` and `[roles]` say where a target may be";
        vec![Diagnostic::error(&self.text, "undefined", "model.intensity", self.span, message).help(help)]
    }

    pub fn bug(&self) -> Diagnostics {
        let message =
            "no program that was derived for this model passes its check: a fault of isophote, not of the document";
        let help = "please report the document; spelling the formula in another way may help";
        vec![Diagnostic::error(&self.text, "bug", "model.intensity", self.span, message).help(help)]
    }

    pub fn growth(&self, parameters: usize) -> Diagnostics {
        let most = LIMITS.nodes;
        let message = format!("the derivatives for {parameters} parameters grow past {most} distinct operations");
        self.fault("limit", message)
    }

    /// Past the budget, or too large.
    pub fn outgrown(&self, graph: &Graph, parameters: usize) -> Diagnostics {
        if graph.budget().is_spent() { self.spent(graph.budget()) } else { self.growth(parameters) }
    }

    /// The document's budget is spent.
    pub fn spent(&self, budget: &Budget) -> Diagnostics {
        let message = match budget.is_spent() {
            true => format!("deriving what the stages need takes more than {} units of work", LIMITS.work),
            false => format!("the programs of all stages hold more than {} operations", LIMITS.kept),
        };
        let help = "free fewer parameters per stage, merge stages, or give shared parts a definition";
        vec![Diagnostic::error(&self.text, "limit", "model.intensity", self.span, message).help(help)]
    }

    /// The check of the document's programs would take too long.
    pub fn costly(&self) -> Diagnostics {
        let most = LIMITS.proof;
        self.fault("limit", format!("checking the derivatives of all stages would take more than {most} operations"))
    }

    pub fn checked(&self, graph: &Graph, program: Draft) -> Result<Draft, Diagnostics> {
        let (count, most) = match program.instructions().iter().filter(|i| i.level == Level::Pixel).count() {
            pixel if pixel > LIMITS.instructions => (pixel, LIMITS.instructions),
            _ => (program.instructions().len(), LIMITS.nodes),
        };
        if graph.budget().is_spent() {
            return Err(self.spent(graph.budget()));
        }
        if graph.overflowed() {
            return Err(self.fault("limit", format!("the loop grows past {} distinct operations", LIMITS.nodes)));
        }
        if count > most {
            return Err(
                self.fault("limit", format!("the loop takes {count} instructions; at most {most} are compiled"))
            );
        }
        Ok(program)
    }
}
