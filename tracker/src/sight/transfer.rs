//! Measures a camera's gain (electrons per DN) and read noise, with standard errors, from frames of a static scene.
//!
//! This is the photon transfer of J. R. Janesick (*Photon Transfer*, SPIE 2007) and EMVA 1288: differences between two
//! frames of the same light are noise, and its variance grows linearly, `read² + signal/electrons_per_dn`, in DN².
//!
//! 1. Pixels of each pair of successive frames are sorted by their mean value. A flickering lamp makes a difference that is linear
//!    in brightness; it is subtracted first. So are row offsets, where rows differ by more than their pixels' noise.
//! 2. Half the mean square of the differences at one brightness is the variance there; outliers, such as a moving thing, are left
//!    out and counted.
//! 3. Noise of neighbouring pixels is independent. Where differences of neighbours are correlated, something moves that is too
//!    smooth to be an outlier; these brightnesses are left out.
//! 4. A line is fitted to the variances, weighted by their errors. Variances where values may be clipped, at zero or at the limit,
//!    or where rounding hides the noise, are not used.

use isophote_frame::Frame;
use isophote_jit::{PixelFormat, Window};

use self::rows::{RowNoise, RowStatistics};
use super::view;

mod rows;

/// Most frames used, the first ones.
const FRAMES_MAX: usize = 64;
/// Most bytes of frames; two frames are kept whatever their size.
const BYTES_MAX: usize = 512 * 1024 * 1024;
/// Steps of brightness.
const LEVELS: usize = 256;
/// Fewest pairs of pixels per step.
const PAIRS_MIN: f64 = 200.0;
/// Outlier limit of a pair's difference, in standard deviations.
const FAR: f64 = 4.5;
/// Distance from a limit at which no noise is clipped, in standard deviations.
const CLIPPED: f64 = 3.5;
/// Largest share of outliers in a static scene.
const MOVING_MAX: f64 = 0.05;
/// Least significance of the slope, in standard deviations.
const SLOPE_MIN: f64 = 5.0;
/// The variance of rounding to whole numbers, DN².
const ROUNDING: f64 = 1.0 / 12.0;
/// Least variance at which rounding adds like independent noise, DN².
const ROUNDED_MIN: f64 = 0.15;
/// Levels whose pixels are compared with their neighbours as one group.
const GROUP: usize = 16;
/// Largest correlation of neighbours, along both x and y, that counts as noise: variances may be too large by this share.
const CORRELATION_MAX: f64 = 0.03;

/// Prior knowledge of the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseOptions {
    /// The pixel value without light, DN.
    pub black: f64,
    /// The pixel value at which the sensor clips, DN; by default the format's largest.
    pub saturation: Option<f64>,
    /// Increase of the variance of rounding per DN: for linearised frames.
    pub rounding_gain: f64,
}

/// The result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredNoise {
    /// Electrons per DN, and its standard deviation.
    pub electrons_per_dn: [f64; 2],
    /// The read noise, electrons, without rounding, and its standard deviation; absent where it may be zero.
    pub read_noise_e: Option<[f64; 2]>,
    /// Upper limit of the read noise, at two standard deviations, electrons.
    pub read_noise_most_e: f64,
    /// The standard deviation of row offsets, electrons, and its own; absent where not significant.
    pub row_noise_e: Option<[f64; 2]>,
    /// Number of frames used.
    pub frames: usize,
    /// The darkest and the brightest value used, DN.
    pub range: [f64; 2],
    /// χ² of the line over its degrees of freedom.
    pub reduced_chi_square: f64,
    /// The share of pairs left out because they differ by more than noise.
    pub left_out: f64,
}

/// Why there is no answer.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoiseFault {
    /// See the text.
    #[error("there are {0} frame(s); noise is what differs between two and more")]
    FewFrames(usize),
    /// A frame unlike the first.
    #[error("frames of different sizes or planes: {0}, then {1}")]
    Unlike(String, String),
    /// See the text.
    #[error("the frames are all the same: they are copies, or were made without noise")]
    Silent,
    /// See the text.
    #[error(
        "{0:.0} % of the pixels differ by more than noise, or as their neighbours do: the scene or the camera moves, its light \
         flickers unevenly, or pixels were interpolated; take raw frames of a scene that stands still"
    )]
    Moving(f64),
    /// See the text.
    #[error(
        "values from {0:.1} to {1:.1} DN are too much alike to tell the light's noise from the sensor's; take frames of a scene \
         that is bright here and dark there, not saturated, or more frames"
    )]
    Narrow(f64, f64),
}

/// A measurement to which frames are added.
#[derive(Clone, Debug)]
pub struct NoiseMeasurement {
    options: NoiseOptions,
    kept: Vec<Frame>,
}

/// Pairs of one brightness.
#[derive(Clone, Copy, Debug, Default)]
struct Level {
    pairs: f64,
    means: f64,
    squares: f64,
    /// Outlier limit of differences, DN.
    limit: f64,
}

impl Level {
    fn mean(&self) -> f64 {
        self.means / self.pairs
    }

    /// The variance of one pixel, DN².
    fn variance(&self) -> f64 {
        0.5 * self.squares / self.pairs
    }
}

impl NoiseMeasurement {
    /// A measurement without frames.
    pub fn new(options: NoiseOptions) -> NoiseMeasurement {
        NoiseMeasurement { options, kept: Vec::new() }
    }

    /// Adds a frame; only the first ones are kept.
    ///
    /// # Errors
    /// When it differs in kind from the first.
    pub fn add(&mut self, frame: &Frame) -> Result<(), NoiseFault> {
        let describe = |frame: &Frame| {
            let sides: Vec<String> = frame.sides().iter().map(usize::to_string).collect();
            let format = frame.plane_view(0).format();
            format!("{} in {} plane(s) of {format:?}", sides.join(" × "), frame.planes().len())
        };
        if let Some(first) = self.kept.first() {
            let kind = |frame: &Frame| (frame.sides(), frame.planes().len(), frame.plane_view(0).format());
            if kind(first) != kind(frame) {
                return Err(NoiseFault::Unlike(describe(first), describe(frame)));
            }
        }
        if !self.is_full() {
            self.kept.push(frame.clone());
        }
        Ok(())
    }

    /// Whether further frames are ignored.
    pub fn is_full(&self) -> bool {
        let bytes = |frame: &Frame| frame.sides().iter().product::<usize>() * frame.planes().len() * 4;
        let capacity = |frame| (BYTES_MAX / bytes(frame).max(1)).clamp(2, FRAMES_MAX);
        self.kept.first().is_some_and(|first| self.kept.len() >= capacity(first))
    }

    /// The result from all frames.
    ///
    /// # Errors
    /// When they do not determine it.
    pub fn finish(self) -> Result<MeasuredNoise, NoiseFault> {
        if self.kept.len() < 2 {
            return Err(NoiseFault::FewFrames(self.kept.len()));
        }
        let mut pairs = Pairs::of(&self.kept, self.options.saturation);
        let rows = RowNoise::of(&pairs);
        let row_noise_dn = rows.as_ref().map(|rows| rows.deviation);
        pairs.rows = rows.map(|rows| rows.rows).unwrap_or_default();
        let mut levels = [Level { limit: f64::INFINITY, ..Level::default() }; LEVELS];
        // The first pass includes everything, the following ones exclude the outliers of the previous one.
        for _ in 0..4 {
            levels = pairs.levels(&levels);
        }
        let counted: f64 = levels.iter().map(|level| level.pairs).sum();
        if levels.iter().all(|level| level.squares == 0.0) {
            return Err(NoiseFault::Silent);
        }
        let is_moving = pairs.moving(&levels);
        let moving: f64 =
            levels.iter().zip(is_moving).map(|(level, moves)| if moves { level.pairs } else { 0.0 }).sum();
        let left_out = 1.0 - (counted - moving) / pairs.count.max(1.0);
        if left_out > MOVING_MAX {
            return Err(NoiseFault::Moving(100.0 * left_out));
        }
        let is_whole = |level: &Level| {
            let variance = level.variance();
            let reach = CLIPPED * variance.sqrt();
            level.pairs >= PAIRS_MIN
                && (!pairs.has_floor || level.mean() >= reach)
                && level.mean() + reach <= pairs.limit
                && (!pairs.is_rounded || variance >= ROUNDED_MIN)
        };
        let used: Vec<Level> = levels
            .into_iter()
            .zip(is_moving)
            .filter(|(level, moves)| is_whole(level) && !moves)
            .map(|(level, _)| level)
            .collect();
        let end = |level: Option<&Level>| level.map_or(self.options.black, Level::mean);
        let range = [end(used.first()), end(used.last())];
        let narrow = match moving > 0.0 {
            true => NoiseFault::Moving(100.0 * left_out),
            false => NoiseFault::Narrow(range[0], range[1]),
        };
        if used.len() < 3 {
            return Err(narrow);
        }
        let line = Line::through(&used, self.options.black);
        let [slope, slope_sigma] = [line.slope[0] - self.options.rounding_gain, line.slope[1]];
        if slope.is_nan() || slope < SLOPE_MIN * slope_sigma {
            return Err(narrow);
        }
        let electrons = 1.0 / slope;
        let [at_black, at_black_sigma] = line.at_black;
        let dark = at_black - if pairs.is_rounded { ROUNDING } else { 0.0 };
        let read_noise_e = (dark > at_black_sigma).then(|| {
            // Error of √dark/slope; the line's two parameters are correlated.
            let read_dn = dark.sqrt();
            let by_dark = 0.5 * electrons / read_dn;
            let by_slope = -read_dn * electrons * electrons;
            let variance = (by_dark * at_black_sigma).powi(2)
                + (by_slope * slope_sigma).powi(2)
                + 2.0 * by_dark * by_slope * line.covariance;
            [read_dn * electrons, variance.max(0.0).sqrt()]
        });
        Ok(MeasuredNoise {
            electrons_per_dn: [electrons, slope_sigma * electrons * electrons],
            read_noise_e,
            row_noise_e: row_noise_dn.map(|both| both.map(|value| value * electrons)),
            read_noise_most_e: (dark.max(0.0) + 2.0 * at_black_sigma).sqrt() * electrons,
            frames: self.kept.len(),
            range,
            reduced_chi_square: line.reduced_chi_square,
            left_out,
        })
    }
}

/// All pixels of all pairs of frames.
struct Pairs<'a> {
    frames: &'a [Frame],
    /// Values at and above it are clipped, DN.
    limit: f64,
    /// Values end at zero.
    has_floor: bool,
    /// Values are whole numbers.
    is_rounded: bool,
    /// Brightness of the darkest level, and the step between levels, DN.
    lowest: f64,
    step: f64,
    /// Brightness increase of each pair's second frame: at zero, and per DN.
    drifts: Vec<[f64; 2]>,
    /// Row offsets of each pair, where rows have them.
    rows: Vec<Vec<RowStatistics>>,
    /// Number of pairs of finite pixels below the limit.
    count: f64,
}

impl<'a> Pairs<'a> {
    fn of(frames: &'a [Frame], saturation: Option<f64>) -> Pairs<'a> {
        let format = frames.first().map(|frame| frame.plane_view(0).format());
        // By default the least limit of any frame: one clipped frame reveals it for all.
        let limit_of = |frame: &Frame| {
            let [width, height, ..] = frame.sides();
            let whole = Window::whole(width, height);
            let most = frame.largest.unwrap_or(f64::INFINITY);
            let seen = (0..frame.planes().len()).map(|plane| view::limit(&frame.plane_view(plane), whole, most));
            seen.fold(most, f64::min)
        };
        let limit = saturation.unwrap_or_else(|| frames.iter().map(limit_of).fold(f64::INFINITY, f64::min));
        let mut pairs = Pairs {
            frames,
            limit,
            has_floor: matches!(format, Some(PixelFormat::U8 | PixelFormat::U16)),
            is_rounded: true,
            lowest: 0.0,
            step: 0.0,
            drifts: vec![[0.0; 2]; frames.len() - 1],
            rows: Vec::new(),
            count: 0.0,
        };
        let (mut lowest, mut highest, mut is_rounded, mut count) = (f64::INFINITY, f64::NEG_INFINITY, true, 0.0);
        pairs.each(|_, _, mean, difference| {
            (lowest, highest, count) = (lowest.min(mean), highest.max(mean), count + 1.0);
            is_rounded &= difference.fract() == 0.0;
        });
        (pairs.is_rounded, pairs.count) = (is_rounded, count);
        (pairs.lowest, pairs.step) = (lowest, (highest - lowest).max(f64::MIN_POSITIVE) / LEVELS as f64);
        pairs.drifts = pairs.drifts();
        pairs
    }

    /// Calls `visit` with the pair, the pixel, the mean of two values and their difference, without drift and row offset.
    fn each(&self, mut visit: impl FnMut(usize, usize, f64, f64)) {
        self.each_of_row(|pair, row, pixel, mean, difference| {
            let of_row = self.rows.get(pair).and_then(|rows| rows.get(row));
            visit(pair, pixel, mean, of_row.map_or(difference, |row| row.widened * (difference - row.mean)));
        });
    }

    /// Like [`Pairs::each`], with the row after the pair, and with the row offset included.
    fn each_of_row(&self, mut visit: impl FnMut(usize, usize, usize, f64, f64)) {
        for (number, (two, [at_zero, slope])) in self.frames.windows(2).zip(&self.drifts).enumerate() {
            let [width, height, depth, length] = two[0].sides();
            let rows = height * depth * length;
            for plane in 0..two[0].planes().len() {
                let views = [two[0].plane_view(plane), two[1].plane_view(plane)];
                for pixel in 0..width * rows {
                    let (x, rest) = (pixel % width, pixel / width);
                    let (y, rest) = (rest % height, rest / height);
                    let [one, other] = [0, 1].map(|at| views[at].pixel_at([x, y, rest % depth, rest / depth]));
                    if one < self.limit && other < self.limit && one.is_finite() && other.is_finite() {
                        let mean = 0.5 * (one + other);
                        let row = plane * rows + pixel / width;
                        visit(number, row, pixel, mean, other - one - at_zero - slope * mean);
                    }
                }
            }
        }
    }

    fn level_of(&self, mean: f64) -> usize {
        (((mean - self.lowest) / self.step) as usize).min(LEVELS - 1)
    }

    /// Brightness increase of each pair's second frame: a line in brightness through the differences, without outliers.
    fn drifts(&self) -> Vec<[f64; 2]> {
        let mut sums = vec![[0.0; 2]; self.drifts.len()]; // count and Σ|d|: a first outlier limit
        self.each(|pair, _, _, difference| {
            sums[pair][0] += 1.0;
            sums[pair][1] += difference.abs();
        });
        let far: Vec<f64> = sums.iter().map(|sum| 1.25 * FAR * sum[1] / sum[0]).collect();
        let mut sums = vec![[0.0; 5]; self.drifts.len()];
        self.each(|pair, _, mean, difference| {
            if difference.abs() <= far[pair] {
                let terms = [1.0, mean, mean * mean, difference, mean * difference];
                sums[pair].iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
            }
        });
        let line = |[n, x, xx, y, xy]: [f64; 5]| {
            let spread = n * xx - x * x;
            // A single brightness has no slope.
            let slope = if spread > 1e-9 * n * xx { (n * xy - x * y) / spread } else { 0.0 };
            if n > 0.0 { [(y - slope * x) / n, slope] } else { [0.0; 2] }
        };
        sums.into_iter().map(line).collect()
    }

    /// The pairs by brightness, within the limits of `before`.
    fn levels(&self, before: &[Level; LEVELS]) -> [Level; LEVELS] {
        let mut levels = [Level::default(); LEVELS];
        self.each(|_, _, mean, difference| {
            let at = self.level_of(mean);
            if difference.abs() <= before[at].limit {
                let level = &mut levels[at];
                (level.pairs, level.means) = (level.pairs + 1.0, level.means + mean);
                level.squares += difference * difference;
            }
        });
        // A difference of one rounding step is never an outlier.
        let least = if self.is_rounded { 1.5 } else { 0.0 };
        for level in &mut levels {
            level.limit = (FAR * (level.squares / level.pairs.max(1.0)).sqrt()).max(least);
        }
        levels
    }
}

impl Pairs<'_> {
    /// Levels with pixel differences correlated between neighbours, both in rows and in columns.
    fn moving(&self, levels: &[Level; LEVELS]) -> [bool; LEVELS] {
        let width = self.frames.first().map_or(1, |frame| frame.sides()[0]);
        // The last pixel seen of each column: its index, and its difference in standard deviations.
        let mut above = vec![(usize::MAX, 0.0); width];
        let mut left = (usize::MAX, 0.0);
        let mut sums = [[0.0; 4]; LEVELS.div_ceil(GROUP)]; // sum and count of products along x, then along y
        self.each(|_, pixel, mean, difference| {
            let at = self.level_of(mean);
            let sigma = (levels[at].squares / levels[at].pairs.max(1.0)).sqrt();
            if sigma == 0.0 || difference.abs() > levels[at].limit {
                return;
            }
            let (x, deviation) = (pixel % width, difference / sigma);
            let sum = &mut sums[at / GROUP];
            if x > 0 && left.0 == pixel - 1 {
                (sum[0], sum[1]) = (sum[0] + left.1 * deviation, sum[1] + 1.0);
            }
            if pixel >= width && above[x].0 == pixel - width {
                (sum[2], sum[3]) = (sum[2] + above[x].1 * deviation, sum[3] + 1.0);
            }
            left = (pixel, deviation);
            above[x] = left;
        });
        let goes_together = |sum: f64, count: f64| sum > count * CORRELATION_MAX + 4.0 * count.sqrt();
        std::array::from_fn(|level| {
            let [x, across, y, down] = sums[level / GROUP];
            goes_together(x, across) && goes_together(y, down)
        })
    }
}

/// `variance = at_black + slope·(value − black)`, each with its standard deviation.
struct Line {
    at_black: [f64; 2],
    slope: [f64; 2],
    covariance: f64,
    reduced_chi_square: f64,
}

impl Line {
    fn through(levels: &[Level], black: f64) -> Line {
        let (mut at_black, mut slope) = (0.0, 0.0);
        let mut line = Line { at_black: [f64::NAN; 2], slope: [f64::NAN; 2], covariance: 0.0, reduced_chi_square: 0.0 };
        // The variance of a variance is 2 variance²/n for n differences; from the measured one at first, then from the
        // line. Pairs that share a frame are correlated by −1/2, which reduces their effective number by a third.
        for round in 0..4 {
            let [mut n, mut x, mut xx, mut y, mut xy] = [0.0; 5];
            let weight = |level: &Level| {
                let seen = level.variance();
                let expected = if round == 0 { seen } else { at_black + slope * (level.mean() - black) };
                level.pairs / (3.0 * expected.max(0.1 * seen).max(f64::MIN_POSITIVE).powi(2))
            };
            for level in levels {
                let (weight, value) = (weight(level), level.mean() - black);
                n += weight;
                x += weight * value;
                xx += weight * value * value;
                y += weight * level.variance();
                xy += weight * value * level.variance();
            }
            let misfit: f64 =
                levels.iter().map(|l| weight(l) * (l.variance() - at_black - slope * (l.mean() - black)).powi(2)).sum();
            let determinant = n * xx - x * x;
            (at_black, slope) = ((xx * y - x * xy) / determinant, (n * xy - x * y) / determinant);
            let chi_square = misfit / (levels.len() as f64 - 2.0).max(1.0);
            let scale = chi_square.max(1.0); // a bad fit widens the errors
            line = Line {
                at_black: [at_black, (scale * xx / determinant).sqrt()],
                slope: [slope, (scale * n / determinant).sqrt()],
                covariance: -scale * x / determinant,
                reduced_chi_square: chi_square,
            };
        }
        line
    }
}

#[cfg(test)]
#[path = "transfer_tests.rs"]
mod tests;
