//! `Movement`: parameters as formulas of time.

use std::collections::BTreeMap;

use isophote_symbolic::{Diagnostics, Formula, Model};

use crate::moving::formula_of_t;

/// Parameters that follow formulas of `t`, seconds since the first frame.
pub(crate) struct Movement {
    moved: Vec<(usize, String, Formula)>,
}

impl Movement {
    /// Parses the formulas. A fault names its parameter.
    pub fn parse(model: &Model, formulas: &BTreeMap<String, String>) -> Result<Movement, MovementFault> {
        let mut moved = Vec::new();
        for (name, text) in formulas {
            let Some(id) = model.parameter(name) else { return Err(MovementFault::UnknownName(name.clone())) };
            let formula =
                formula_of_t(text).map_err(|diagnostics| MovementFault::Formula { name: name.clone(), diagnostics })?;
            moved.push((id.index(), name.clone(), formula));
        }
        Ok(Movement { moved })
    }

    /// Writes the moved parameters at time `t_s`; an error names a parameter whose value is not finite.
    pub fn apply(&self, t_s: f64, parameters: &mut [f64]) -> Result<(), String> {
        for (index, name, formula) in &self.moved {
            let value = formula.evaluate(&[t_s]);
            if !value.is_finite() {
                return Err(format!("the motion of `{name}` is {value} at t = {t_s} s; it must be a finite number"));
            }
            parameters[*index] = value;
        }
        Ok(())
    }
}

/// Why a motion is invalid.
#[derive(Debug)]
pub(crate) enum MovementFault {
    /// No parameter has that name.
    UnknownName(String),
    /// The formula is wrong.
    Formula {
        /// Parameter with this formula.
        name: String,
        /// Parser diagnostics.
        diagnostics: Diagnostics,
    },
}
