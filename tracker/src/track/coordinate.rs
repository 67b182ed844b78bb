//! `Coordinate`: where one coordinate of a target will be.
//!
//! What comes in: its measured positions with their variance, and their times. What goes out: a [`Course`] at another time,
//! and whether a fit had better begin there or at the last position. It never knows the other coordinates.

use serde::{Deserialize, Serialize};

use super::course::Course;
use super::levels::{Acceleration, Jitter};
use crate::solve::exact;

/// Velocity that is thought possible of a target just found, px/s or mm/s.
const SPEED: f64 = 1000.0;
/// A variance below this is rounding.
const VARIANCE_MIN: f64 = 1e-12;
/// An innovation beyond so many of its variances is a step: one of 60,000 is.
const STEP: f64 = 18.9;
/// The first measurements say nothing of steps, …
const SETTLED: u32 = 10;
/// … and steps that come so fast, s, are how the target moves.
const STEPS_APART_S: f64 = 0.5;
/// How fast a doubt goes that came with more jitter than was known, a frame.
const REASSURED: f64 = 0.98;
/// Errors of starts are averaged over so many frames.
const STARTS: f64 = 8.0;

/// The filter of one coordinate.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Coordinate {
    course: Course,
    #[serde(with = "exact")]
    time_s: f64,
    jitter: Jitter,
    acceleration: Acceleration,
    /// The jitter for which the course has its covariance.
    #[serde(with = "exact")]
    believed: f64,
    measurements: u32,
    /// Of the last step.
    #[serde(with = "exact")]
    struck_s: f64,
    /// The last measurement, and how far off predictions and last measurements were, squared.
    #[serde(with = "exact")]
    last: f64,
    #[serde(with = "exact")]
    predicted_off: f64,
    #[serde(with = "exact")]
    last_off: f64,
}

impl Coordinate {
    /// Of a place just found; `q`: the density of its acceleration, where that is given.
    pub fn begin(position: f64, variance: f64, time_s: f64, q: Option<f64>) -> Coordinate {
        Coordinate::begin_with_speed(position, variance, time_s, q, SPEED)
    }

    /// Of something just found; `speed`: the standard deviation of velocities that are thought possible.
    pub fn begin_with_speed(position: f64, variance: f64, time_s: f64, q: Option<f64>, speed: f64) -> Coordinate {
        let acceleration = q.map_or_else(Acceleration::unknown, Acceleration::Given);
        let mut jitter = Jitter::default();
        jitter.see(position, variance, 0.0);
        Coordinate {
            course: Course::begin(position, variance.max(VARIANCE_MIN), speed),
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

    /// Goes on from another place, of which nothing is known but the levels.
    pub fn begin_again(&mut self, position: f64, variance: f64, time_s: f64) {
        self.acceleration.forget();
        self.jitter.forget();
        self.jitter.see(position, variance, time_s - self.time_s);
        let variance = variance.max(VARIANCE_MIN);
        let course = Course::begin(position, variance + self.jitter.level(), SPEED);
        let (predicted_off, last_off, measurements) = (0.0, 0.0, 1);
        *self = Coordinate { course, time_s, last: position, predicted_off, last_off, measurements, ..self.clone() };
    }

    /// The state at a time, at or after the last measurement; the position's variance has the jitter of that time in it.
    pub fn predict(&self, time_s: f64) -> Course {
        let course = self.coming(time_s);
        Course { variance: course.variance + self.jitter.level(), ..course }
    }

    fn coming(&self, time_s: f64) -> Course {
        let step_s = (time_s - self.time_s).max(0.0);
        self.course.after(step_s, self.acceleration.over(step_s, self.jitter.level()))
    }

    /// Predictions have been no farther off than the last measurement was.
    pub fn foresees(&self) -> bool {
        self.predicted_off <= self.last_off
    }

    /// Takes a measurement in.
    pub fn update(&mut self, position: f64, variance: f64, time_s: f64) {
        let variance = variance.max(VARIANCE_MIN);
        let step_s = (time_s - self.time_s).max(0.0);
        let off = |from: f64| (position - from).powi(2);
        let coming = self.coming(time_s);
        if self.measurements > 1 {
            self.predicted_off += (off(coming.position) - self.predicted_off) / STARTS;
            self.last_off += (off(self.last) - self.last_off) / STARTS;
        }
        let strikes = |this: &Coordinate, coming: &Course| {
            let spread = coming.variance + variance + this.jitter.level();
            let square = off(coming.position);
            (square > STEP * spread && step_s > 0.0).then(|| (square - spread) / (step_s * step_s))
        };
        let is_apart = time_s - self.struck_s > STEPS_APART_S;
        if strikes(self, &coming).is_some() && self.measurements >= SETTLED && is_apart {
            self.acceleration.forget();
            self.jitter.forget();
        }
        self.jitter.see(position, variance, step_s);
        // More jitter than the course was computed with: it is less sure in proportion.
        let factor = self.jitter.with(self.jitter.level()) / self.jitter.with(self.believed);
        if factor > 1.0 {
            self.course = self.course.doubted(factor);
            self.acceleration.doubt(factor);
        }
        self.believed = self.jitter.level().max(REASSURED * self.believed);
        self.acceleration.see(position, variance, self.jitter.level(), time_s, &self.course);
        let mut coming = self.coming(time_s);
        if let Some(struck) = strikes(self, &coming) {
            coming = coming.struck(struck, step_s);
            self.struck_s = time_s;
        }
        self.course = coming.seeing(position, variance + self.jitter.level());
        (self.time_s, self.last) = (time_s, position);
        self.measurements += 1;
        if self.measurements > 2 {
            self.acceleration.launch(self.course, time_s);
        }
    }
}

#[cfg(test)]
#[path = "coordinate_tests.rs"]
mod tests;
