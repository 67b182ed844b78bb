//! Two noise levels of one coordinate, learned from innovations: the variance of its white [`Jitter`], and the density of its
//! white [`Acceleration`].
//!
//! The correlation of innovations separates them (Mehra, *On the identification of variances and adaptive Kalman filtering*,
//! IEEE Trans. AC-15, 1970). The innovations of the simplest predictor, the line through the last two measurements, are the
//! second differences `d_k = z_k − 2 z_(k−1) + z_(k−2)`. With white positions of variance r and acceleration of density q, and
//! Q = q t³,
//! ```text
//! E d_k² = 6 r + ⅔ Q        E d_k d_(k−1) = −4 r + Q/6
//! ```
//! so that the correlation from frame to frame is −⅔ for jitter, +¼ for acceleration, and 1 for lasting acceleration. Both
//! levels follow: `Q = (12 E d_k² + 18 E d_k d_(k−1))/11`, `r = (E d_k² − ⅔ Q)/6`.
//!
//! r is taken from there. q matters over many frames, and second differences of three frames hardly determine it. The error
//! of a prediction n frames ahead is the sum of the n innovations in between; if these are white, its variance grows as the
//! filter predicts, if correlated, faster. So predictions are stored and compared with the measurement one span later: the excess
//! of their squared errors over the variance predicted without acceleration is `q t³/3`. Lasting acceleration has a larger q
//! over longer spans, so each of several spans has its own.

use serde::{Deserialize, Serialize};

use super::kalman_state::KalmanState;
use crate::solve::exact;

/// Second differences in an average.
const DIFFERENCES: f64 = 100.0;
/// Largest ratio of the two intervals between three measurements.
const UNEVEN: f64 = 4.0;
/// Number of spans, each twice as long as the one before.
const SPANS: usize = 6;
/// The longest span, s.
const LONGEST_S: f64 = 0.5;
/// Pending predictions per span.
const LAUNCHES: usize = 4;
/// Time over which squared errors are averaged, s.
const MEMORY_S: f64 = 3.0;
/// Factor on the weight of squared errors above the average.
const ALARM: f64 = 2.0;
/// Excess of errors that is not yet acceleration, in standard deviations of their average.
const DOUBT: f64 = 1.0;
/// Upper limit of that excess, relative to the predicted variance.
const DOUBT_MAX: f64 = 0.5;
/// Predictions with a variance this many times that of the present filter are not evaluated.
const UNSURE: f64 = 9.0;

/// A running mean, exponentially weighted after the first values.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Mean {
    #[serde(with = "exact")]
    value: f64,
    #[serde(with = "exact")]
    count: f64,
}

impl Mean {
    fn take(&mut self, value: f64, of_last: f64) {
        self.count += 1.0;
        self.value += (value - self.value) / self.count.min(of_last);
    }
}

/// The variance of positions that is white from frame to frame, beyond that of the measurements.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Jitter {
    #[serde(with = "exact")]
    level: f64,
    /// The last measurement, and the one before it with the time between them, s.
    #[serde(with = "exact")]
    before: Option<(f64, Option<(f64, f64)>)>,
    /// d_k of the last frame.
    #[serde(with = "exact")]
    bend: Option<f64>,
    squares: Mean,
    products: Mean,
    /// Mean variance of the measurements.
    known: Mean,
}

impl Jitter {
    /// Adds a measurement, `step_s` after the last one.
    pub fn update(&mut self, position: f64, variance: f64, step_s: f64) {
        self.known.take(variance, DIFFERENCES);
        let bend = self.before.and_then(|(last, earlier)| {
            let (before, before_s) = earlier?;
            let ratio = Some(step_s / before_s).filter(|ratio| (UNEVEN.recip()..=UNEVEN).contains(ratio))?;
            // Scaled to the noise of equal intervals.
            let noise = 1.0 + (1.0 + ratio).powi(2) + ratio * ratio;
            Some((position - last - (last - before) * ratio) * (6.0 / noise).sqrt())
        });
        if let Some(now) = bend {
            self.squares.take(now * now, DIFFERENCES);
            if let Some(last) = self.bend {
                self.products.take(now * last, DIFFERENCES);
            }
        }
        self.bend = bend;
        self.before = Some((position, self.before.map(|(last, _)| (last, step_s))));
        if self.products.count > 0.0 {
            let (squares, products) = (self.squares.value, self.products.value);
            let accelerating = ((12.0 * squares + 18.0 * products) / 11.0).max(0.0);
            let white = (squares - accelerating * 2.0 / 3.0) / 6.0;
            let doubt = squares / 6.0 * (2.0 / self.squares.count.min(DIFFERENCES)).sqrt();
            let is_more = white > self.known.value + doubt;
            self.level = if is_more { white - self.known.value } else { 0.0 };
        }
    }

    /// Drops the last measurements; keeps the level.
    pub fn forget(&mut self) {
        (self.before, self.bend) = (None, None);
    }

    /// The jitter, unit².
    pub fn level(&self) -> f64 {
        self.level
    }

    /// The variance of a measured position with jitter of this level.
    pub fn with(&self, level: f64) -> f64 {
        level + self.known.value
    }
}

/// A pending prediction.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Launch {
    from: KalmanState,
    #[serde(with = "exact")]
    time_s: f64,
}

/// Errors of predictions over one span, in units of q: all divided by t³/3.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Span {
    launches: [Option<Launch>; LAUNCHES],
    #[serde(with = "exact")]
    square: f64,
    /// The variance predicted without jitter and acceleration.
    #[serde(with = "exact")]
    variance: f64,
    /// The increase of that variance per unit² of jitter.
    #[serde(with = "exact")]
    jitter: f64,
    #[serde(with = "exact")]
    count: f64,
}

impl Span {
    fn take(&mut self, square: f64, variance: f64, time_s: f64, span_s: f64) {
        let unit = 3.0 / time_s.powi(3);
        let [square, variance] = [square, variance].map(|one| one * unit);
        self.count += 1.0;
        let slow = span_s / (LAUNCHES as f64 * MEMORY_S);
        let weight = if square > self.square { ALARM * slow } else { slow };
        let weight = weight.max(self.count.recip()).min(1.0);
        self.square += weight * (square - self.square);
        self.variance += weight * (variance - self.variance);
        self.jitter += weight * (unit - self.jitter);
    }

    /// q; 0 unless significant.
    fn level(&self, jitter: f64, span_s: f64) -> f64 {
        let independent = (self.count / LAUNCHES as f64).min(MEMORY_S / span_s).max(0.5);
        let doubt = (DOUBT * (2.0 / independent).sqrt()).min(DOUBT_MAX);
        (self.square - (1.0 + doubt) * (self.variance + jitter * self.jitter)).max(0.0)
    }
}

/// The density of white acceleration, unit²/s³.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) enum Acceleration {
    /// Given by the options.
    Given(#[serde(with = "exact")] f64),
    /// Learned from errors of predictions.
    Learned(Box<Spans>),
}

/// The spans, the shortest first.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Spans([Span; SPANS]);

fn length_s(span: usize) -> f64 {
    LONGEST_S / f64::from(1_u32 << (SPANS - 1 - span))
}

impl Spans {
    fn levels(&self, jitter: f64) -> [f64; SPANS] {
        let mut levels: [f64; SPANS] = std::array::from_fn(|span| self.0[span].level(jitter, length_s(span)));
        // A longer prediction is no better than a shorter one.
        for span in 1..SPANS {
            levels[span] = levels[span].max(levels[span - 1] / 8.0);
        }
        // Spans too short to show acceleration take that of the first that does.
        let first = levels.iter().copied().find(|level| *level > 0.0).unwrap_or(0.0);
        levels.map(|level| if level > 0.0 { level } else { first })
    }
}

impl Acceleration {
    /// An acceleration to be learned.
    pub fn unknown() -> Acceleration {
        Acceleration::Learned(Box::default())
    }

    /// q for a prediction over this time.
    pub fn over(&self, time_s: f64, jitter: f64) -> f64 {
        let spans = match self {
            Acceleration::Given(q) => return *q,
            Acceleration::Learned(spans) => spans.levels(jitter),
        };
        let octave = (time_s / length_s(0)).log2().clamp(0.0, (SPANS - 1) as f64);
        let (low, part) = (octave as usize, octave.fract());
        let high = (low + 1).min(SPANS - 1);
        spans[low] * if spans[low] > 0.0 { (spans[high] / spans[low]).powf(part) } else { 0.0 }
    }

    /// Compares the predictions that are due with a measurement of this variance. `now`: the present filter state.
    pub fn update(&mut self, position: f64, variance: f64, jitter: f64, time_s: f64, now: &KalmanState) {
        let Acceleration::Learned(spans) = self else { return };
        for (number, span) in spans.0.iter_mut().enumerate() {
            let span_s = length_s(number);
            for slot in 0..LAUNCHES {
                let Some(Launch { from, time_s: then_s }) = span.launches[slot] else { continue };
                let gone_s = time_s - then_s;
                if gone_s < 0.999 * span_s {
                    continue;
                }
                span.launches[slot] = None;
                let ended = from.after(gone_s, 0.0);
                let could = now.after(gone_s, 0.0).variance + variance + jitter;
                if ended.variance + variance <= UNSURE * could {
                    span.take((position - ended.position).powi(2), ended.variance + variance, gone_s, span_s);
                }
            }
        }
    }

    /// Stores a prediction from `from` for each span where one is due.
    pub fn launch(&mut self, from: KalmanState, time_s: f64) {
        let Acceleration::Learned(spans) = self else { return };
        for (number, span) in spans.0.iter_mut().enumerate() {
            let last_s = span.launches.iter().flatten().map(|one| one.time_s).fold(f64::NEG_INFINITY, f64::max);
            let is_due = time_s - last_s >= 0.999 * length_s(number) / LAUNCHES as f64;
            if let Some(free) = span.launches.iter_mut().find(|one| one.is_none()).filter(|_| is_due) {
                *free = Some(Launch { from, time_s });
            }
        }
    }

    /// Scales the variance of pending predictions.
    pub fn doubt(&mut self, factor: f64) {
        let Acceleration::Learned(spans) = self else { return };
        for launch in spans.0.iter_mut().flat_map(|span| &mut span.launches).flatten() {
            launch.from = launch.from.inflated(factor);
        }
    }

    /// Drops pending predictions: their motion has ended.
    pub fn forget(&mut self) {
        let Acceleration::Learned(spans) = self else { return };
        spans.0.iter_mut().for_each(|span| span.launches = [None; LAUNCHES]);
    }
}
