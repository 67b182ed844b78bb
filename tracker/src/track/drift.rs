//! `Drift`: the growth of the variances of sizes, angles and brightnesses (all parameters but positions) while a target is unseen.
//! Values are not predicted.

use isophote_symbolic::ParameterId;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::coordinate::Coordinate;
use super::shared::position_parameters;
use super::solver::Solver;
use crate::solve::exact;

/// A definition: the standard deviation of a new target's change in a second, relative to its size or brightness, or as a
/// Rodrigues parameter.
const RATE: f64 = 1.0;

/// One filter per parameter, in the order of the last stage.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Drift(Vec<Row>);

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Row {
    /// Row of the covariance.
    row: usize,
    /// Unit of the filtered values.
    #[serde(with = "exact")]
    scale: f64,
    value: Coordinate,
}

impl Drift {
    /// Adds a fit.
    pub fn update(&mut self, solver: &Solver, parameters: &[f64], covariance: &DMatrix<f64>, time_s: f64) {
        let order = solver.compiled.last_parameters();
        if self.0.is_empty() {
            let free = order
                .iter()
                .enumerate()
                .filter(|(_, id)| position_parameters(solver.model()).all(|position| position != *id));
            let new_row = |(row, id)| {
                let (scale, variance) = (scale(solver, id, parameters), covariance[(row, row)]);
                let scale = scale.max(variance.sqrt());
                let at = parameters[id.index()] / scale;
                let value = Coordinate::with_speed(at, variance / (scale * scale), time_s, None, RATE);
                (scale > 0.0 && scale.is_finite()).then_some(Row { row, scale, value })
            };
            self.0 = free.filter_map(new_row).collect();
            return;
        }
        for Row { row, scale, value } in &mut self.0 {
            let at = parameters[order[*row].index()] / *scale;
            value.update(at, covariance[(*row, *row)] / (*scale * *scale), time_s);
        }
    }

    /// Rows of the covariance, with the growth of the variance of each parameter's last value from a time to a later one.
    pub fn grown(&self, from_s: f64, to_s: f64) -> impl Iterator<Item = (usize, f64)> {
        let grown = move |value: &Coordinate| value.last_position_error(to_s) - value.last_position_error(from_s);
        self.0.iter().map(move |Row { row, scale, value }| (*row, grown(value) * scale * scale))
    }
}

/// The magnitude of a parameter: of a shape, that of its largest entry, as one off the diagonal may be 0; 1 for a Rodrigues one.
fn scale(solver: &Solver, id: &ParameterId, parameters: &[f64]) -> f64 {
    let roles = solver.model().roles();
    if roles.iter().any(|roles| roles.orientation.contains(id)) {
        return 1.0;
    }
    let shape = roles.iter().map(|roles| &roles.shape).find(|shape| shape.contains(id));
    let alike = shape.map_or(std::slice::from_ref(id), |shape| shape);
    alike.iter().map(|id| parameters[id.index()].abs()).fold(0.0, f64::max)
}
