//! `MotionFilter`: predicts the positions of a target (centres in px, or the position of a pose in mm) with their
//! variance, by one [`Coordinate`] filter each.
//!
//! Each filter has noise levels of its own: a target that swings from side to side is still at a fixed height. Correlations
//! between coordinates are ignored.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::coordinate::Coordinate;
use super::kalman_state::KalmanState;
use crate::scaled::Definite;
use crate::solve::exact;
use crate::statistics::chi_square;

/// Least standard deviation of a measured position in comparisons with predictions, px or mm: no model is more accurate.
const FLOOR: f64 = 0.02;
/// The gate as a quantile of the standard normal: one measurement of some 60,000 is outside.
const GATE_QUANTILE: f64 = 4.0;

/// Measured positions with their covariance.
#[derive(Clone, Debug)]
pub(crate) struct Measured {
    pub values: DVector<f64>,
    pub covariance: DMatrix<f64>,
}

/// Predicted positions and velocities at a time.
#[derive(Clone, Debug)]
pub(crate) struct Predicted(Vec<KalmanState>);

/// The filters of one target.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct MotionFilter {
    coordinates: Vec<Coordinate>,
    #[serde(with = "exact")]
    time_s: f64,
    /// Measurements so far.
    pub measurements: u32,
}

impl Predicted {
    /// The positions, with the covariance of the prediction.
    pub fn positions_with_covariance(&self) -> (DVector<f64>, DMatrix<f64>) {
        let values = self.0.iter().map(|coordinate| coordinate.position);
        let variances = self.0.iter().map(|coordinate| coordinate.variance);
        let n = self.0.len();
        (DVector::from_iterator(n, values), DMatrix::from_diagonal(&DVector::from_iterator(n, variances)))
    }

    /// The positions alone.
    pub fn positions(&self) -> impl Iterator<Item = f64> {
        self.0.iter().map(|coordinate| coordinate.position)
    }

    /// Standard deviation of a position, px or mm; 0 without this position.
    pub fn deviation(&self, position: usize) -> f64 {
        self.0.get(position).map_or(0.0, |coordinate| coordinate.variance.sqrt())
    }

    /// Positions and velocities, px and px/s or mm and mm/s, with their covariance.
    pub fn state_with_covariance(&self) -> (DVector<f64>, DMatrix<f64>) {
        let n = self.0.len();
        let (mut state, mut covariance) = (DVector::zeros(2 * n), DMatrix::zeros(2 * n, 2 * n));
        for (i, coordinate) in self.0.iter().enumerate() {
            (state[i], state[n + i]) = (coordinate.position, coordinate.velocity);
            covariance[(i, i)] = coordinate.variance;
            covariance[(n + i, n + i)] = coordinate.velocity_variance;
            (covariance[(i, n + i)], covariance[(n + i, i)]) = (coordinate.covariance, coordinate.covariance);
        }
        (state, covariance)
    }

    /// The squared Mahalanobis distance of measured from predicted positions, `yᵀS⁻¹y` with S = P + R; `None` when S is singular.
    pub fn distance(&self, measured: &Measured) -> Option<f64> {
        let (mut innovation, mut spread) = (measured.values.clone(), measured.covariance.clone());
        for (i, coordinate) in self.0.iter().enumerate() {
            innovation[i] -= coordinate.position;
            spread[(i, i)] += coordinate.variance + FLOOR * FLOOR;
        }
        Some(Definite::of(&spread)?.length(&innovation).powi(2))
    }

    /// True when the distance is inside the χ² gate.
    pub fn admits(&self, measured: &Measured) -> bool {
        self.distance(measured).is_some_and(|distance| distance <= chi_square(GATE_QUANTILE, self.0.len()))
    }
}

impl MotionFilter {
    /// A target just found. `q`: the density of its acceleration, unit²/s³; learned when absent.
    pub fn new(measured: &Measured, time_s: f64, q: Option<f64>) -> MotionFilter {
        let values = measured.values.iter().enumerate().map(|(i, value)| (value, measured.covariance[(i, i)]));
        let coordinates = values.map(|(value, variance)| Coordinate::new(*value, variance, time_s, q)).collect();
        MotionFilter { coordinates, time_s, measurements: 1 }
    }

    /// Restarts the filters at another position; keeps only their levels.
    pub fn reset(&mut self, measured: &Measured, time_s: f64) {
        for (i, coordinate) in self.coordinates.iter_mut().enumerate() {
            coordinate.reset(measured.values[i], measured.covariance[(i, i)], time_s);
        }
        (self.time_s, self.measurements) = (time_s, 1);
    }

    /// The state at a time, at or after the last measurement.
    pub fn predict(&self, time_s: f64) -> Predicted {
        Predicted(self.coordinates.iter().map(|coordinate| coordinate.predict(time_s)).collect())
    }

    /// Adds a measurement.
    pub fn update(&mut self, measured: &Measured, time_s: f64) {
        for (i, coordinate) in self.coordinates.iter_mut().enumerate() {
            coordinate.update(measured.values[i], measured.covariance[(i, i)], time_s);
        }
        self.time_s = time_s;
        self.measurements += 1;
    }

    /// The time of the last measurement.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// For each position, whether predictions have been no farther off than the last measurement.
    pub fn predicts_well(&self) -> impl Iterator<Item = bool> {
        self.coordinates.iter().map(Coordinate::predicts_well)
    }

    /// The motion of a new model's positions: the numbers of the old ones; `None` if one is missing.
    pub fn of_positions(&self, numbers: &[usize]) -> Option<MotionFilter> {
        let coordinates = numbers.iter().map(|&number| self.coordinates.get(number).cloned());
        let coordinates: Vec<Coordinate> = coordinates.collect::<Option<_>>()?;
        let MotionFilter { time_s, measurements, .. } = *self;
        (!coordinates.is_empty()).then_some(MotionFilter { coordinates, time_s, measurements })
    }
}

#[cfg(test)]
#[path = "motion_tests.rs"]
mod tests;
