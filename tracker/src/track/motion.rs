//! `Motion`: where a target will be, by a Kalman filter with constant velocity.
//!
//! What comes in: an estimate's centre and shape with their covariance, and its time. What goes out: both predicted to
//! another time, with the covariance grown. It never knows a frame.
//!
//! The state is (c, v, a): c the centre's coordinates, px; v their velocities, px/s; a the entries of A, which only drift.
//! Over a time step t, with σ the acceleration's standard deviation and q the drift of A,
//! ```text
//! c ← c + t v      Q_cc = σ² t⁴/4   Q_cv = σ² t³/2   Q_vv = σ² t²      Q_aa = (q a)² t
//! ```
//! and a measurement is the filter's usual one with R, the estimate's own covariance. σ is a number of the session's, or
//! follows the innovations: y'S⁻¹y over its number of coordinates is 1 on average when σ is right.

use nalgebra::{DMatrix, DVector};

/// Acceleration that is thought possible before anything has been seen, px/s².
const ACCELERATION_PX_S2: f64 = 2000.0;
/// σ stays between these, px/s².
const ACCELERATION_RANGE: [f64; 2] = [20.0, 1e7];
/// Velocity that is thought possible of a target just found, px/s.
const VELOCITY_PX_S: f64 = 1000.0;
/// Relative drift of A's entries in a second.
const DRIFT: f64 = 1.0;
/// A model is never so right that a centre is known better than this, px.
const FLOOR_PX: f64 = 0.02;
/// How fast σ follows the innovations: ln σ moves by this times (ratio − 1), which is 0 on average when σ is right.
const ADAPTION: f64 = 0.05;
/// One innovation counts for at most this ratio.
const RATIO_MAX: f64 = 30.0;
/// A measurement beyond this quantile of the standard normal is outside of the gate (one of 16,000 is).
const GATE_QUANTILE: f64 = 4.0;
/// Farther outside is no worse.
const EXCESS_MAX: f64 = 10.0;

/// A measurement: centre coordinates, then entries of A, with their covariance.
#[derive(Clone, Debug)]
pub(crate) struct Measured {
    /// How many of the values are coordinates.
    pub centres: usize,
    pub values: DVector<f64>,
    pub covariance: DMatrix<f64>,
}

/// Centre, velocity and shape at a time.
#[derive(Clone, Debug)]
pub(crate) struct Predicted {
    centres: usize,
    state: DVector<f64>,
    covariance: DMatrix<f64>,
}

/// The filter of one target.
#[derive(Clone, Debug)]
pub(crate) struct Motion {
    at: Predicted,
    time_s: f64,
    sigma_px_s2: f64,
    is_adaptive: bool,
    /// Measurements so far.
    pub measurements: u32,
}

impl Predicted {
    /// Rows of the state that a measurement sees.
    fn seen(&self) -> Vec<usize> {
        (0..self.centres).chain(2 * self.centres..self.state.len()).collect()
    }

    /// What would be measured, with the covariance of the prediction alone.
    pub fn measurable(&self) -> (DVector<f64>, DMatrix<f64>) {
        let seen = self.seen();
        let values = DVector::from_fn(seen.len(), |i, _| self.state[seen[i]]);
        (values, DMatrix::from_fn(seen.len(), seen.len(), |i, j| self.covariance[(seen[i], seen[j])]))
    }

    /// Centre and velocity, px and px/s, with their covariance.
    pub fn moving(&self) -> (DVector<f64>, DMatrix<f64>) {
        let n = 2 * self.centres;
        (self.state.rows(0, n).into_owned(), self.covariance.view((0, 0), (n, n)).into_owned())
    }

    /// After a time step, with process noise of σ px/s².
    fn after(&self, step_s: f64, sigma: f64) -> Predicted {
        let (n, c) = (self.state.len(), self.centres);
        let mut turn = DMatrix::identity(n, n);
        let mut next = DMatrix::zeros(n, n);
        for i in 0..c {
            turn[(i, c + i)] = step_s;
            let variance = sigma * sigma;
            next[(i, i)] = variance * step_s.powi(4) / 4.0;
            next[(i, c + i)] = variance * step_s.powi(3) / 2.0;
            next[(c + i, i)] = next[(i, c + i)];
            next[(c + i, c + i)] = variance * step_s * step_s;
        }
        // An entry of A off the diagonal may be 0, so all drift by the largest.
        let scale = self.state.rows(2 * c, n - 2 * c).amax();
        for i in 2 * c..n {
            next[(i, i)] = (DRIFT * scale).powi(2) * step_s;
        }
        next += &turn * &self.covariance * turn.transpose();
        Predicted { centres: c, state: &turn * &self.state, covariance: next }
    }

    /// How far a measured centre lies from the predicted one, `yᵀS⁻¹y` with S = P + R; `None` when S is singular.
    pub fn distance(&self, measured: &Measured) -> Option<f64> {
        let c = self.centres;
        let innovation = measured.values.rows(0, c) - self.state.rows(0, c);
        let spread = self.covariance.view((0, 0), (c, c)) + measured.covariance.view((0, 0), (c, c)) + floor(c);
        Some(innovation.dot(&spread.cholesky()?.solve(&innovation)))
    }

    /// By how many standard deviations a distance lies outside of the gate, a coordinate; 0 inside.
    pub fn excess((distance, centres): (f64, usize)) -> f64 {
        let n = centres.max(1) as f64;
        ((distance / n).sqrt() - (gate(centres) / n).sqrt()).clamp(0.0, EXCESS_MAX)
    }

    /// True when the centre lies where χ² says that it may.
    pub fn admits(&self, measured: &Measured) -> bool {
        self.distance(measured).is_some_and(|distance| distance <= gate(self.centres))
    }
}

fn floor(centres: usize) -> DMatrix<f64> {
    DMatrix::identity(centres, centres) * (FLOOR_PX * FLOOR_PX)
}

/// The quantile of χ² with so many degrees of freedom (Wilson and Hilferty's approximation).
fn gate(freedom: usize) -> f64 {
    let n = freedom.max(1) as f64;
    let share = 2.0 / (9.0 * n);
    n * (1.0 - share + GATE_QUANTILE * share.sqrt()).powi(3)
}

impl Motion {
    /// A target just found. `acceleration_px_s2`: the process noise; follows the innovations when absent.
    pub fn begin(measured: &Measured, time_s: f64, acceleration_px_s2: Option<f64>) -> Motion {
        let (c, slow) = (measured.centres, measured.values.len() - measured.centres);
        let n = 2 * c + slow;
        let mut at = Predicted { centres: c, state: DVector::zeros(n), covariance: DMatrix::zeros(n, n) };
        let seen = at.seen();
        for (i, &row) in seen.iter().enumerate() {
            at.state[row] = measured.values[i];
            for (j, &column) in seen.iter().enumerate() {
                at.covariance[(row, column)] = measured.covariance[(i, j)];
            }
        }
        for i in c..2 * c {
            at.covariance[(i, i)] = VELOCITY_PX_S * VELOCITY_PX_S;
        }
        let sigma_px_s2 = acceleration_px_s2.unwrap_or(ACCELERATION_PX_S2);
        Motion { at, time_s, sigma_px_s2, is_adaptive: acceleration_px_s2.is_none(), measurements: 1 }
    }

    /// The state at a time, at or after the last measurement.
    pub fn predict(&self, time_s: f64) -> Predicted {
        self.at.after((time_s - self.time_s).max(0.0), self.sigma_px_s2)
    }

    /// Takes a measurement in.
    pub fn update(&mut self, measured: &Measured, time_s: f64) {
        let predicted = self.predict(time_s);
        let (expected, spread) = predicted.measurable();
        let n = predicted.state.len();
        let seen = predicted.seen();
        let mut noise = measured.covariance.clone();
        let mut centres = noise.view_mut((0, 0), (measured.centres, measured.centres));
        centres += floor(measured.centres);
        let Some(factor) = (spread + &noise).cholesky() else {
            *self = Motion { measurements: self.measurements, ..Motion::begin(measured, time_s, self.fixed()) };
            return;
        };
        let innovation = &measured.values - expected;
        // K = P Hᵀ S⁻¹; H picks rows, so P Hᵀ are columns of P.
        let columns = DMatrix::from_fn(n, seen.len(), |i, j| predicted.covariance[(i, seen[j])]);
        let gain = factor.solve(&columns.transpose()).transpose();
        let state = &predicted.state + &gain * &innovation;
        // Joseph's form stays positive definite: (I − KH) P (I − KH)ᵀ + K R Kᵀ.
        let mut rest = DMatrix::identity(n, n);
        for (j, &row) in seen.iter().enumerate() {
            for i in 0..n {
                rest[(i, row)] -= gain[(i, j)];
            }
        }
        let covariance = &rest * &predicted.covariance * rest.transpose() + &gain * &noise * gain.transpose();
        if self.is_adaptive && self.measurements > 1 {
            let ratio = predicted.distance(measured).unwrap_or(1.0) / measured.centres.max(1) as f64;
            let [least, most] = ACCELERATION_RANGE;
            let factor = (ADAPTION * (ratio.min(RATIO_MAX) - 1.0)).exp();
            self.sigma_px_s2 = (self.sigma_px_s2 * factor).clamp(least, most);
        }
        self.at = Predicted { centres: predicted.centres, state, covariance };
        self.time_s = time_s;
        self.measurements += 1;
    }

    fn fixed(&self) -> Option<f64> {
        (!self.is_adaptive).then_some(self.sigma_px_s2)
    }

    /// When the last measurement was.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }
}

#[cfg(test)]
#[path = "motion_tests.rs"]
mod tests;
