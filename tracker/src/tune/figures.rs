//! Statistics of sequences: quantiles, root mean squares, second differences.

/// The quantile `share` (0 … 1), linearly interpolated; `None` of an empty list.
pub fn quantile(values: &[f64], share: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let place = share.clamp(0.0, 1.0) * sorted.len().checked_sub(1)? as f64;
    let (below, part) = (place.floor() as usize, place.fract());
    let first = sorted[below];
    Some(first + part * (sorted.get(below + 1).copied().unwrap_or(first) - first))
}

/// The median; `None` of an empty list.
pub fn median(values: &[f64]) -> Option<f64> {
    quantile(values, 0.5)
}

/// √(mean of the squares); `None` of an empty list.
pub fn rms(values: &[f64]) -> Option<f64> {
    let count = values.len();
    (count > 0).then(|| (values.iter().map(|value| value * value).sum::<f64>() / count as f64).sqrt())
}

/// Lengths of the second differences `c(n−1) − 2 c(n) + c(n+1)` of a sequence of places, one for each three in a row that
/// are all known: 0 for uniform motion, √6 times the error of a coordinate for one of independent errors.
pub fn second_differences(places: &[Option<Vec<f64>>]) -> Vec<f64> {
    let length = |three: &[Option<Vec<f64>>]| match three {
        [Some(a), Some(b), Some(c)] => {
            let squares = a.iter().zip(b).zip(c).map(|((a, b), c)| (a - 2.0 * b + c).powi(2));
            Some(squares.sum::<f64>().sqrt())
        }
        _ => None,
    };
    places.windows(3).filter_map(length).collect()
}
