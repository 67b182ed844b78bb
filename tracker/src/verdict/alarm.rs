//! How often noise alone is as significant as a fit.
//!
//! What comes in: a log-likelihood ratio. What goes out: an expected number. It never knows a picture.
//!
//! Of noise alone twice the log-likelihood ratio is a χ² of as many degrees of freedom as a fit has parameters beside the background,
//! at each of the places where a target of its size could have been.

/// ln of the number of places, of so many, at which noise has that log-likelihood ratio, twice, or a larger one.
pub(super) fn ln_expected(square: f64, freedom: usize, places: f64) -> f64 {
    places.max(1.0).ln() + ln_beyond(square, freedom)
}

/// ln of the probability of a χ² above `x`; of an odd number of degrees of freedom that of one more.
pub(crate) fn ln_beyond(x: f64, freedom: usize) -> f64 {
    let half = 0.5 * x;
    let (mut term, mut sum) = (1.0, 1.0);
    for i in 1..freedom.max(1).div_ceil(2) {
        term *= half / i as f64;
        sum += term;
    }
    sum.ln() - half
}
