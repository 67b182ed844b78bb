//! `Coordinate`: an adaptive Kalman filter that predicts one coordinate of a target as a [`KalmanState`], and compares
//! its predictions with the last measurement as starts of fits.

use serde::{Deserialize, Serialize};

use super::kalman_state::KalmanState;
use super::levels::{Acceleration, Jitter};
use crate::solve::exact;

/// Standard deviation of the velocity of a target just found, px/s or mm/s.
const SPEED: f64 = 1000.0;
/// Smallest variance of a measurement: less is rounding.
const VARIANCE_MIN: f64 = 1e-12;
/// A squared innovation beyond this many variances is a step (by chance one of 70,000 is).
const STEP: f64 = 18.9;
/// Steps are detected after this many measurements.
const STEP_MEASUREMENTS_MIN: u32 = 10;
/// Steps within this time of the last one, s, are part of the target's motion.
const STEPS_APART_S: f64 = 0.5;
/// Decay per frame of the jitter that the covariance of the state includes.
const REASSURED: f64 = 0.98;
/// Frames over which errors of starts are averaged.
const STARTS: f64 = 8.0;

/// The filter of one coordinate.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Coordinate {
    #[serde(rename = "course")]
    state: KalmanState,
    #[serde(with = "exact")]
    time_s: f64,
    jitter: Jitter,
    acceleration: Acceleration,
    /// The jitter that the covariance of the state includes.
    #[serde(with = "exact")]
    believed: f64,
    measurements: u32,
    /// Time of the last step, s.
    #[serde(with = "exact")]
    struck_s: f64,
    /// The last measurement.
    #[serde(with = "exact")]
    last: f64,
    /// Mean squared errors of predictions, and of the last measurement in their stead.
    #[serde(with = "exact")]
    predicted_off: f64,
    #[serde(with = "exact")]
    last_off: f64,
}

impl Coordinate {
    /// A coordinate just found; `q`: the density of its acceleration, where that is given.
    pub fn new(position: f64, variance: f64, time_s: f64, q: Option<f64>) -> Coordinate {
        Coordinate::with_speed(position, variance, time_s, q, SPEED)
    }

    /// The same; `speed`: the standard deviation of its velocity.
    pub fn with_speed(position: f64, variance: f64, time_s: f64, q: Option<f64>, speed: f64) -> Coordinate {
        let acceleration = q.map_or_else(Acceleration::unknown, Acceleration::Given);
        let mut jitter = Jitter::default();
        jitter.update(position, variance, 0.0);
        Coordinate {
            state: KalmanState::new(position, variance.max(VARIANCE_MIN), speed),
            time_s,
            jitter,
            acceleration,
            believed: 0.0,
            measurements: 1,
            struck_s: f64::NEG_INFINITY,
            last: position,
            predicted_off: 0.0,
            last_off: 0.0,
        }
    }

    /// Restarts at another position; keeps only the learned levels.
    pub fn reset(&mut self, position: f64, variance: f64, time_s: f64) {
        self.acceleration.forget();
        self.jitter.forget();
        self.jitter.update(position, variance, time_s - self.time_s);
        let variance = variance.max(VARIANCE_MIN);
        let state = KalmanState::new(position, variance + self.jitter.level(), SPEED);
        let (predicted_off, last_off, measurements) = (0.0, 0.0, 1);
        *self = Coordinate { state, time_s, last: position, predicted_off, last_off, measurements, ..self.clone() };
    }

    /// The state at a time, at or after the last measurement; the position's variance includes jitter.
    pub fn predict(&self, time_s: f64) -> KalmanState {
        let state = self.predicted_state(time_s);
        KalmanState { variance: state.variance + self.jitter.level(), ..state }
    }

    /// The mean squared error of the last position as an estimate of that at a later time.
    pub fn last_position_error(&self, time_s: f64) -> f64 {
        let state = self.predict(time_s);
        state.variance + (state.position - self.last).powi(2)
    }

    fn predicted_state(&self, time_s: f64) -> KalmanState {
        let step_s = (time_s - self.time_s).max(0.0);
        self.state.after(step_s, self.acceleration.over(step_s, self.jitter.level()))
    }

    /// True when predictions have been no farther off than the last measurement.
    pub fn predicts_well(&self) -> bool {
        self.predicted_off <= self.last_off
    }

    /// Adds a measurement.
    pub fn update(&mut self, position: f64, variance: f64, time_s: f64) {
        let variance = variance.max(VARIANCE_MIN);
        let step_s = (time_s - self.time_s).max(0.0);
        let off = |from: f64| (position - from).powi(2);
        let predicted_state = self.predicted_state(time_s);
        if self.measurements > 1 {
            self.predicted_off += (off(predicted_state.position) - self.predicted_off) / STARTS;
            self.last_off += (off(self.last) - self.last_off) / STARTS;
        }
        let strikes = |this: &Coordinate, predicted_state: &KalmanState| {
            let spread = predicted_state.variance + variance + this.jitter.level();
            let square = off(predicted_state.position);
            (square > STEP * spread && step_s > 0.0).then(|| (square - spread) / (step_s * step_s))
        };
        let is_apart = time_s - self.struck_s > STEPS_APART_S;
        if strikes(self, &predicted_state).is_some() && self.measurements >= STEP_MEASUREMENTS_MIN && is_apart {
            self.acceleration.forget();
            self.jitter.forget();
        }
        self.jitter.update(position, variance, step_s);
        // More jitter than the state includes: its variances grow in proportion.
        let factor = self.jitter.with(self.jitter.level()) / self.jitter.with(self.believed);
        if factor > 1.0 {
            self.state = self.state.inflated(factor);
            self.acceleration.doubt(factor);
        }
        self.believed = self.jitter.level().max(REASSURED * self.believed);
        self.acceleration.update(position, variance, self.jitter.level(), time_s, &self.state);
        let mut predicted_state = self.predicted_state(time_s);
        if let Some(after_impulse) = strikes(self, &predicted_state) {
            predicted_state = predicted_state.after_impulse(after_impulse, step_s);
            self.struck_s = time_s;
        }
        self.state = predicted_state.updated(position, variance + self.jitter.level());
        (self.time_s, self.last) = (time_s, position);
        self.measurements += 1;
        if self.measurements > 2 {
            self.acceleration.launch(self.state, time_s);
        }
    }
}

#[cfg(test)]
#[path = "coordinate_tests.rs"]
mod tests;
