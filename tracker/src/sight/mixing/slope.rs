//! The slope of one channel over another, with standard error, from noisy pixels of both.
//!
//! As both channels are noisy, a plain regression is too flat: noise of the own channel counts as light. The mean z of a
//! pixel's four neighbours in the own channel is correlated with the light but not with the pixel's own noise; with it as
//! instrument b = Σw(z − z̄)(y − ȳ) / Σw(z − z̄)(x − x̄) is consistent for any noise, without a noise model. (Two-stage
//! least squares; J. Wooldridge, Econometric Analysis of Cross Section and Panel Data, chapter 5.) w are Tukey's weights of
//! the residuals e = y − a − bx, so that hot pixels and reflections do not count. The standard error is the sandwich
//! √(Σψ²(z − z̄)²) / |Σψ′(z − z̄)(x − x̄)|.
//!
//! Pixels of a mosaic are interpolated from neighbours, whose noise they share. With bilinear interpolation a pixel has the
//! noise of sensor pixels at most 1 px away along x and y, so two pixels have common noise up to 2 px apart. Then z is the
//! mean of four pixels 3 px away, which is independent of the pixel's noise, and the sandwich includes all products of such
//! neighbours, √(Σ Σ ψᵢψⱼ(zᵢ − z̄)(zⱼ − z̄)) (T. Conley, GMM estimation with cross sectional dependence, 1999), for any
//! weights of the interpolation. Interpolation is detected by the correlation of adjacent residuals.

use std::collections::HashMap;

use crate::statistics::{DEVIATION_OF_MEDIAN, median};

/// A pixel of a light.
#[derive(Clone, Debug)]
pub(super) struct LightPixel {
    pub place: [usize; 2],
    /// The mean of the four neighbours in the light's own channel.
    pub near: f64,
    /// The mean of the four pixels [`FAR`] away; absent near the frame's border.
    pub far: Option<f64>,
    /// Every channel.
    pub values: Vec<f64>,
}

/// A channel's share of a light that its own channel reads as 1, and the standard error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Share {
    pub value: f64,
    pub error: f64,
}

/// Largest distance of interpolated pixels with common noise, px, along x and y.
const REACH: usize = 2;
/// Least distance of interpolated pixels without common noise, px.
pub(super) const FAR: usize = REACH + 1;
/// Significance of the correlation of neighbours' residuals, in standard errors: 1/√n for n independent pairs.
const CORRELATED: f64 = 3.0;
/// Tukey's constant: residuals beyond this many standard deviations have no weight.
const TUKEY: f64 = 4.685;
/// Reweighting iterations.
const ROUNDS: usize = 20;
/// If residuals exceed their differences between adjacent pixels by this factor, the pixels follow more than one line.
const UNEVEN: f64 = 3.0;
/// Smaller residuals always pass, in pixel values.
const SMALL_DN: f64 = 0.5;

/// A pixel in the regression.
#[derive(Clone, Copy)]
struct Point {
    place: [usize; 2],
    /// z, x and y.
    instrument: f64,
    own: f64,
    other: f64,
}

/// The share of `channel`; `None` where the pixels do not follow one line.
pub(super) fn slope(pixels: &[LightPixel], own: usize, channel: usize) -> Option<Share> {
    if channel == own {
        return Some(Share { value: 1.0, error: 0.0 });
    }
    let points = |instrument: &dyn Fn(&LightPixel) -> Option<f64>| -> Vec<Point> {
        let point = |pixel: &LightPixel| {
            let (own, other) = (pixel.values[own], pixel.values[channel]);
            Some(Point { place: pixel.place, instrument: instrument(pixel)?, own, other })
        };
        pixels.iter().filter_map(point).collect()
    };
    let fit = Regression::of(points(&|pixel| Some(pixel.near)))?;
    if !fit.hangs_together() {
        return fit.share(0);
    }
    Regression::of(points(&|pixel| pixel.far))?.share(REACH)
}

/// A weighted line through points.
struct Regression {
    points: Vec<Point>,
    weights: Vec<f64>,
    line: Line,
    /// Standard deviation of the residuals.
    deviation: f64,
}

impl Regression {
    fn of(points: Vec<Point>) -> Option<Regression> {
        let mut fit = Regression {
            weights: vec![1.0; points.len()],
            line: Line { offset: 0.0, slope: 0.0 },
            deviation: 0.0,
            points,
        };
        for _ in 0..ROUNDS {
            fit.line = Line::through(&fit.points, &fit.weights)?;
            let residuals: Vec<f64> = fit.points.iter().map(|point| fit.line.residual(point)).collect();
            fit.deviation = spread(residuals.iter().copied());
            if fit.deviation == 0.0 {
                break;
            }
            let weight = |e: &f64| (1.0 - (e / (TUKEY * fit.deviation)).powi(2)).max(0.0).powi(2);
            fit.weights = residuals.iter().map(weight).collect();
        }
        Some(fit)
    }

    /// Pairs of indices of neighbours along rows and columns.
    fn neighbours(&self) -> Vec<[usize; 2]> {
        let numbers: HashMap<[usize; 2], usize> =
            self.points.iter().enumerate().map(|(number, point)| (point.place, number)).collect();
        let beside = |(number, point): (usize, &Point)| {
            let [x, y] = point.place;
            [[x + 1, y], [x, y + 1]]
                .into_iter()
                .filter_map(|place| Some([number, *numbers.get(&place)?]))
                .collect::<Vec<_>>()
        };
        self.points.iter().enumerate().flat_map(beside).collect()
    }

    fn weighted(&self, number: usize) -> f64 {
        self.weights[number] * self.line.residual(&self.points[number])
    }

    fn hangs_together(&self) -> bool {
        let (mut products, mut squares, mut pairs) = (0.0, 0.0, 0.0_f64);
        for [one, other] in self.neighbours() {
            let (a, b) = (self.weighted(one), self.weighted(other));
            (products, squares, pairs) = (products + a * b, squares + 0.5 * (a * a + b * b), pairs + 1.0);
        }
        products > CORRELATED * squares / pairs.sqrt()
    }

    /// The slope with its standard error, for residuals with common noise up to `reach` px apart; `None` where the points
    /// do not follow one line.
    fn share(&self, reach: usize) -> Option<Share> {
        let Regression { points, weights, line, deviation } = self;
        if *deviation == 0.0 {
            return Some(Share { value: line.slope, error: 0.0 });
        }
        if *deviation > SMALL_DN && *deviation > UNEVEN * self.roughness() {
            return None;
        }
        let total: f64 = weights.iter().sum();
        let mean = |value: &dyn Fn(&Point) -> f64| {
            points.iter().zip(weights).map(|(point, weight)| weight * value(point)).sum::<f64>() / total
        };
        let (centre, x) = (mean(&|point| point.instrument), mean(&|point| point.own));
        let mut lever = 0.0;
        let mut scores: HashMap<[usize; 2], f64> = HashMap::with_capacity(points.len());
        for (number, point) in points.iter().enumerate() {
            let u = (line.residual(point) / (TUKEY * deviation)).powi(2);
            let z = point.instrument - centre;
            scores.insert(point.place, self.weighted(number) * z);
            lever += if u < 1.0 { (1.0 - u) * (1.0 - 5.0 * u) * z * (point.own - x) } else { 0.0 };
        }
        let alone: f64 = points.iter().map(|point| scores[&point.place].powi(2)).sum();
        let together = |point: &Point| {
            let [xs, ys] = point.place.map(|at| at.saturating_sub(reach)..=at + reach);
            let near = ys.flat_map(|y| xs.clone().map(move |x| [x, y]));
            scores[&point.place] * near.filter_map(|place| scores.get(&place)).sum::<f64>()
        };
        // Interpolation correlates the noise of neighbours: common noise does not average out.
        let spread = if reach == 0 { alone } else { points.iter().map(together).sum::<f64>().max(alone) };
        Some(Share { value: line.slope, error: spread.sqrt() / lever.abs() })
    }

    /// The residuals' standard deviation from their differences between row neighbours.
    fn roughness(&self) -> f64 {
        let neighbours = self.points.windows(2).filter(|pair| {
            let [[x, y], [next, row]] = [pair[0].place, pair[1].place];
            (x + 1, y) == (next, row)
        });
        let difference = |pair: &[Point]| self.line.residual(&pair[1]) - self.line.residual(&pair[0]);
        spread(neighbours.map(difference)) / std::f64::consts::SQRT_2
    }
}

#[derive(Clone, Copy)]
struct Line {
    offset: f64,
    slope: f64,
}

impl Line {
    fn through(points: &[Point], weights: &[f64]) -> Option<Line> {
        let mean = |value: &dyn Fn(&Point) -> f64| {
            let (mut total, mut sum) = (0.0, 0.0);
            for (point, weight) in points.iter().zip(weights) {
                (total, sum) = (total + weight, sum + weight * value(point));
            }
            sum / total
        };
        let (x, y, z) = (mean(&|p| p.own), mean(&|p| p.other), mean(&|p| p.instrument));
        let over = mean(&|p| (p.instrument - z) * (p.own - x));
        let slope = mean(&|p| (p.instrument - z) * (p.other - y)) / over;
        slope.is_finite().then_some(Line { offset: y - slope * x, slope })
    }

    fn residual(&self, point: &Point) -> f64 {
        point.other - self.offset - self.slope * point.own
    }
}

/// A robust standard deviation.
fn spread(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.map(f64::abs).collect();
    DEVIATION_OF_MEDIAN * median(&mut values).unwrap_or(0.0)
}
