//! Medians, the constants that relate them to normal noise, and χ².

/// Standard deviation over the median of magnitudes, for normal values about 0.
pub(crate) const DEVIATION_OF_MEDIAN: f64 = 1.4826;
/// Median of the squares over the variance, for the same: that of χ² with one degree of freedom.
pub(crate) const MEDIAN_SQUARE: f64 = 0.4549;

/// The median, the upper one of an even count; reorders the values. `None` if empty.
pub(crate) fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// The quantile of χ² at which a standard normal variable has its quantile `z` (Wilson and Hilferty's approximation).
pub(crate) fn chi_square(z: f64, freedom: usize) -> f64 {
    let n = freedom.max(1) as f64;
    let share = 2.0 / (9.0 * n);
    n * (1.0 - share + z * share.sqrt()).powi(3)
}

/// ln of the probability of a χ² above `x`; odd degrees of freedom are rounded up.
pub(crate) fn ln_chi_square_beyond(x: f64, freedom: usize) -> f64 {
    let half = 0.5 * x;
    let (mut term, mut sum) = (1.0, 1.0);
    for i in 1..freedom.max(1).div_ceil(2) {
        term *= half / i as f64;
        sum += term;
    }
    sum.ln() - half
}

/// The value that a χ² exceeds with this probability, at most 1600; odd degrees of freedom are rounded up.
pub(crate) fn chi_square_exceeded(probability: f64, freedom: usize) -> f64 {
    let (mut low, mut high) = (0.0, 1600.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if ln_chi_square_beyond(middle, freedom) > probability.ln() { low = middle } else { high = middle }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chi_square_quantiles_match_tables() {
        // 99 % of 2, 4 and 6 degrees of freedom; 99.9 % of 6.
        for (probability, freedom, square) in
            [(0.01, 2, 9.210), (0.01, 4, 13.277), (0.01, 6, 16.812), (0.001, 6, 22.458)]
        {
            let is = chi_square_exceeded(probability, freedom);
            assert!((is - square).abs() < 2e-3, "{probability} {freedom}: {is}");
        }
        assert_eq!(chi_square_exceeded(0.01, 5), chi_square_exceeded(0.01, 6), "odd ones are rounded up");
        // The normal quantile of 99 %.
        assert!((chi_square(2.326, 4) - 13.277).abs() < 0.03);
    }
}
