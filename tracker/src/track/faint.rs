//! How bright is bright enough: whether a fit says more than noise would.
//!
//! What comes in: a fit, and how many places it could have ended at. What goes out: whether its brightness is believed. It never
//! knows a frame.
//!
//! A brightness that is sure by itself is enough. That of a small target is not, as long as its size is unknown: both pull in
//! opposite directions. Then its significance counts, √(F₀ − F), with F₀ the objective without the target and the background fitted anew: the square root of
//! twice the log-likelihood ratio. Of noise alone F₀ − F is a χ² of as many degrees of freedom as the fit has parameters beside
//! the background, at each of the places where a target of its size could have been. What noise exceeds anywhere in hardly any
//! frame is the least.

use isophote_symbolic::{ParameterId, Roles};

use crate::outline::half_widths;
use crate::sight::cold::FALSE_ALARMS;
use crate::solve::fit::Fit;
use crate::verdict::ln_beyond;

/// A target that is followed into the dark is looked for in frame after frame, and noise that is taken for it is followed in its
/// place: so many frames together are allowed what one whole-frame search is.
const FRAMES: f64 = 100.0;
/// No more is asked of any fit.
const MOST: f64 = 40.0;

/// A brightness that is known by itself to so many standard deviations is one, whatever else is unknown.
pub(super) const SIGNIFICANT: f64 = 5.0;

/// True when a target of the model is brighter than noise; `None` where its brightness is not fitted. `blank`: by how much less
/// its variance is than that of the rounding of pixels. The fit was in a window of so many pixels.
pub(super) fn is_bright(order: &[ParameterId], fit: &Fit, roles: &Roles, blank: f64, pixels: usize) -> Option<bool> {
    let place = |parameter| order.iter().position(|&p| p == parameter);
    let (brightness, worth) = (place(roles.brightness?)?, fit.worth.as_ref()?);
    let height = fit.parameters[order[brightness].index()].abs();
    let (Some(covariance), Some(information)) = (&worth.covariance, &worth.information) else {
        return Some(height / (worth.variance_alone[brightness] * blank).sqrt() >= SIGNIFICANT);
    };
    if height / (covariance[(brightness, brightness)] * blank).sqrt() >= SIGNIFICANT {
        return Some(true);
    }
    let background = roles.background.and_then(place);
    // Its variance when nothing but the background is unknown beside it.
    let shared = |other: usize| information[(brightness, other)].powi(2) / information[(other, other)];
    let variance = 1.0 / (information[(brightness, brightness)] - background.map_or(0.0, shared));
    Some(variance > 0.0 && height / (variance * blank).sqrt() >= least(order, fit, roles, pixels))
}

/// The least significance that is believed of a fit in a window of so many pixels.
fn least(order: &[ParameterId], fit: &Fit, roles: &Roles, pixels: usize) -> f64 {
    let dimensions = roles.centre.len();
    let widths = half_widths(roles, dimensions, &fit.parameters);
    let volume = widths.map(|widths| widths.map(|width| 2.0 * width).product::<f64>());
    let places = (pixels as f64 / volume.unwrap_or(1.0).max(1.0)).max(1.0);
    least_of(FALSE_ALARMS / (FRAMES * places), order.len().saturating_sub(1))
}

/// The square root of what a χ² exceeds with that probability.
fn least_of(probability: f64, freedom: usize) -> f64 {
    let (mut low, mut high) = (0.0, MOST);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if ln_beyond(middle * middle, freedom) > probability.ln() { low = middle } else { high = middle }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_chi_square_are_those_of_tables() {
        // 99 % of 2, 4 and 6 degrees of freedom; 99.9 % of 6.
        for (probability, freedom, square) in
            [(0.01, 2, 9.210), (0.01, 4, 13.277), (0.01, 6, 16.812), (0.001, 6, 22.458)]
        {
            let is = least_of(probability, freedom).powi(2);
            assert!((is - square).abs() < 2e-3, "{probability} {freedom}: {is}");
        }
        assert_eq!(least_of(0.01, 5), least_of(0.01, 6), "odd ones are rounded up");
    }
}
