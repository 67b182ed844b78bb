//! `Mover`: where a target will be, by one filter a coordinate.
//!
//! What comes in: the places of an estimate (centres in px, or the position of a pose in mm) with their covariance, and its
//! time. What goes out: the same at another time, with the covariance grown. It never knows a frame.
//!
//! Each coordinate is a [`Coordinate`] of its own, with levels of its own: a target that swings from side to side is still
//! at a fixed height. What one coordinate says of another is left out.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::coordinate::Coordinate;
use super::course::Course;
use crate::scaled::Definite;
use crate::solve::exact;

/// A model is never so right that a place is known better than this when one is compared with what was expected, px or mm.
const FLOOR: f64 = 0.02;
/// A measurement beyond this quantile of the standard normal is outside of the gate (one of 16,000 is).
const GATE_QUANTILE: f64 = 4.0;

/// Places with their covariance.
#[derive(Clone, Debug)]
pub(crate) struct Measured {
    pub values: DVector<f64>,
    pub covariance: DMatrix<f64>,
}

/// Places and velocities at a time.
#[derive(Clone, Debug)]
pub(crate) struct Predicted(Vec<Course>);

/// The filters of one target.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Mover {
    coordinates: Vec<Coordinate>,
    #[serde(with = "exact")]
    time_s: f64,
    /// Measurements so far.
    pub measurements: u32,
}

impl Predicted {
    /// The places, with the covariance of the prediction.
    pub fn places(&self) -> (DVector<f64>, DMatrix<f64>) {
        let values = self.0.iter().map(|course| course.position);
        let variances = self.0.iter().map(|course| course.variance);
        let n = self.0.len();
        (DVector::from_iterator(n, values), DMatrix::from_diagonal(&DVector::from_iterator(n, variances)))
    }

    /// The places alone.
    pub fn positions(&self) -> impl Iterator<Item = f64> {
        self.0.iter().map(|course| course.position)
    }

    /// Of a place, px or mm; 0 where there is no such place.
    pub fn deviation(&self, place: usize) -> f64 {
        self.0.get(place).map_or(0.0, |course| course.variance.sqrt())
    }

    /// Places and velocities, px and px/s or mm and mm/s, with their covariance.
    pub fn moving(&self) -> (DVector<f64>, DMatrix<f64>) {
        let n = self.0.len();
        let (mut state, mut covariance) = (DVector::zeros(2 * n), DMatrix::zeros(2 * n, 2 * n));
        for (i, course) in self.0.iter().enumerate() {
            (state[i], state[n + i]) = (course.position, course.velocity);
            covariance[(i, i)] = course.variance;
            covariance[(n + i, n + i)] = course.velocity_variance;
            (covariance[(i, n + i)], covariance[(n + i, i)]) = (course.covariance, course.covariance);
        }
        (state, covariance)
    }

    /// How far measured places lie from the predicted ones, `yᵀS⁻¹y` with S = P + R; `None` when S is singular.
    pub fn distance(&self, measured: &Measured) -> Option<f64> {
        let (mut innovation, mut spread) = (measured.values.clone(), measured.covariance.clone());
        for (i, course) in self.0.iter().enumerate() {
            innovation[i] -= course.position;
            spread[(i, i)] += course.variance + FLOOR * FLOOR;
        }
        Some(Definite::of(&spread)?.length(&innovation).powi(2))
    }

    /// True when the places lie where χ² says that they may.
    pub fn admits(&self, measured: &Measured) -> bool {
        self.distance(measured).is_some_and(|distance| distance <= gate(self.0.len()))
    }
}

/// The quantile of χ² with so many degrees of freedom (Wilson and Hilferty's approximation).
fn gate(freedom: usize) -> f64 {
    let n = freedom.max(1) as f64;
    let share = 2.0 / (9.0 * n);
    n * (1.0 - share + GATE_QUANTILE * share.sqrt()).powi(3)
}

impl Mover {
    /// A target just found. `q`: the density of its acceleration, unit²/s³; learned when absent.
    pub fn begin(measured: &Measured, time_s: f64, q: Option<f64>) -> Mover {
        let values = measured.values.iter().enumerate().map(|(i, value)| (value, measured.covariance[(i, i)]));
        let coordinates = values.map(|(value, variance)| Coordinate::begin(*value, variance, time_s, q)).collect();
        Mover { coordinates, time_s, measurements: 1 }
    }

    /// The same target somewhere else: it moves as it did, from there.
    pub fn begin_again(&mut self, measured: &Measured, time_s: f64) {
        for (i, coordinate) in self.coordinates.iter_mut().enumerate() {
            coordinate.begin_again(measured.values[i], measured.covariance[(i, i)], time_s);
        }
        (self.time_s, self.measurements) = (time_s, 1);
    }

    /// The state at a time, at or after the last measurement.
    pub fn predict(&self, time_s: f64) -> Predicted {
        Predicted(self.coordinates.iter().map(|coordinate| coordinate.predict(time_s)).collect())
    }

    /// Takes a measurement in.
    pub fn update(&mut self, measured: &Measured, time_s: f64) {
        for (i, coordinate) in self.coordinates.iter_mut().enumerate() {
            coordinate.update(measured.values[i], measured.covariance[(i, i)], time_s);
        }
        self.time_s = time_s;
        self.measurements += 1;
    }

    /// When the last measurement was.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// For each place whether predictions of it are no farther off than its last measurement.
    pub fn foresees(&self) -> impl Iterator<Item = bool> {
        self.coordinates.iter().map(Coordinate::foresees)
    }

    /// The motion of places that were these ones.
    pub fn of_places(&self, numbers: &[usize]) -> Option<Mover> {
        let coordinates = numbers.iter().map(|&number| self.coordinates.get(number).cloned());
        let coordinates: Vec<Coordinate> = coordinates.collect::<Option<_>>()?;
        let Mover { time_s, measurements, .. } = *self;
        (!coordinates.is_empty()).then_some(Mover { coordinates, time_s, measurements })
    }
}

#[cfg(test)]
#[path = "motion_tests.rs"]
mod tests;
