//! Significance of a fit's brightness against noise.
//!
//! A brightness that is significant by itself suffices. That of a small target is not, as long as its size is unknown, since both
//! are correlated. Then √(F₀ − F) counts, the square root of twice the log-likelihood ratio, with F₀ the objective without the
//! target and with the background refitted. In noise, F₀ − F is a χ² with as many degrees of freedom as the fit has parameters
//! beside the background, at each position where a target of its size could be. The limit is the value that noise exceeds
//! anywhere in hardly any frame.

use isophote_symbolic::{ParameterId, Roles};
use nalgebra::DMatrix;

use crate::outline::half_widths;
use crate::sight::cold::FALSE_ALARMS;
use crate::solve::fit::Fit;
use crate::statistics::chi_square_exceeded;

/// Frames that share the false alarms of one whole-frame search: a fading target is followed frame after frame, and so is noise
/// that is mistaken for it.
const FRAMES: f64 = 100.0;
/// A brightness of this many standard deviations is significant by itself.
pub(super) const SIGNIFICANT: f64 = 5.0;

/// True when a target is brighter than noise; `None` where its brightness is not fitted. `blank`: a factor on its variance, above 1
/// where residuals are smaller than the rounding of pixel values. `pixels`: the size of the fit's window.
pub(super) fn is_bright(order: &[ParameterId], fit: &Fit, roles: &Roles, blank: f64, pixels: usize) -> Option<bool> {
    let index_of = |parameter| order.iter().position(|&p| p == parameter);
    let (brightness, summary) = (index_of(roles.brightness?)?, fit.summary.as_ref()?);
    let height = fit.parameters[order[brightness].index()].abs();
    let (Some(covariance), Some(information)) = (&summary.covariance, &summary.information) else {
        return Some(height / (summary.variance_alone[brightness] * blank).sqrt() >= SIGNIFICANT);
    };
    if height / (covariance[(brightness, brightness)] * blank).sqrt() >= SIGNIFICANT {
        return Some(true);
    }
    let variance = variance_beside(information, brightness, roles.background.and_then(index_of));
    Some(variance > 0.0 && height / (variance * blank).sqrt() >= least(order, fit, roles, pixels))
}

/// The brightness of a target in standard deviations, for its position and size: the response of a filter that matches the
/// fit. `None` where it is not fitted.
pub(super) fn snr(order: &[ParameterId], fit: &Fit, roles: &Roles) -> Option<f64> {
    let index_of = |parameter| order.iter().position(|&p| p == parameter);
    let (brightness, summary) = (index_of(roles.brightness?)?, fit.summary.as_ref()?);
    let variance = match (&summary.covariance, &summary.information) {
        (Some(_), Some(information)) => variance_beside(information, brightness, roles.background.and_then(index_of)),
        _ => summary.variance_alone[brightness],
    };
    Some(fit.parameters[order[brightness].index()].abs() / variance.sqrt())
}

/// The variance of the brightness when only the background is unknown beside it.
fn variance_beside(information: &DMatrix<f64>, brightness: usize, background: Option<usize>) -> f64 {
    let shared = |other: usize| information[(brightness, other)].powi(2) / information[(other, other)];
    1.0 / (information[(brightness, brightness)] - background.map_or(0.0, shared))
}

/// The significance that is required of a fit in a window of `pixels`.
fn least(order: &[ParameterId], fit: &Fit, roles: &Roles, pixels: usize) -> f64 {
    let dimensions = roles.centre.len();
    let widths = half_widths(roles, dimensions, &fit.parameters);
    let volume = widths.map(|widths| widths.map(|width| 2.0 * width).product::<f64>());
    let cells = (pixels as f64 / volume.unwrap_or(1.0).max(1.0)).max(1.0);
    chi_square_exceeded(FALSE_ALARMS / (FRAMES * cells), order.len().saturating_sub(1)).sqrt()
}
