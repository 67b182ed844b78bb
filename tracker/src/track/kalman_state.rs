//! `KalmanState`: position and velocity of one coordinate, with their covariance; a Kalman filter's state.
//!
//! The acceleration is white noise of spectral density q, unit²/s³, so that over a time t (Bar-Shalom, Li and Kirubarajan,
//! *Estimation with Applications to Tracking and Navigation*, 2001, section 6.2.2)
//! ```text
//! p ← p + t v      Q = q [t³/3  t²/2]      a measurement:  z = p + e,  var e = r
//!                        [t²/2  t   ]
//! ```
//! Many short steps equal a long one. With noise that is constant through a step (t⁴/4, t³/2, t²) they do not, and precise
//! measurements drive the velocity's gain to 2/t, where the filter rings.

use serde::{Deserialize, Serialize};

use crate::solve::exact;

/// The state at one time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct KalmanState {
    /// px or mm.
    #[serde(with = "exact")]
    pub position: f64,
    /// px/s or mm/s.
    #[serde(with = "exact")]
    pub velocity: f64,
    #[serde(with = "exact")]
    pub variance: f64,
    #[serde(with = "exact")]
    pub covariance: f64,
    #[serde(with = "exact")]
    pub velocity_variance: f64,
}

impl KalmanState {
    /// A coordinate just seen; `speed`: the standard deviation of its velocity.
    pub fn new(position: f64, variance: f64, speed: f64) -> KalmanState {
        KalmanState { position, velocity: 0.0, variance, covariance: 0.0, velocity_variance: speed * speed }
    }

    /// The prediction `time_s` later, with acceleration of density `q`.
    pub fn after(&self, time_s: f64, q: f64) -> KalmanState {
        let (t, turned) = (time_s, time_s * self.velocity_variance);
        KalmanState {
            position: self.position + t * self.velocity,
            velocity: self.velocity,
            variance: self.variance + t * (2.0 * self.covariance + turned) + q * t.powi(3) / 3.0,
            covariance: self.covariance + turned + q * t * t / 2.0,
            velocity_variance: self.velocity_variance + q * t,
        }
    }

    /// The update with a measurement of variance `r`, in Joseph's form, which stays positive definite.
    pub fn updated(&self, position: f64, r: f64) -> KalmanState {
        let spread = self.variance + r;
        let (near, turn) = (self.variance / spread, self.covariance / spread);
        let (off, rest) = (position - self.position, 1.0 - near);
        KalmanState {
            position: self.position + near * off,
            velocity: self.velocity + turn * off,
            variance: rest * rest * self.variance + near * near * r,
            covariance: rest * (self.covariance - turn * self.variance) + near * turn * r,
            velocity_variance: self.velocity_variance - 2.0 * turn * self.covariance
                + turn * turn * (self.variance + r),
        }
    }

    /// The state after an impulse `ago_s` ago, which adds `variance` to the velocity.
    pub fn after_impulse(&self, variance: f64, ago_s: f64) -> KalmanState {
        KalmanState {
            variance: self.variance + variance * ago_s * ago_s,
            covariance: self.covariance + variance * ago_s,
            velocity_variance: self.velocity_variance + variance,
            ..*self
        }
    }

    /// The state with all variances scaled.
    pub fn inflated(&self, factor: f64) -> KalmanState {
        KalmanState {
            variance: factor * self.variance,
            covariance: factor * self.covariance,
            velocity_variance: factor * self.velocity_variance,
            ..*self
        }
    }
}
