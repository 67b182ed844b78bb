//! From a model to few per-pixel sums: the graph of its formulas, their derivatives, and how both are taken apart.
//!
//! What comes in: a checked model, a subset of its parameters, a method. What goes out: an
//! [`Objective`](objective::Objective), which is lowered to a program by [`crate::derive::schedule`].

pub(crate) mod absorb;
pub(crate) mod corrected;
pub(crate) mod cuts;
pub(crate) mod derivation;
pub(crate) mod derivatives;
pub(crate) mod domain;
pub(crate) mod entry;
pub(crate) mod expressions;
pub(crate) mod features;
pub(crate) mod jet;
pub(crate) mod joint;
pub(crate) mod likelihood;
pub(crate) mod monomial;
pub(crate) mod objective;
pub(crate) mod passes;
pub(crate) mod planes;
pub(crate) mod polynomials;
pub(crate) mod rank;
pub(crate) mod sample;
pub(crate) mod schedule;
pub(crate) mod search;
pub(crate) mod square;
pub(crate) mod steps;
pub(crate) mod sums;
pub(crate) mod terms;
pub(crate) mod variant;
pub(crate) mod whole_model;

use crate::language::model::{Lowering, Method, Model};
use crate::program::{ParameterId, Program};
use crate::proof::claim::{Part, ValueKind};
use isophote_syntax::diagnostic::Diagnostics;
use objective::Objective;
use planes::Prediction;

impl Model {
    /// F, its gradient and its Hessian for a subset of the parameters.
    pub fn objective(&self, subset: &[ParameterId], method: Method) -> Result<Objective, Diagnostics> {
        Objective::derive(self, subset, method)
    }
    /// Gradient or Hessian in a loop of its own, to compare with the joint loop; its programs are checked like any other.
    pub fn part_objective(&self, subset: &[ParameterId], method: Method, part: Part) -> Result<Objective, Diagnostics> {
        Objective::part(self, subset, method, part)
    }
    /// F alone.
    pub fn value_objective(&self, kind: ValueKind) -> Result<Objective, Diagnostics> {
        Objective::value(self, kind)
    }
    /// The program that adds the intensity (the entry of the model's first observation) to a plane, at coordinates plus
    /// their shifts.
    pub fn rendering(&self, lowering: Lowering) -> Result<Program, Diagnostics> {
        planes::rendering(self, lowering)
    }

    /// The program that adds what is predicted of each pixel to a plane. `None` for a variance that reads a channel.
    pub fn prediction(&self, what: Prediction, lowering: Lowering) -> Option<Result<Program, Diagnostics>> {
        planes::prediction(self, what, lowering)
    }
}
