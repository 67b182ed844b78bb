//! The background: a robust plane through the border of the window, and the noise about it.

use nalgebra::{Matrix5, Vector5};

use crate::sight::grey::Grey;

/// `level + slope · (place − middle)`, and how far pixels are from it. In a volume the plane is one of three slopes.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Background {
    level: f64,
    slope: [f64; 4],
    middle: [f64; 4],
    /// Standard deviation of border pixels about the plane, at least the rounding of whole pixel values.
    pub noise: f64,
}

/// Border pixels on each side.
const RING_PX: usize = 3;
/// … of a frame of one dimension.
const ENDS_PX: usize = 16;
/// Slices and volumes on each side that are border as a whole: at most this share of them, since a target often extends
/// through all of a short stack.
const SLICES_SHARE: usize = 8;
/// Fits, each without what lay far from the one before.
const ROUNDS: usize = 5;
/// A pixel this many standard deviations away belongs to something else.
const OUTLIER: f64 = 3.5;
/// Standard deviation over median absolute deviation, for normal noise.
const DEVIATION_OF_MAD: f64 = 1.4826;

/// A place of the window and the pixel value there.
type Pixel = ([f64; 4], f64);

impl Background {
    /// The plane through the border: least squares on pixels near the last plane, beginning with the border's median.
    /// Saturated pixels do not count.
    pub fn fit(grey: &Grey) -> Background {
        let middle = grey.size.map(|n| (n - 1) as f64 / 2.0);
        let mut border: Vec<Pixel> = border(grey).filter(|&(_, value)| value < grey.saturation).collect();
        if border.len() < 4 {
            border = grey.pixels().filter(|pixel| pixel.1.is_finite()).collect();
        }
        let values: Vec<f64> = border.iter().map(|&(_, value)| value).collect();
        let mut plane = Background { level: median(&values), slope: [0.0; 4], middle, noise: f64::INFINITY };
        for round in 0..=ROUNDS {
            let residual = |&(place, value): &Pixel| value - plane.at(place);
            let near: Vec<Pixel> =
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
    pub fn at(&self, place: [f64; 4]) -> f64 {
        (0..4).fold(self.level, |value, axis| value + self.slope[axis] * (place[axis] - self.middle[axis]))
    }

    /// What the plane rises by from a pixel to the next of its row.
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
        // A direction in which the border does not extend gets no slope.
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

/// Pixels of the window's border: a ring in each slice and a few slices as a whole, or both ends of a single row.
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

/// The median; 0 of nothing.
pub(crate) fn median(values: &[f64]) -> f64 {
    quantile(values, 0.5)
}

/// The value that this share of them lies below; 0 of none.
pub(crate) fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    if sorted.is_empty() {
        return 0.0;
    }
    let place = ((share * sorted.len() as f64) as usize).min(sorted.len() - 1);
    *sorted.select_nth_unstable_by(place, f64::total_cmp).1
}
