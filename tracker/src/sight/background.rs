//! The background: a robust plane through the window's border, and the noise about it.

use nalgebra::{Matrix5, Vector5};

use crate::sight::grey::Grey;
use crate::statistics::{DEVIATION_OF_MEDIAN, median};

/// `level + slope · (place − middle)` and the noise about it. In a volume there are three slopes.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Background {
    level: f64,
    slope: [f64; 4],
    middle: [f64; 4],
    /// Standard deviation of border pixels about the plane, at least the rounding of whole pixel values.
    pub noise: f64,
}

/// Width of the border on each side.
const RING_PX: usize = 3;
/// Width of the border in one dimension.
const ENDS_PX: usize = 16;
/// Border slices and volumes on each side are at most this fraction (1/n) of all, since a target often extends through all
/// of a short stack.
const SLICES_SHARE: usize = 8;
/// Fits, each without the outliers of the previous one.
const ROUNDS: usize = 5;
/// Outlier limit in standard deviations.
const OUTLIER: f64 = 3.5;

/// A position in the window and its pixel value.
type Pixel = ([f64; 4], f64);

impl Background {
    /// Fits the plane through the border: least squares on pixels near the previous plane, starting with the border's
    /// median. Skips saturated pixels.
    pub fn fit(grey: &Grey) -> Background {
        let middle = grey.size.map(|n| (n - 1) as f64 / 2.0);
        let mut border: Vec<Pixel> = border(grey).filter(|&(_, value)| value < grey.saturation).collect();
        if border.len() < 4 {
            border = grey.pixels().filter(|pixel| pixel.1.is_finite()).collect();
        }
        let mut values: Vec<f64> = border.iter().map(|&(_, value)| value).collect();
        let level = median(&mut values).unwrap_or(0.0);
        let mut plane = Background { level, slope: [0.0; 4], middle, noise: f64::INFINITY };
        for round in 0..=ROUNDS {
            let residual = |&(place, value): &Pixel| value - plane.at(place);
            let near: Vec<Pixel> =
                border.iter().filter(|pixel| residual(pixel).abs() <= OUTLIER * plane.noise).copied().collect();
            let mut distances: Vec<f64> = near.iter().map(|pixel| residual(pixel).abs()).collect();
            let noise = (DEVIATION_OF_MEDIAN * median(&mut distances).unwrap_or(0.0)).max(grey.step / 3.0);
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
    pub fn at(&self, place: [f64; 4]) -> f64 {
        (0..4).fold(self.level, |value, axis| value + self.slope[axis] * (place[axis] - self.middle[axis]))
    }

    /// The plane's slope per pixel along a row.
    pub fn slope_along_rows(&self) -> f64 {
        self.slope[0]
    }

    /// Least squares on `pixels`; coordinates in units of the window, so that the normal equations are well scaled.
    fn refitted(&self, pixels: &[Pixel]) -> Background {
        let unit = self.middle.map(|middle| middle.max(1.0));
        let (mut normal, mut right) = (Matrix5::zeros(), Vector5::zeros());
        for &(place, value) in pixels {
            let scaled = |axis: usize| (place[axis] - self.middle[axis]) / unit[axis];
            let row = Vector5::new(1.0, scaled(0), scaled(1), scaled(2), scaled(3));
            normal += row * row.transpose();
            right += row * value;
        }
        // A direction without extent of the border gets no slope.
        for i in 1..5 {
            normal[(i, i)] += 1e-9 * (1.0 + normal[(0, 0)]);
        }
        match normal.cholesky().map(|factor| factor.solve(&right)) {
            Some(c) => {
                Background { level: c[0], slope: std::array::from_fn(|axis| c[axis + 1] / unit[axis]), ..self.clone() }
            }
            None => self.clone(),
        }
    }
}

/// Border pixels: a ring in each slice and a few whole slices, or both ends of a single row.
fn border(grey: &Grey) -> impl Iterator<Item = Pixel> + '_ {
    let [width, height, depth, length] = grey.size;
    let dimensions = grey.dimensions();
    let ends = if dimensions == 1 { ENDS_PX.min(width / 8).max(2) } else { RING_PX };
    let outside = |at: f64, count: usize, ring: usize| at < ring as f64 || at + ring as f64 >= count as f64;
    let slices = |count: usize| RING_PX.min(count / SLICES_SHARE);
    let row = move |([y, z, w], values): ([f64; 3], &[f64])| {
        let is_border = dimensions > 1 && outside(y, height, RING_PX)
            || dimensions > 2 && outside(z, depth, slices(depth))
            || dimensions > 3 && outside(w, length, slices(length));
        let left = if is_border || width <= 2 * ends { width } else { ends };
        let columns = (0..left).chain(width.saturating_sub(ends).max(left)..width);
        columns.map(|x| ([x as f64, y, z, w], values[x])).collect::<Vec<Pixel>>()
    };
    grey.rows().flat_map(row).filter(|pixel| pixel.1.is_finite())
}
