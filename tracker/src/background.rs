//! The background: a robust plane through the border of the window, and the noise about it.

use nalgebra::{Matrix3, Vector3};

use crate::grey::Grey;

/// `level + slope · (x − middle)`, and how far pixels are from it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Background {
    level: f64,
    slope: [f64; 2],
    middle: [f64; 2],
    /// Standard deviation of border pixels about the plane, at least the rounding of whole pixel values.
    pub noise: f64,
}

/// Border pixels on each side.
const RING_PX: usize = 3;
/// … of a frame of one dimension.
const ENDS_PX: usize = 16;
/// Fits, each without what lay far from the one before.
const ROUNDS: usize = 5;
/// A pixel this many standard deviations away belongs to something else.
const OUTLIER: f64 = 3.5;
/// Standard deviation over median absolute deviation, for normal noise.
const DEVIATION_OF_MAD: f64 = 1.4826;

impl Background {
    /// The plane through the border: least squares on pixels near the last plane, beginning with the border's median.
    /// Saturated pixels do not count.
    pub fn fit(grey: &Grey) -> Background {
        let middle = [(grey.width - 1) as f64 / 2.0, (grey.height - 1) as f64 / 2.0];
        let mut border: Vec<(f64, f64, f64)> = border(grey).filter(|&(_, _, value)| value < grey.saturation).collect();
        if border.len() < 4 {
            border = grey.pixels().filter(|pixel| pixel.2.is_finite()).collect();
        }
        let values: Vec<f64> = border.iter().map(|&(_, _, value)| value).collect();
        let mut plane = Background { level: median(&values), slope: [0.0; 2], middle, noise: f64::INFINITY };
        for round in 0..=ROUNDS {
            let residual = |&(x, y, value): &(f64, f64, f64)| value - plane.at(x, y);
            let near: Vec<(f64, f64, f64)> =
                border.iter().filter(|pixel| residual(pixel).abs() <= OUTLIER * plane.noise).copied().collect();
            let distances: Vec<f64> = near.iter().map(|pixel| residual(pixel).abs()).collect();
            let noise = (DEVIATION_OF_MAD * median(&distances)).max(grey.step / 3.0);
            if round == ROUNDS {
                plane.noise = noise;
                break;
            }
            let kept: Vec<_> = near.into_iter().filter(|pixel| residual(pixel).abs() <= OUTLIER * noise).collect();
            plane = Background { noise, ..plane.refitted(&kept) };
            plane.noise *= 1.5; // the next round looks a little wider, so that a slope found late is not cut off
        }
        plane
    }

    /// The plane's value at a pixel of the window.
    pub fn at(&self, x: f64, y: f64) -> f64 {
        self.level + self.slope[0] * (x - self.middle[0]) + self.slope[1] * (y - self.middle[1])
    }

    /// Least squares on `pixels`; coordinates in units of the window, so that the normal equations are well scaled.
    fn refitted(&self, pixels: &[(f64, f64, f64)]) -> Background {
        let unit = [self.middle[0].max(1.0), self.middle[1].max(1.0)];
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for &(x, y, value) in pixels {
            let row = Vector3::new(1.0, (x - self.middle[0]) / unit[0], (y - self.middle[1]) / unit[1]);
            normal += row * row.transpose();
            right += row * value;
        }
        // A direction in which the border does not extend gets no slope.
        for i in 1..3 {
            normal[(i, i)] += 1e-9 * (1.0 + normal[(0, 0)]);
        }
        match normal.cholesky().map(|factor| factor.solve(&right)) {
            Some(c) => Background { level: c[0], slope: [c[1] / unit[0], c[2] / unit[1]], ..self.clone() },
            None => self.clone(),
        }
    }
}

/// Pixels of the window's border: a ring, or both ends of a single row.
fn border(grey: &Grey) -> impl Iterator<Item = (f64, f64, f64)> + '_ {
    let ends = if grey.height == 1 { ENDS_PX.min(grey.width / 8).max(2) } else { RING_PX };
    let row = move |y: usize| {
        let whole = grey.height > 1 && (y < RING_PX || y + RING_PX >= grey.height) || grey.width <= 2 * ends;
        let left = if whole { grey.width } else { ends };
        (0..left).chain(grey.width.saturating_sub(ends).max(left)..grey.width).map(move |x| (x, y))
    };
    let pixels = (0..grey.height).flat_map(row).map(|(x, y)| (x as f64, y as f64, grey.values[y * grey.width + x]));
    pixels.filter(|pixel| pixel.2.is_finite())
}

/// The median; 0 of nothing.
pub(crate) fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    if sorted.is_empty() {
        return 0.0;
    }
    let middle = sorted.len() / 2;
    *sorted.select_nth_unstable_by(middle, f64::total_cmp).1
}
