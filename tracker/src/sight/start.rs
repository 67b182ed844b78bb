//! Starting values from a window alone: a [`Detection`] for each candidate target, the most massive first, with the
//! values of a document's estimators (`centroid.x`, `extent.xx`, …).
//!
//! 1. The background is a robust plane through the window's border.
//! 2. A target differs from it by a fifth of the largest difference, and by more than its noise; it has at least six pixels.
//! 3. Where more targets are wanted, the level is halved down to the noise: a separate component at a lower level is fainter than
//!    those before.
//! 4. Moments of its pixels give centre and extent. Extent is that of the thresholded region with equal weights: saturation does
//!    not change it. `A = 0.7 C⁻¹/(n + 2)` in n dimensions, where C is the region's covariance: a full ellipsoid `dᵀAd ≤ 1` has
//!    C = A⁻¹/(n + 2), and the region above a fifth covers about 0.7 of a spot's s.

use isophote_symbolic::Estimator;
use nalgebra::DMatrix;

use crate::budget::{Spend, Stop};
use crate::sight::background::Background;
use crate::sight::component::{Component, Labels};
use crate::sight::grey::{Grey, place_of};
use crate::sight::mask::Mask;

/// The sign of a target's contrast.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sign {
    /// Bright on dark.
    Bright,
    /// Dark on bright.
    Dark,
}

/// Parameters of a search.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct FindOptions {
    /// Bright or dark; `None`: whichever is stronger.
    pub sign: Option<Sign>,
    /// Expected position of the first target, px of the window: the nearest of all significant targets is taken, not the
    /// most massive.
    pub near: Option<[f64; 4]>,
    /// Most targets.
    pub targets_max: usize,
    /// Include fainter ones, down to the noise.
    pub faint: bool,
    /// Fewest pixels of a target; six by default.
    pub pixels_min: Option<usize>,
    /// Regions to ignore.
    pub masks: Vec<Mask>,
}

/// The result of a search.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct FoundDetections {
    /// Candidate targets.
    pub detections: Vec<Detection>,
    /// Standard deviation of a background pixel.
    pub noise: f64,
}

/// Starting values of one candidate; px of the window.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Detection {
    /// Centre; 0 in dimensions without extent.
    pub centre: [f64; 4],
    /// A, px⁻²: the outline is dᵀAd = 1.
    pub extent: [[f64; 4]; 4],
    /// Half the outline's width, height, depth and so on, px.
    pub size: [f64; 4],
    /// The background's pixel value at the centre.
    pub background: f64,
    /// Largest difference from the background; negative for a dark target.
    pub amplitude: f64,
    /// Saturated pixels of the target.
    pub saturated: usize,
}

/// Threshold of a target as a share of its largest difference.
const THRESHOLD: f64 = 0.2;
/// Threshold in standard deviations of the background, unless that exceeds half of the largest difference.
const NOISE_FACTOR: f64 = 4.5;
/// Ratio of one level to the previous one.
const LOWER: f64 = 0.5;
/// Most levels: with zero noise and rounding there is no lowest one. No pixel has a larger range.
const LEVELS_MAX: usize = 64;
/// Significance of the largest smoothed difference, in standard deviations: the largest of 300,000 smoothed noise pixels
/// reaches 1.6.
const SIGNIFICANT: f64 = 3.0;
/// Below this many standard deviations the threshold applies to smoothed pixels.
const SMOOTH_BELOW: f64 = 8.0;
/// Fewest pixels of a target; smaller ones are hot pixels.
const PIXELS_MIN: usize = 6;
/// Fewest pixels in one dimension.
const PIXELS_MIN_1D: usize = 2;
/// Near a given position, targets of less than this share of the largest mass are ignored.
const MASS_SHARE: f64 = 0.02;
/// Share of s in `dᵀAd = s` that the thresholded region covers.
const REGION: f64 = 0.7;
/// Variance of a position inside a pixel, px².
const PIXEL_VARIANCE: f64 = 1.0 / 12.0;

impl Detection {
    /// The value of a document's estimator, in frame coordinates when `origin` is the window's corner.
    pub fn value(&self, estimator: Estimator, origin: [f64; 4]) -> f64 {
        match estimator {
            Estimator::Centroid(axis) => self.centre[axis] + origin[axis],
            Estimator::Extent(row, column) => self.extent[row][column],
            Estimator::Size(axis) => self.size[axis],
            Estimator::Background => self.background,
            Estimator::Amplitude => self.amplitude,
            // Along the eigenvector of the smaller eigenvalue of A.
            Estimator::Angle => {
                let [[xx, xy, ..], [_, yy, ..], ..] = self.extent;
                0.5 * (-2.0 * xy).atan2(yy - xx)
            }
            // Set earlier: see `wave`.
            Estimator::Frequency | Estimator::Direction | Estimator::Phase => 0.0,
            // A single detection has no pose: see `pose::starts`.
            Estimator::Position(_) | Estimator::Orientation(_) => 0.0,
        }
    }
}

impl Detection {
    /// Scales the outline by this factor.
    pub fn widened(&self, by: f64) -> Detection {
        let mut wide = self.clone();
        wide.size.iter_mut().for_each(|size| *size *= by);
        wide.extent.iter_mut().flatten().for_each(|entry| *entry /= by * by);
        wide
    }
}

/// Finds targets. Each pass over the picture is charged by its pixels; partial results are discarded.
///
/// # Errors
/// When `spend` ends the search.
pub(crate) fn find(grey: &Grey, options: &FindOptions, spend: Spend) -> Result<FoundDetections, Stop> {
    let background = Background::fit(grey);
    let signs = match options.sign {
        Some(sign) => vec![sign],
        None => vec![Sign::Bright, Sign::Dark],
    };
    let found = signs.into_iter().map(|sign| find_signed(grey, &background, sign, options, spend));
    let found = found.collect::<Result<Vec<Vec<Detection>>, Stop>>()?;
    // The sign whose first target has the larger difference, summed over its volume.
    let volume = |sizes: &[f64]| sizes.iter().map(|size| size.max(1.0)).product::<f64>();
    let weight =
        |starts: &Vec<Detection>| starts.first().map_or(0.0, |s| s.amplitude.abs() * s.size[0] * volume(&s.size[1..]));
    let detections = found.into_iter().max_by(|a, b| weight(a).total_cmp(&weight(b))).unwrap_or_default();
    Ok(FoundDetections { detections, noise: background.noise })
}

fn find_signed(
    grey: &Grey,
    background: &Background,
    sign: Sign,
    options: &FindOptions,
    spend: Spend,
) -> Result<Vec<Detection>, Stop> {
    let spend = || spend(grey.values.len() as u64);
    spend()?;
    let factor = if sign == Sign::Bright { 1.0 } else { -1.0 };
    let slope = background.slope_along_rows();
    let difference = |mut values: Vec<f64>| -> Vec<f64> {
        for (row, ([y, z, w], _)) in values.chunks_exact_mut(grey.size[0]).zip(grey.rows()) {
            let first = background.at([0.0, y, z, w]);
            row.iter_mut().enumerate().for_each(|(x, value)| *value = factor * (*value - (first + slope * x as f64)));
        }
        options.masks.iter().for_each(|mask| mask.clear(&mut values, grey.size));
        values
    };
    let smooth = difference(grey.smoothed());
    let peak = smooth.iter().copied().fold(0.0, f64::max);
    if peak <= SIGNIFICANT * background.noise || peak <= grey.step {
        return Ok(Vec::new());
    }
    let level = |peak: f64| (THRESHOLD * peak).max((NOISE_FACTOR * background.noise).min(0.5 * peak));
    let sharp = difference(grey.values.clone());
    let values = if level(peak) < SMOOTH_BELOW * background.noise { &smooth } else { &sharp };
    let usual = if grey.dimensions() == 1 { PIXELS_MIN_1D } else { PIXELS_MIN };
    let pixels_min = options.pixels_min.unwrap_or(usual);
    // Smoothing spreads a hot pixel over nine and more.
    let above = |values: &[f64], level: f64| -> Vec<Component> {
        let mut components = Labels::new(values, grey.size).above(level, pixels_min);
        components.retain(|component| component.pixels.iter().filter(|&&i| sharp[i] > level).count() >= pixels_min);
        components
    };
    let mut components = above(values, level(peak));
    if options.faint {
        let mut taken = vec![false; grey.values.len()];
        components.iter().flat_map(|component| &component.pixels).for_each(|&i| taken[i] = true);
        let (mut at, lowest) = (level(peak), (NOISE_FACTOR * background.noise).max(grey.step));
        for _ in 0..LEVELS_MAX {
            if at <= lowest || components.len() >= options.targets_max {
                break;
            }
            spend()?;
            at = (LOWER * at).max(lowest);
            let values = if at < SMOOTH_BELOW * background.noise { &smooth } else { &sharp };
            let mut fainter = above(values, at);
            fainter.retain(|component| !component.pixels.iter().any(|&i| taken[i]));
            fainter.iter().flat_map(|component| &component.pixels).for_each(|&i| taken[i] = true);
            components.extend(fainter);
        }
    }
    if let Some(near) = options.near {
        sort_by_distance(&mut components, grey.size, near);
    }
    let measured =
        components.into_iter().take(options.targets_max.max(1)).map(|component| -> Result<Detection, Stop> {
            spend()?;
            // A faint target beside a bright one has its own threshold.
            let peak = component.pixels.iter().map(|&pixel| smooth[pixel]).fold(0.0, f64::max);
            let own = Labels::new(values, grey.size).grow(component.pixels, level(peak));
            Ok(measure(grey, background, &own, &sharp, factor * peak))
        });
    measured.collect()
}

fn sort_by_distance(components: &mut [Component], size: [usize; 4], near: [f64; 4]) {
    let least = MASS_SHARE * components.first().map_or(0.0, |component| component.mass);
    let distance = |component: &Component| {
        let square = |&i: &usize| place_of(i, size).iter().zip(near).map(|(at, near)| (at - near).powi(2)).sum::<f64>();
        component.pixels.iter().map(square).fold(f64::INFINITY, f64::min)
    };
    // Stable: among targets that cover the position the most massive stays first.
    components
        .sort_by_cached_key(|component| if component.mass < least { u64::MAX } else { distance(component).to_bits() });
}

/// Moments of a region: the centre weighted by the difference, the extent with equal weights.
fn measure(grey: &Grey, background: &Background, region: &Component, difference: &[f64], amplitude: f64) -> Detection {
    let mean = |weight: &dyn Fn(usize) -> f64| {
        let (mut total, mut sum) = (0.0, [0.0; 4]);
        for &i in &region.pixels {
            let (w, place) = (weight(i), grey.place(i));
            total += w;
            sum.iter_mut().zip(place).for_each(|(sum, at)| *sum += w * at);
        }
        sum.map(|sum| sum / total)
    };
    let centre = mean(&|i| difference[i].max(0.0) + f64::MIN_POSITIVE);
    let middle = mean(&|_| 1.0);
    let dimensions = grey.dimensions();
    let mut covariance = DMatrix::zeros(dimensions, dimensions);
    for &i in &region.pixels {
        let place = grey.place(i);
        for row in 0..dimensions {
            for column in 0..=row {
                covariance[(row, column)] += (place[row] - middle[row]) * (place[column] - middle[column]);
            }
        }
    }
    covariance /= region.pixels.len() as f64;
    covariance.fill_upper_triangle_with_lower_triangle();
    for axis in 0..dimensions {
        covariance[(axis, axis)] += PIXEL_VARIANCE; // so it has an inverse
    }
    // The variance of a uniform segment [−w, w] is w²/3, of a uniform ellipse along a half axis w it is w²/4, of an
    // ellipsoid w²/5.
    let even = dimensions as f64 + 2.0;
    let (mut extent, mut size) = ([[0.0; 4]; 4], [0.0; 4]);
    if let Some(inverse) = covariance.clone().try_inverse() {
        for row in 0..dimensions {
            size[row] = (even * covariance[(row, row)] / REGION).sqrt();
            for column in 0..dimensions {
                extent[row][column] = REGION / even * inverse[(row, column)];
            }
        }
    }
    Detection {
        centre,
        extent,
        size,
        background: background.at(centre),
        amplitude,
        saturated: region.pixels.iter().filter(|&&i| grey.values[i] >= grey.saturation).count(),
    }
}

#[cfg(test)]
#[path = "start_tests.rs"]
mod tests;
