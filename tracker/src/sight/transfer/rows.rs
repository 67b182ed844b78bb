//! What rows are off by, from the pairs of a noise measurement.
//!
//! What comes in: differences of pixels, row by row. What goes out: the variance of rows' offsets, where there is some, and what
//! each row of each pair is off by. It never knows a brightness.
//!
//! The mean difference of a row varies by twice the variance of an offset, and by that of its pixels. What moves or flickers
//! does so in neighbouring rows alike, or ends at a few of them, so one row's mean less the next one's is what counts: its square,
//! as often as not, is that of four offsets.

use super::Pairs;

/// The square of a normal variable is less than this share of its variance as often as not, …
const MEDIAN: f64 = 0.455;
/// … and what that says of the variance scatters by so many times what the mean square does.
const SCATTER: f64 = 1.65;
/// Of so many standard deviations, offsets are there.
const THERE: f64 = 5.0;
/// Pixels that a row needs.
const PIXELS_MIN: usize = 16;

/// So many times the middle distance from the middle, a difference is none of noise: 4.5 standard deviations.
const FAR: f64 = 6.7;

/// What the differences of a row say.
#[derive(Clone, Copy, Default)]
pub(super) struct OfRow {
    count: f64,
    /// By how much the second one of a pair's rows is brighter, DN.
    pub mean: f64,
    /// Of the mean, by the scatter of the row's pixels.
    variance: f64,
    /// How many times as large differences from the mean would be if it were another row's.
    pub widened: f64,
}

impl OfRow {
    /// Without what is far off, since it moves.
    fn of(differences: &mut Vec<f64>) -> OfRow {
        let middle_of = |values: &mut Vec<f64>| {
            let middle = values.len() / 2;
            *values.select_nth_unstable_by(middle, f64::total_cmp).1
        };
        if differences.len() < PIXELS_MIN {
            return OfRow { widened: 1.0, ..OfRow::default() };
        }
        let middle = middle_of(differences);
        let mut distances = differences.iter().map(|value| (value - middle).abs()).collect();
        let far = FAR * middle_of(&mut distances).max(1.0); // values are steps
        differences.retain(|value| (value - middle).abs() <= far);
        let count = differences.len() as f64;
        let mean = differences.iter().sum::<f64>() / count;
        let squares = differences.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
        let freedom = (count - 1.0).max(1.0);
        OfRow { count, mean, variance: squares / (freedom * count), widened: (count / freedom).sqrt() }
    }
}

/// What rows are off by.
pub(super) struct RowNoise {
    /// Standard deviation, DN, and one standard deviation of that.
    pub deviation: [f64; 2],
    /// Those of each pair.
    pub rows: Vec<Vec<OfRow>>,
}

impl RowNoise {
    /// `None` where rows are off by nothing that can be told.
    pub fn of(pairs: &Pairs) -> Option<RowNoise> {
        let mut rows: Vec<Vec<OfRow>> = vec![Vec::new(); pairs.drifts.len()];
        let (mut at, mut differences) = ((0, 0), Vec::new());
        let mut end = |(pair, row): (usize, usize), differences: &mut Vec<f64>| {
            rows[pair].resize(row, OfRow::of(&mut Vec::new()));
            rows[pair].push(OfRow::of(differences));
            differences.clear();
        };
        pairs.each_of_row(|pair, row, _, _, difference| {
            if at != (pair, row) {
                end(at, &mut differences);
                at = (pair, row);
            }
            differences.push(difference);
        });
        end(at, &mut differences);
        let pairs = rows.iter().flat_map(|rows| rows.windows(2)).filter(|two| two.iter().all(|row| row.count > 0.0));
        let by_pixels = pairs.clone().map(|two| two[0].variance + two[1].variance).sum::<f64>();
        let mut steps: Vec<f64> = pairs.map(|two| (two[0].mean - two[1].mean).powi(2)).collect();
        if steps.is_empty() {
            return None;
        }
        let (count, middle) = (steps.len() as f64, steps.len() / 2);
        let by_pixels = by_pixels / count;
        let found = *steps.select_nth_unstable_by(middle, f64::total_cmp).1 / MEDIAN;
        // Neighbouring steps share a row, and neighbouring pairs a frame: each counts as half of one.
        let uncertain = SCATTER * (2.0 / (0.25 * count)).sqrt();
        if found - by_pixels <= THERE * uncertain * by_pixels {
            return None;
        }
        let variance = 0.25 * (found - by_pixels);
        let deviation = variance.sqrt();
        let sigma = 0.5 * uncertain * 0.25 * found / deviation;
        Some(RowNoise { deviation: [deviation, sigma], rows })
    }
}
