//! Starting values: where targets are, how large and how bright, from a window alone.
//!
//! What comes in: pixel values. What goes out: a [`Sight`] for each target, the most massive first: what the estimators of
//! a document (`centroid.x`, `extent.xx`, …) stand for. It never knows a model.
//!
//! 1. The background is a robust plane through the window's border.
//! 2. What differs from it by a fifth of the largest difference, and from its noise, is a target; one that is smaller than
//!    six pixels is not.
//! 3. Its pixels' moments are centre and extent. Extent is that of the thresholded region, each pixel alike: it does not
//!    change when the middle is saturated. `A = 0.7 C⁻¹/4` in two dimensions, where C is the region's covariance: a full
//!    ellipse `dᵀAd ≤ 1` has C = A⁻¹/4, and the region above a fifth covers about 0.7 of a spot's.

use isophote_symbolic::Estimator;

use crate::background::Background;
use crate::component::{Component, Labels};
use crate::grey::Grey;

/// Which way a target differs from the ground.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sign {
    /// Bright on dark.
    Bright,
    /// Dark on bright.
    Dark,
}

/// What to look for.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Wanted {
    /// Bright or dark; `None`: whichever is more.
    pub sign: Option<Sign>,
    /// Where the first target should be, in px of the window: of all targets that matter the nearest is taken, not the
    /// most massive.
    pub near: Option<[f64; 2]>,
    /// How many at most.
    pub targets_max: usize,
}

/// Starting values of one target; px of the window.
#[derive(Clone, Debug, PartialEq)]
pub struct Sight {
    /// Centre; y is 0 in one dimension.
    pub centre: [f64; 2],
    /// Entries xx, xy, yy of A, px⁻²: the outline is dᵀAd = 1.
    pub extent: [f64; 3],
    /// Half the outline's width and height, px.
    pub size: [f64; 2],
    /// The ground's pixel value at the centre.
    pub background: f64,
    /// By how much the target differs from it at most; negative for a dark one.
    pub amplitude: f64,
    /// Pixels of the target that are saturated.
    pub saturated: usize,
}

/// A target begins where the difference is this share of its largest.
const THRESHOLD: f64 = 0.2;
/// … and this many standard deviations of the background, unless that is more than half of the largest difference.
const NOISE_FACTOR: f64 = 4.5;
/// The largest difference, smoothed, is a target only from this many standard deviations on: the largest of 300,000
/// smoothed noise pixels reaches 1.6.
const SIGNIFICANT: f64 = 3.0;
/// Below this many standard deviations the threshold is applied to smoothed pixels.
const SMOOTH_BELOW: f64 = 8.0;
/// What is smaller is a hot pixel.
const PIXELS_MIN: usize = 6;
/// … in one dimension.
const PIXELS_MIN_1D: usize = 2;
/// Near a given place, targets of less than this share of the largest mass do not matter.
const MASS_SHARE: f64 = 0.02;
/// The thresholded region's share of s in `dᵀAd = s`.
const REGION: f64 = 0.7;
/// Variance of a position inside a pixel, px².
const PIXEL_VARIANCE: f64 = 1.0 / 12.0;

impl Sight {
    /// The value that a document's estimator stands for, in frame coordinates when `origin` is the window's corner.
    pub fn value(&self, estimator: Estimator, origin: [f64; 2]) -> f64 {
        match estimator {
            Estimator::CentroidX => self.centre[0] + origin[0],
            Estimator::CentroidY => self.centre[1] + origin[1],
            Estimator::ExtentXX => self.extent[0],
            Estimator::ExtentXY => self.extent[1],
            Estimator::ExtentYY => self.extent[2],
            Estimator::SizeX => self.size[0],
            Estimator::SizeY => self.size[1],
            Estimator::Background => self.background,
            Estimator::Amplitude => self.amplitude,
        }
    }
}

/// Finds targets.
pub(crate) fn find(grey: &Grey, wanted: &Wanted) -> Vec<Sight> {
    let background = Background::fit(grey);
    let signs = match wanted.sign {
        Some(sign) => vec![sign],
        None => vec![Sign::Bright, Sign::Dark],
    };
    let found: Vec<Vec<Sight>> = signs.into_iter().map(|sign| find_signed(grey, &background, sign, wanted)).collect();
    // The sign whose first target differs more, pixel by pixel and in all.
    let weight =
        |starts: &Vec<Sight>| starts.first().map_or(0.0, |s| s.amplitude.abs() * s.size[0] * s.size[1].max(1.0));
    found.into_iter().max_by(|a, b| weight(a).total_cmp(&weight(b))).unwrap_or_default()
}

fn find_signed(grey: &Grey, background: &Background, sign: Sign, wanted: &Wanted) -> Vec<Sight> {
    let factor = if sign == Sign::Bright { 1.0 } else { -1.0 };
    let difference = |values: &[f64]| -> Vec<f64> {
        let rows = values.chunks_exact(grey.width).enumerate();
        let row = |(y, row): (usize, &[f64])| -> Vec<f64> {
            row.iter().enumerate().map(|(x, value)| factor * (value - background.at(x as f64, y as f64))).collect()
        };
        rows.flat_map(row).collect()
    };
    let smooth = difference(&grey.smoothed());
    let peak = smooth.iter().copied().fold(0.0, f64::max);
    if peak <= SIGNIFICANT * background.noise || peak <= grey.step {
        return Vec::new();
    }
    let level = |peak: f64| (THRESHOLD * peak).max((NOISE_FACTOR * background.noise).min(0.5 * peak));
    let sharp = difference(&grey.values);
    let values = if level(peak) < SMOOTH_BELOW * background.noise { &smooth } else { &sharp };
    let pixels_min = if grey.height == 1 { PIXELS_MIN_1D } else { PIXELS_MIN };
    let mut components = Labels::new(values, grey.width).above(level(peak), pixels_min);
    // Smoothing makes nine pixels of a hot one.
    components.retain(|component| component.pixels.iter().filter(|&&i| sharp[i] > level(peak)).count() >= pixels_min);
    if let Some(near) = wanted.near {
        put_nearest_first(&mut components, grey.width, near);
    }
    let measured = components.into_iter().take(wanted.targets_max.max(1)).map(|component| {
        // A faint target beside a bright one has a threshold of its own.
        let peak = component.pixels.iter().map(|&pixel| smooth[pixel]).fold(0.0, f64::max);
        let own = Labels::new(values, grey.width).grow(component.pixels, level(peak));
        measure(grey, background, &own, &sharp, factor * peak)
    });
    measured.collect()
}

fn put_nearest_first(components: &mut [Component], width: usize, near: [f64; 2]) {
    let least = MASS_SHARE * components.first().map_or(0.0, |component| component.mass);
    let distance = |component: &Component| {
        let square = |&i: &usize| ((i % width) as f64 - near[0]).powi(2) + ((i / width) as f64 - near[1]).powi(2);
        component.pixels.iter().map(square).fold(f64::INFINITY, f64::min)
    };
    // Stable: among targets that hold the place the most massive stays first.
    components
        .sort_by_cached_key(|component| if component.mass < least { u64::MAX } else { distance(component).to_bits() });
}

/// Moments of a region: the centre with the difference as weight, the extent with every pixel alike.
fn measure(grey: &Grey, background: &Background, region: &Component, difference: &[f64], amplitude: f64) -> Sight {
    let place = |i: usize| ((i % grey.width) as f64, (i / grey.width) as f64);
    let mean = |weight: &dyn Fn(usize) -> f64| {
        let (mut total, mut x, mut y) = (0.0, 0.0, 0.0);
        for &i in &region.pixels {
            let (w, (px, py)) = (weight(i), place(i));
            (total, x, y) = (total + w, x + w * px, y + w * py);
        }
        [x / total, y / total]
    };
    let centre = mean(&|i| difference[i].max(0.0) + f64::MIN_POSITIVE);
    let middle = mean(&|_| 1.0);
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for &i in &region.pixels {
        let (x, y) = place(i);
        let (dx, dy) = (x - middle[0], y - middle[1]);
        (xx, xy, yy) = (xx + dx * dx, xy + dx * dy, yy + dy * dy);
    }
    let n = region.pixels.len() as f64;
    let (xx, xy, yy) = (xx / n + PIXEL_VARIANCE, xy / n, yy / n + PIXEL_VARIANCE);
    // Variance of an even segment [−w, w] is w²/3, of an even ellipse along a half axis w it is w²/4.
    let even = if grey.height == 1 { 3.0 } else { 4.0 };
    let extent = match grey.height {
        1 => [REGION / (even * xx), 0.0, 0.0],
        _ => {
            let scale = REGION / (even * (xx * yy - xy * xy).max(PIXEL_VARIANCE * PIXEL_VARIANCE));
            [scale * yy, -scale * xy, scale * xx]
        }
    };
    let half = |variance: f64| (even * variance / REGION).sqrt();
    Sight {
        centre,
        extent,
        size: [half(xx), if grey.height == 1 { 0.0 } else { half(yy) }],
        background: background.at(centre[0], centre[1]),
        amplitude,
        saturated: region.pixels.iter().filter(|&&i| grey.values[i] >= grey.saturation).count(),
    }
}

#[cfg(test)]
#[path = "start_tests.rs"]
mod tests;
