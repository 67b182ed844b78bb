//! Statistics of many trials.

use super::trial::{Outcome, Trial};

/// Shares of frames expected inside their ellipses.
pub const SHARES: [f64; 7] = [0.1, 0.3, 0.5, 0.7, 0.9, 0.95, 0.99];

/// Quantile of NEES, χ² with two degrees of freedom.
fn quantile(share: f64) -> f64 {
    -2.0 * (1.0 - share).ln()
}

/// Mean and standard deviation.
#[derive(Clone, Copy, Debug)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Standard deviation of a single value.
    pub deviation: f64,
    /// Number of values.
    pub count: usize,
}

impl Spread {
    /// Of these numbers; NaN if there are none.
    pub fn of(values: impl Iterator<Item = f64>) -> Spread {
        let values: Vec<f64> = values.collect();
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let square = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
        Spread { mean, deviation: square.sqrt(), count: values.len() }
    }

    /// Standard error of the mean.
    pub fn error(&self) -> f64 {
        self.deviation / (self.count as f64).sqrt()
    }
}

/// Summary of many frames.
#[derive(Clone, Debug)]
pub struct Summary {
    /// Frames.
    pub frames: usize,
    /// Share of failures: no answer, or an astray one.
    pub failed: f64,
    /// Share without an answer.
    pub silent: f64,
    /// RMSE of a coordinate of the centre, px, without failures.
    pub rmse_px: f64,
    /// Relative error of the longer semi-axis.
    pub size: Spread,
    /// Relative error of the brightness.
    pub brightness: Spread,
    /// NEES of the centre; 2 if consistent.
    pub nees: Spread,
    /// Shares of frames inside the ellipses of [`SHARES`].
    pub inside: [f64; SHARES.len()],
    /// Median χ²/ν.
    pub reduced: f64,
    /// Median time of one call, µs.
    pub time_us: f64,
}

impl Summary {
    /// Summarises all outcomes of a row.
    pub fn of(outcomes: &[Outcome]) -> Summary {
        let good: Vec<&Trial> = outcomes.iter().filter_map(|outcome| outcome.trial.as_ref()).collect();
        let frames = outcomes.len();
        let square: f64 = good.iter().map(|trial| trial.error.iter().map(|e| e * e).sum::<f64>()).sum();
        let nees: Vec<f64> = good.iter().filter_map(|trial| trial.nees).collect();
        let below = |share: f64| nees.iter().filter(|one| **one < quantile(share)).count() as f64 / nees.len() as f64;
        Summary {
            frames,
            failed: 1.0 - good.len() as f64 / frames as f64,
            silent: outcomes.iter().filter(|outcome| outcome.silent).count() as f64 / frames as f64,
            rmse_px: (square / (2 * good.len()) as f64).sqrt(),
            size: Spread::of(good.iter().map(|trial| trial.size)),
            brightness: Spread::of(good.iter().map(|trial| trial.brightness)),
            nees: Spread::of(nees.iter().copied()),
            inside: SHARES.map(below),
            reduced: median(good.iter().filter_map(|trial| trial.reduced)),
            time_us: median(outcomes.iter().map(|outcome| outcome.time_us)),
        }
    }
}

/// The median; NaN if there are no values.
pub fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut all: Vec<f64> = values.collect();
    all.sort_by(f64::total_cmp);
    all.get(all.len() / 2).copied().unwrap_or(f64::NAN)
}
