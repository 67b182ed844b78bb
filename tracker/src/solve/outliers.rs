//! Outlier masks: a pixel follows the model, or with a small probability holds any value between the darkest and the limit
//! (a mixture with a uniform distribution); neighbours are likely to be of one kind.
//!
//! The mask is the mode of the posterior, by iterated conditional modes (J. Besag, "On the statistical analysis of dirty
//! pictures", J. R. Statist. Soc. B 48, 1986): hard assignments in the expectation step of an expectation–maximisation.

use std::f64::consts::TAU;

use isophote_jit::Window;

use crate::estimate::OUTLIERS;
use crate::solve::residuals::{ObservedResiduals, Residual};
use crate::statistics::{DEVIATION_OF_MEDIAN, median};

/// A budget of sweeps: nearly all masks settle after four.
const SWEEPS: usize = 8;
/// Cost per pixel in units of a frame's budget: that of most masks.
pub(crate) const WORK: usize = 8;

/// Marks each outlier pixel of a window, where noise is `scale` times the stated one.
pub(crate) fn outliers(seen: &[ObservedResiduals], window: Window, scale: f64) -> Vec<bool> {
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
    // Starts with all pixels whose own evidence favours an outlier: adjacent small residuals would support one another.
    let mut mask: Vec<bool> = evidence.iter().map(|evidence| *evidence > 0.0).collect();
    for _ in 0..SWEEPS {
        let mut is_settled = true;
        for pixel in (0..evidence.len()).filter(|pixel| !evidence[*pixel].is_nan()) {
            let (x, y) = (pixel % width, pixel / width);
            // One pseudo-observation of the prior counts beside the neighbours: where noise is a hundredth of the range, a
            // lone pixel is an outlier from 4.2 standard deviations on, one beside a straight edge from 3.0.
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

/// The range from the darkest value to the limit, or to the brightest value where nothing clips; at least the least noise.
/// Only values that a neighbour also reaches count, so that no single pixel sets the range.
pub(super) fn range(seen: &ObservedResiduals) -> f64 {
    let observed = |residual: &Residual| residual.predicted + residual.whitened * residual.deviation;
    let pairs = || seen.residuals.windows(2).map(|two| (observed(&two[0]), observed(&two[1])));
    let low = pairs().map(|(a, b)| a.max(b)).fold(f64::INFINITY, f64::min);
    let high = pairs().map(|(a, b)| a.min(b)).fold(f64::NEG_INFINITY, f64::max);
    let least = seen.residuals.iter().map(|residual| residual.deviation).fold(f64::INFINITY, f64::min);
    ((if seen.limit.is_finite() { seen.limit } else { high }) - low).max(least)
}

/// Ratio of the actual noise of pixels to the stated one, at least 1: from the differences of row neighbours, which neither
/// a smooth misfit nor a cover changes.
pub(crate) fn noise(seen: &[ObservedResiduals], width: usize) -> f64 {
    let clear = |residual: &Residual| !residual.saturated;
    let pairs = seen.iter().flat_map(|seen| seen.residuals.windows(2));
    let pairs = pairs.filter(|two| {
        two[0].pixel + 1 == two[1].pixel && two[1].pixel % width != 0 && clear(&two[0]) && clear(&two[1])
    });
    let mut steps: Vec<f64> = pairs.map(|two| (two[0].whitened - two[1].whitened).abs()).collect();
    let step = DEVIATION_OF_MEDIAN * median(&mut steps).unwrap_or(0.0);
    (step / std::f64::consts::SQRT_2).max(1.0)
}

/// RMS of the whitened residuals.
pub(crate) fn rms(seen: &[ObservedResiduals]) -> f64 {
    let squares = || seen.iter().flat_map(|seen| &seen.residuals).map(|residual| residual.whitened.powi(2));
    (squares().sum::<f64>() / squares().count().max(1) as f64).sqrt()
}

/// Candidate shifts of a predicted background: the modes of the residuals above and below it, the better supported first. A
/// cover hides background, too, so the predicted level may lie between the two.
pub(crate) fn background_shifts(seen: &[ObservedResiduals]) -> Vec<f64> {
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

/// The half-sample mode of sorted values: repeatedly keeps the half with the smallest span (Robertson and Cryer 1974).
fn half_sample_mode(mut values: &[f64]) -> Option<f64> {
    while values.len() > 2 {
        let half = values.len().div_ceil(2);
        let spans = values.windows(half).enumerate();
        let (first, _) = spans.min_by(|a, b| (a.1[half - 1] - a.1[0]).total_cmp(&(b.1[half - 1] - b.1[0])))?;
        values = &values[first..first + half];
    }
    Some(values.iter().sum::<f64>() / values.len() as f64).filter(|mode| mode.is_finite())
}

/// Light that a mask excludes, as a share of the model's.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MaskedLight {
    /// The share of the model's light under the mask.
    pub hidden: f64,
    /// Observed minus predicted light under the mask, without saturated pixels; positive where the target would be
    /// stronger.
    pub excess: f64,
    /// The share of the model's light under the mask that is observed nevertheless: then the model is wrong there, and the
    /// pixels are no outliers.
    pub wasted: f64,
}

impl MaskedLight {
    /// From residuals of all pixels; light is measured above `background` (without one, above the darkest prediction).
    pub fn of(seen: &[ObservedResiduals], mask: &[bool], background: Option<f64>) -> MaskedLight {
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
        MaskedLight {
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

    fn seen(whitened: impl Fn(usize, usize) -> f64) -> [ObservedResiduals; 1] {
        let residuals = (0..SIDE * SIDE).map(|pixel| Residual {
            pixel,
            predicted: if pixel == 0 { 100.0 } else { 0.0 },
            whitened: whitened(pixel % SIDE, pixel / SIDE),
            deviation: 2.0,
            saturated: false,
        });
        [ObservedResiduals { residuals: residuals.collect(), limit: 255.0 }]
    }

    fn mask(whitened: impl Fn(usize, usize) -> f64) -> Vec<usize> {
        let mask = outliers(&seen(whitened), Window::whole(SIDE, SIDE), 1.0);
        mask.iter().enumerate().filter(|(_, is_outlier)| **is_outlier).map(|(pixel, _)| pixel).collect()
    }

    #[test]
    fn masks_follow_edges_and_exclude_noise() {
        assert!(mask(|x, y| if (x + y) % 2 == 0 { 2.5 } else { -2.5 }).is_empty());
        assert_eq!(mask(|x, y| if (x, y) == (5, 7) { 6.0 } else { 0.0 }), [7 * SIDE + 5]);
        // Under a cover a pixel of two standard deviations is an outlier as well.
        let cover = mask(|x, y| if (x, y) == (18, 12) { 2.0 } else { 10.0 * f64::from(u8::from(x >= 12)) });
        assert_eq!(cover.len(), 12 * SIDE);
    }

    #[test]
    fn excess_light_is_signed() {
        let core = seen(|x, y| if (x, y) == (3, 3) { 75.0 } else { 0.0 });
        let masked = |pixel: usize| (0..SIDE * SIDE).map(|other| other == pixel).collect::<Vec<_>>();
        let left = MaskedLight::of(&core, &masked(3 * SIDE + 3), Some(0.0));
        assert!((left.excess - 1.5).abs() < 1e-12 && left.hidden == 0.0, "{left:?}");
        assert_eq!(MaskedLight::of(&core, &masked(0), Some(0.0)).hidden, 1.0);
    }
}
