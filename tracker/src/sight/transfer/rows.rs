//! Row offsets in the pairs of a noise measurement, and their variance where it is significant.
//!
//! The mean difference of a row varies by twice the variance of an offset, plus that of its pixels. Motion and flicker
//! affect neighbouring rows alike, or end at a few of them, so the measure is the difference of adjacent row means: its
//! median square corresponds to four offset variances.

use super::Pairs;
use crate::statistics::{MEDIAN_SQUARE, median};

/// Scatter of the variance from the median relative to that from the mean square.
const SCATTER: f64 = 1.65;
/// Significance of offsets in standard deviations.
const THERE: f64 = 5.0;
/// Fewest pixels of a row.
const PIXELS_MIN: usize = 16;

/// Outlier limit in median absolute deviations: 4.5 standard deviations.
const FAR: f64 = 6.7;

/// Statistics of a row's differences.
#[derive(Clone, Copy, Default)]
pub(super) struct RowStatistics {
    count: f64,
    /// Brightness increase of the pair's second row, DN.
    pub mean: f64,
    /// Variance of the mean, from the scatter of the row's pixels.
    variance: f64,
    /// Factor that restores the scatter reduced by subtracting the row's own mean.
    pub widened: f64,
}

impl RowStatistics {
    /// Statistics without outliers, which move.
    fn of(differences: &mut Vec<f64>) -> RowStatistics {
        let Some(middle) = median(differences).filter(|_| differences.len() >= PIXELS_MIN) else {
            return RowStatistics { widened: 1.0, ..RowStatistics::default() };
        };
        let mut distances: Vec<f64> = differences.iter().map(|value| (value - middle).abs()).collect();
        let far = FAR * median(&mut distances).unwrap_or(0.0).max(1.0); // values are steps
        differences.retain(|value| (value - middle).abs() <= far);
        let count = differences.len() as f64;
        let mean = differences.iter().sum::<f64>() / count;
        let squares = differences.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
        let freedom = (count - 1.0).max(1.0);
        RowStatistics { count, mean, variance: squares / (freedom * count), widened: (count / freedom).sqrt() }
    }
}

/// The row noise.
pub(super) struct RowNoise {
    /// Standard deviation of the offsets, DN, and its own.
    pub deviation: [f64; 2],
    /// The rows of each pair.
    pub rows: Vec<Vec<RowStatistics>>,
}

impl RowNoise {
    /// `None` where offsets are not significant.
    pub fn of(pairs: &Pairs) -> Option<RowNoise> {
        let mut rows: Vec<Vec<RowStatistics>> = vec![Vec::new(); pairs.drifts.len()];
        let (mut at, mut differences) = ((0, 0), Vec::new());
        let mut end = |(pair, row): (usize, usize), differences: &mut Vec<f64>| {
            rows[pair].resize(row, RowStatistics::of(&mut Vec::new()));
            rows[pair].push(RowStatistics::of(differences));
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
        let count = steps.len() as f64;
        let found = median(&mut steps)? / MEDIAN_SQUARE;
        let by_pixels = by_pixels / count;
        // Adjacent steps share a row, and successive pairs a frame: each halves the effective number.
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
