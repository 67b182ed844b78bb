//! How much one coordinate shakes, and how much it accelerates: two levels, learned from innovations.
//!
//! What comes in: measured positions with their variance, and what was predicted. What goes out: a variance of the position
//! that is white from frame to frame ([`Jitter`]), and a density of white acceleration ([`Acceleration`]). It never knows
//! what they are used for.
//!
//! **What tells them apart** is the correlation of innovations (Mehra, *On the identification of variances and adaptive
//! Kalman filtering*, IEEE Trans. AC-15, 1970). The innovations of the simplest predictor, the line through the last two
//! measurements, are the second differences `d_k = z_k − 2 z_(k−1) + z_(k−2)`. With white positions of variance r and
//! acceleration of density q, and Q = q t³,
//! ```text
//! E d_k² = 6 r + ⅔ Q        E d_k d_(k−1) = −4 r + Q/6
//! ```
//! so that jitter has a correlation of −⅔ from frame to frame, acceleration one of +¼, and acceleration that lasts one of 1.
//! Both levels follow: `Q = (12 E d_k² + 18 E d_k d_(k−1))/11`, `r = (E d_k² − ⅔ Q)/6`.
//!
//! r is taken from there. q matters over many frames, where a second difference of three of them says little. The error of a
//! prediction n frames ahead is a sum of the n innovations in between; where they are white its variance grows as the
//! filter says, where they are correlated it grows faster. So predictions are kept and compared with what was seen a span
//! later: what their squared errors have beyond the variance that was predicted without acceleration is `q t³/3`. An
//! acceleration that lasts has a larger q over a longer span, which is why there is one for each of several spans.

use serde::{Deserialize, Serialize};

use super::course::Course;
use crate::solve::exact;

/// Second differences that are averaged over.
const DIFFERENCES: f64 = 100.0;
/// Times between three measurements may differ by this factor.
const UNEVEN: f64 = 4.0;
/// Spans, each twice as long as the one before, …
const SPANS: usize = 6;
/// … to this one, s.
const LONGEST_S: f64 = 0.5;
/// Predictions on their way, for each span.
const LAUNCHES: usize = 4;
/// Squared errors are averaged over such a time, s; …
const MEMORY_S: f64 = 3.0;
/// … what is larger than the average counts for more.
const ALARM: f64 = 2.0;
/// Errors may exceed what was predicted by so many of the average's standard deviations, and by no more than this share,
/// before there is acceleration.
const DOUBT: f64 = 1.0;
const DOUBT_MAX: f64 = 0.5;
/// A prediction from when so many times less was known teaches nothing.
const UNSURE: f64 = 9.0;

/// An average that becomes one of the last values.
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

/// The variance of positions that are white from frame to frame, beyond that of the measurements.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Jitter {
    #[serde(with = "exact")]
    level: f64,
    /// The last measurements, the later one first, and the time between them.
    #[serde(with = "exact")]
    before: Option<(f64, Option<(f64, f64)>)>,
    /// d of the last frame.
    #[serde(with = "exact")]
    bend: Option<f64>,
    squares: Mean,
    products: Mean,
    /// Variance of the measurements.
    known: Mean,
}

impl Jitter {
    /// A measurement, `step_s` after the last one.
    pub fn see(&mut self, position: f64, variance: f64, step_s: f64) {
        self.known.take(variance, DIFFERENCES);
        let bend = self.before.and_then(|(last, earlier)| {
            let (before, before_s) = earlier?;
            let ratio = Some(step_s / before_s).filter(|ratio| (UNEVEN.recip()..=UNEVEN).contains(ratio))?;
            // Scaled to the noise of even steps.
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

    /// What follows has nothing to do with what was.
    pub fn forget(&mut self) {
        (self.before, self.bend) = (None, None);
    }

    /// unit².
    pub fn level(&self) -> f64 {
        self.level
    }

    /// The variance of a measured position with jitter of such a level.
    pub fn with(&self, level: f64) -> f64 {
        level + self.known.value
    }
}

/// A prediction on its way.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Launch {
    from: Course,
    #[serde(with = "exact")]
    time_s: f64,
}

/// What predictions over one span are worth, in units of q: all divided by t³/3.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Span {
    launches: [Option<Launch>; LAUNCHES],
    #[serde(with = "exact")]
    square: f64,
    /// The variance that was predicted without jitter and acceleration.
    #[serde(with = "exact")]
    variance: f64,
    /// What jitter of 1 unit² adds to that.
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

    /// q, where it shows.
    fn level(&self, jitter: f64, span_s: f64) -> f64 {
        let independent = (self.count / LAUNCHES as f64).min(MEMORY_S / span_s).max(0.5);
        let doubt = (DOUBT * (2.0 / independent).sqrt()).min(DOUBT_MAX);
        (self.square - (1.0 + doubt) * (self.variance + jitter * self.jitter)).max(0.0)
    }
}

/// The density of white acceleration, unit²/s³.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) enum Acceleration {
    /// By whoever knows it.
    Given(#[serde(with = "exact")] f64),
    /// From errors of predictions.
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
        // A longer prediction is not better than a shorter one …
        for span in 1..SPANS {
            levels[span] = levels[span].max(levels[span - 1] / 8.0);
        }
        // … and over spans that are too short to show acceleration it is that of the first that does.
        let first = levels.iter().copied().find(|level| *level > 0.0).unwrap_or(0.0);
        levels.map(|level| if level > 0.0 { level } else { first })
    }
}

impl Acceleration {
    /// To be learned.
    pub fn unknown() -> Acceleration {
        Acceleration::Learned(Box::default())
    }

    /// q for a prediction over that time.
    pub fn over(&self, time_s: f64, jitter: f64) -> f64 {
        let spans = match self {
            Acceleration::Given(q) => return *q,
            Acceleration::Learned(spans) => spans.levels(jitter),
        };
        let place = (time_s / length_s(0)).log2().clamp(0.0, (SPANS - 1) as f64);
        let (low, part) = (place as usize, place.fract());
        let high = (low + 1).min(SPANS - 1);
        spans[low] * if spans[low] > 0.0 { (spans[high] / spans[low]).powf(part) } else { 0.0 }
    }

    /// A measurement of that variance: predictions that have come to their end are compared with it. `now`: what is known.
    pub fn see(&mut self, position: f64, variance: f64, jitter: f64, time_s: f64, now: &Course) {
        let Acceleration::Learned(spans) = self else { return };
        for (number, span) in spans.0.iter_mut().enumerate() {
            let span_s = length_s(number);
            for place in 0..LAUNCHES {
                let Some(Launch { from, time_s: then_s }) = span.launches[place] else { continue };
                let gone_s = time_s - then_s;
                if gone_s < 0.999 * span_s {
                    continue;
                }
                span.launches[place] = None;
                let ended = from.after(gone_s, 0.0);
                let could = now.after(gone_s, 0.0).variance + variance + jitter;
                if ended.variance + variance <= UNSURE * could {
                    span.take((position - ended.position).powi(2), ended.variance + variance, gone_s, span_s);
                }
            }
        }
    }

    /// Predictions from here on will be compared.
    pub fn launch(&mut self, from: Course, time_s: f64) {
        let Acceleration::Learned(spans) = self else { return };
        for (number, span) in spans.0.iter_mut().enumerate() {
            let last_s = span.launches.iter().flatten().map(|one| one.time_s).fold(f64::NEG_INFINITY, f64::max);
            let is_due = time_s - last_s >= 0.999 * length_s(number) / LAUNCHES as f64;
            if let Some(free) = span.launches.iter_mut().find(|one| one.is_none()).filter(|_| is_due) {
                *free = Some(Launch { from, time_s });
            }
        }
    }

    /// Predictions that are on their way were made with a variance too small by that factor.
    pub fn doubt(&mut self, factor: f64) {
        let Acceleration::Learned(spans) = self else { return };
        for launch in spans.0.iter_mut().flat_map(|span| &mut span.launches).flatten() {
            launch.from = launch.from.doubted(factor);
        }
    }

    /// Predictions that are on their way do not count: the motion that they go on with has ended.
    pub fn forget(&mut self) {
        let Acceleration::Learned(spans) = self else { return };
        spans.0.iter_mut().for_each(|span| span.launches = [None; LAUNCHES]);
    }
}
