//! Which pixels a model does not describe. A pixel is the model's, or with a small probability it holds any value between the
//! darkest and the limit (a mixture with a uniform distribution); neighbours are likely to be of one kind.
//!
//! What comes in: residuals. What goes out: a mask, and how much light it leaves out. It never knows a fit.
//!
//! The mask is the mode of the posterior, by iterated conditional modes (J. Besag, "On the statistical analysis of dirty
//! pictures", J. R. Statist. Soc. B 48, 1986): hard assignments in the expectation step of an expectation–maximisation.

use std::f64::consts::TAU;

use isophote_jit::Window;

use crate::estimate::OUTLIERS;
use crate::solve::residuals::{Residual, Seen};

/// A budget: nearly all masks are settled after four sweeps.
const SWEEPS: usize = 8;
/// Units of a frame's budget that a pixel costs: what most masks take.
pub(crate) const WORK: usize = 8;

/// For each pixel of a window whether it is an outlier, where noise is `scale` times what the model states.
pub(crate) fn outliers(seen: &[Seen], window: Window, scale: f64) -> Vec<bool> {
    // ln of p(pixel | outlier) / p(pixel | model); NaN without a value.
    let mut evidence = vec![f64::NAN; window.pixels()];
    for one in seen {
        let range = range(one);
        for residual in &one.residuals {
            let own = 0.5 * (residual.whitened / scale).powi(2) + (residual.deviation * TAU.sqrt() / range).ln();
            let before = evidence[residual.pixel];
            evidence[residual.pixel] = if before.is_nan() { own } else { before + own };
        }
    }
    let (width, height) = (window.width, window.height);
    // Starts with every pixel whose own value speaks for an outlier: small residuals beside each other support one another.
    let mut mask: Vec<bool> = evidence.iter().map(|evidence| *evidence > 0.0).collect();
    for _ in 0..SWEEPS {
        let mut is_settled = true;
        for pixel in (0..evidence.len()).filter(|pixel| !evidence[*pixel].is_nan()) {
            let (x, y) = (pixel % width, pixel / width);
            // One pseudo-observation of the prior stands beside the neighbours: where noise is a hundredth of the range, a lone
            // pixel is an outlier from 4.2 standard deviations on, one beside a straight edge from 3.0.
            let (mut count, mut alike) = (1.0, OUTLIERS);
            for row in y.saturating_sub(1)..(y + 2).min(height) {
                for other in (x.saturating_sub(1)..(x + 2).min(width)).map(|column| row * width + column) {
                    if other != pixel && !evidence[other].is_nan() {
                        (count, alike) = (count + 1.0, alike + f64::from(u8::from(mask[other])));
                    }
                }
            }
            let is_outlier = evidence[pixel] + (alike / (count - alike)).ln() > 0.0;
            is_settled &= is_outlier == mask[pixel];
            mask[pixel] = is_outlier;
        }
        if is_settled {
            break;
        }
    }
    mask
}

/// From the darkest value to the limit, or to the brightest value where nothing clips: of values that a neighbour reaches as well, so
/// that one pixel alone sets no range; at least the least noise.
fn range(seen: &Seen) -> f64 {
    let observed = |residual: &Residual| residual.predicted + residual.whitened * residual.deviation;
    let pairs = || seen.residuals.windows(2).map(|two| (observed(&two[0]), observed(&two[1])));
    let low = pairs().map(|(a, b)| a.max(b)).fold(f64::INFINITY, f64::min);
    let high = pairs().map(|(a, b)| a.min(b)).fold(f64::NEG_INFINITY, f64::max);
    let least = seen.residuals.iter().map(|residual| residual.deviation).fold(f64::INFINITY, f64::min);
    ((if seen.limit.is_finite() { seen.limit } else { high }) - low).max(least)
}

/// By how much the noise of pixels is larger than the model states, at least 1: by the differences of neighbours in a row, which
/// neither a smooth misfit nor a cover changes.
pub(crate) fn noise(seen: &[Seen], width: usize) -> f64 {
    let clear = |residual: &Residual| !residual.saturated;
    let pairs = seen.iter().flat_map(|seen| seen.residuals.windows(2));
    let pairs = pairs.filter(|two| {
        two[0].pixel + 1 == two[1].pixel && two[1].pixel % width != 0 && clear(&two[0]) && clear(&two[1])
    });
    let mut steps: Vec<f64> = pairs.map(|two| (two[0].whitened - two[1].whitened).abs()).collect();
    if steps.is_empty() {
        return 1.0;
    }
    let middle = steps.len() / 2;
    let median = *steps.select_nth_unstable_by(middle, f64::total_cmp).1;
    (median / (NORMAL_MEDIAN * std::f64::consts::SQRT_2)).max(1.0)
}

/// Half of all normal variables are farther from their mean than so many standard deviations.
const NORMAL_MEDIAN: f64 = 0.674_49;

/// The root mean square of the residuals, in standard deviations.
pub(crate) fn rms(seen: &[Seen]) -> f64 {
    let squares = || seen.iter().flat_map(|seen| &seen.residuals).map(|residual| residual.whitened.powi(2));
    (squares().sum::<f64>() / squares().count().max(1) as f64).sqrt()
}

/// By how much the background of a prediction may be off: the modes of the residuals above and below it, the one that more pixels
/// are near to first. A cover hides background, too, so the predicted level may lie between the two.
pub(crate) fn background_shifts(seen: &[Seen]) -> Vec<f64> {
    let clear = || seen.iter().flat_map(|seen| &seen.residuals).filter(|residual| !residual.saturated);
    let value = |residual: &Residual| residual.whitened * residual.deviation;
    let near = |shift: f64| {
        let is_near = |residual: &&Residual| (value(residual) - shift).abs() < residual.deviation;
        clear().filter(is_near).count()
    };
    let mode = |sign: f64| {
        let mut values: Vec<f64> = clear().map(value).filter(|value| sign * value > 0.0).collect();
        values.sort_by(f64::total_cmp);
        half_sample_mode(&values)
    };
    let mut shifts: Vec<f64> = [1.0, -1.0].into_iter().filter_map(mode).collect();
    shifts.sort_by_key(|shift| std::cmp::Reverse(near(*shift)));
    shifts
}

/// The mode of sorted values: of the half with the smallest span that of its half, and so on (Robertson and Cryer 1974).
fn half_sample_mode(mut values: &[f64]) -> Option<f64> {
    while values.len() > 2 {
        let half = values.len().div_ceil(2);
        let spans = values.windows(half).enumerate();
        let (first, _) = spans.min_by(|a, b| (a.1[half - 1] - a.1[0]).total_cmp(&(b.1[half - 1] - b.1[0])))?;
        values = &values[first..first + half];
    }
    Some(values.iter().sum::<f64>() / values.len() as f64).filter(|mode| mode.is_finite())
}

/// Light that a mask leaves out, in units of the model's.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LeftOut {
    /// The share of the model's light that lies under the mask.
    pub hidden: f64,
    /// Observed less predicted light under the mask, without saturated pixels; positive where the target would be stronger.
    pub excess: f64,
    /// The share of the model's light that lies under the mask and is there, on the whole: a model that is wrong there, not an outlier.
    pub wasted: f64,
}

impl LeftOut {
    /// Of residuals of all pixels; the light is that beyond `background` (without one, beyond the darkest prediction).
    pub fn of(seen: &[Seen], mask: &[bool], background: Option<f64>) -> LeftOut {
        let (mut light, mut all, mut hidden) = (0.0, 0.0, 0.0);
        let (mut excess, mut replaced) = (0.0, 0.0);
        for one in seen {
            let level = background.unwrap_or_else(|| one.floor());
            for residual in &one.residuals {
                let own = residual.predicted - level;
                (light, all) = (light + own, all + own.abs());
                if mask[residual.pixel] {
                    hidden += own.abs();
                    let off = residual.whitened * residual.deviation;
                    excess += if residual.saturated { 0.0 } else { off };
                    replaced += off.abs();
                }
            }
        }
        let share = |part: f64, all: f64| if all > 0.0 { part / all } else { 0.0 };
        LeftOut {
            hidden: share(hidden, all),
            excess: if light == 0.0 { f64::INFINITY } else { excess / light },
            wasted: share((hidden - replaced).max(0.0), all),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 24;

    fn seen(whitened: impl Fn(usize, usize) -> f64) -> [Seen; 1] {
        let residuals = (0..SIDE * SIDE).map(|pixel| Residual {
            pixel,
            predicted: if pixel == 0 { 100.0 } else { 0.0 },
            whitened: whitened(pixel % SIDE, pixel / SIDE),
            deviation: 2.0,
            saturated: false,
        });
        [Seen { residuals: residuals.collect(), limit: 255.0 }]
    }

    fn mask(whitened: impl Fn(usize, usize) -> f64) -> Vec<usize> {
        let mask = outliers(&seen(whitened), Window::whole(SIDE, SIDE), 1.0);
        mask.iter().enumerate().filter(|(_, is_outlier)| **is_outlier).map(|(pixel, _)| pixel).collect()
    }

    #[test]
    fn an_outlier_has_an_edge_and_noise_is_none() {
        assert!(mask(|x, y| if (x + y) % 2 == 0 { 2.5 } else { -2.5 }).is_empty());
        assert_eq!(mask(|x, y| if (x, y) == (5, 7) { 6.0 } else { 0.0 }), [7 * SIDE + 5]);
        // Under a cover a pixel of two standard deviations is an outlier as well.
        let cover = mask(|x, y| if (x, y) == (18, 12) { 2.0 } else { 10.0 * f64::from(u8::from(x >= 12)) });
        assert_eq!(cover.len(), 12 * SIDE);
    }

    #[test]
    fn light_is_left_out_with_its_sign() {
        let core = seen(|x, y| if (x, y) == (3, 3) { 75.0 } else { 0.0 });
        let masked = |pixel: usize| (0..SIDE * SIDE).map(|other| other == pixel).collect::<Vec<_>>();
        let left = LeftOut::of(&core, &masked(3 * SIDE + 3), Some(0.0));
        assert!((left.excess - 1.5).abs() < 1e-12 && left.hidden == 0.0, "{left:?}");
        assert_eq!(LeftOut::of(&core, &masked(0), Some(0.0)).hidden, 1.0);
    }
}
