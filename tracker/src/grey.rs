//! `Grey`: the pixel values of a window as plain numbers, for everything that looks at an image before a fit.

use isophote_jit::{PixelFormat, PlaneView, Window};

/// The mean of all planes inside a window.
#[derive(Clone, Debug)]
pub(crate) struct Grey {
    /// Row by row.
    pub values: Vec<f64>,
    /// Pixels of a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// At or above: saturated.
    pub saturation: f64,
    /// The step between two pixel values; 0 for fractions.
    pub step: f64,
}

impl Grey {
    /// Reads a window that lies inside the planes; `saturation` is one limit a plane. A pixel that is saturated in any
    /// plane reads as `saturation`.
    pub fn read(planes: &[PlaneView], window: Window, saturation: &[f64]) -> Grey {
        let limit = saturation.iter().copied().fold(f64::INFINITY, f64::min);
        let mut values = Vec::with_capacity(window.width * window.height);
        for y in window.y..window.y + window.height {
            for x in window.x..window.x + window.width {
                let (mut sum, mut clipped) = (0.0, false);
                for (plane, limit) in planes.iter().zip(saturation) {
                    let value = plane.pixel(x, y);
                    clipped |= value >= *limit;
                    sum += value;
                }
                let mean = sum / planes.len().max(1) as f64;
                values.push(if clipped { mean.max(limit) } else { mean });
            }
        }
        let whole = planes.iter().all(|plane| matches!(plane.format(), PixelFormat::U8 | PixelFormat::U16));
        Grey {
            values,
            width: window.width,
            height: window.height,
            saturation: limit,
            step: if whole { 1.0 } else { 0.0 },
        }
    }

    /// All pixels as (x, y, value), in window coordinates.
    pub fn pixels(&self) -> impl Iterator<Item = (f64, f64, f64)> + '_ {
        self.values.iter().enumerate().map(|(i, &value)| ((i % self.width) as f64, (i / self.width) as f64, value))
    }

    /// How many are saturated.
    pub fn saturated(&self) -> usize {
        self.values.iter().filter(|&&value| value >= self.saturation).count()
    }

    /// The mean over 3 × 3 pixels (3 in a single row), fewer at the border: noise down by 3, single hot pixels by 9.
    pub fn smoothed(&self) -> Vec<f64> {
        let mut along = self.values.clone();
        for (row, from) in along.chunks_exact_mut(self.width).zip(self.values.chunks_exact(self.width)) {
            for (mean, three) in row.iter_mut().skip(1).zip(from.windows(3)) {
                *mean = (three[0] + three[1] + three[2]) * (1.0 / 3.0);
            }
            if let [first, second, ..] = *from {
                row[0] = 0.5 * (first + second);
            }
            if let [.., second, last] = *from {
                row[self.width - 1] = 0.5 * (second + last);
            }
        }
        let mut smooth = vec![0.0; along.len()];
        for (y, row) in smooth.chunks_exact_mut(self.width).enumerate() {
            let rows = y.saturating_sub(1)..(y + 2).min(self.height);
            let share = 1.0 / rows.len() as f64;
            for near in along[rows.start * self.width..rows.end * self.width].chunks_exact(self.width) {
                for (mean, value) in row.iter_mut().zip(near) {
                    *mean += share * value;
                }
            }
        }
        smooth
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smoothing_is_the_mean_of_what_is_there() {
        let grey = |width, height| Grey {
            values: (0..width * height).map(|i| ((i * i) % 17) as f64).collect(),
            width,
            height,
            saturation: 255.0,
            step: 1.0,
        };
        for (width, height) in [(1, 1), (2, 1), (5, 1), (1, 4), (2, 2), (5, 4)] {
            let grey = grey(width, height);
            let near = |i: usize, n: usize| i.saturating_sub(1)..(i + 2).min(n);
            for (i, mean) in grey.smoothed().into_iter().enumerate() {
                let places = near(i / width, height).flat_map(|y| near(i % width, width).map(move |x| y * width + x));
                let values: Vec<f64> = places.map(|place| grey.values[place]).collect();
                let should = values.iter().sum::<f64>() / values.len() as f64;
                assert!((mean - should).abs() < 1e-12, "{width} x {height}, {i}: {mean} {should}");
            }
        }
    }
}
