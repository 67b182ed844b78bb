//! The slope of one channel over another, from noisy pixels of both.
//!
//! Both channels are noisy, so a plain regression is too flat: noise of the own channel counts as light. The mean of a
//! pixel's four neighbours in the own channel, z, knows the light and none of the pixel's own noise; with it as instrument
//! b = Σw(z − z̄)(y − ȳ) / Σw(z − z̄)(x − x̄) is right whatever the noise is, and needs no model of it. (Two-stage least
//! squares; J. Wooldridge, Econometric Analysis of Cross Section and Panel Data, chapter 5.) w are Tukey's weights of the
//! residuals e = y − a − bx, so that hot pixels and reflections do not count. The standard error is the sandwich
//! √(Σψ²(z − z̄)²) / |Σψ′(z − z̄)(x − x̄)|.

/// Of a light's pixel.
#[derive(Clone, Debug)]
pub(super) struct LightPixel {
    pub place: [usize; 2],
    /// The mean of the neighbours in the light's own channel.
    pub instrument: f64,
    /// Every channel.
    pub values: Vec<f64>,
}

/// What a channel reads of a light that its own channel reads as 1, and the standard error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Share {
    pub value: f64,
    pub error: f64,
}

/// Tukey's constant: residuals of more standard deviations count nothing.
const TUKEY: f64 = 4.685;
/// Rounds of new weights.
const ROUNDS: usize = 20;
/// Median absolute deviation to standard deviation.
const NORMAL: f64 = 1.4826;
/// Residuals that are so much larger than their differences from pixel to pixel follow more than one line, …
const UNEVEN: f64 = 3.0;
/// … unless they are under this many pixel values.
const SMALL_DN: f64 = 0.5;

/// The share of `channel`; `None` where the pixels follow no line.
pub(super) fn slope(points: &[LightPixel], own: usize, channel: usize) -> Option<Share> {
    if channel == own {
        return Some(Share { value: 1.0, error: 0.0 });
    }
    let mut weights = vec![1.0; points.len()];
    let mut line = Line { offset: 0.0, slope: 0.0 };
    let mut deviation = 0.0;
    for _ in 0..ROUNDS {
        line = Line::through(points, &weights, own, channel)?;
        let residuals: Vec<f64> = points.iter().map(|point| line.residual(point, own, channel)).collect();
        deviation = spread(residuals.iter().copied());
        if deviation == 0.0 {
            return Some(Share { value: line.slope, error: 0.0 });
        }
        let weight = |e: &f64| (1.0 - (e / (TUKEY * deviation)).powi(2)).max(0.0).powi(2);
        weights = residuals.iter().map(weight).collect();
    }
    if deviation > SMALL_DN && deviation > UNEVEN * roughness(points, &line, own, channel) {
        return None;
    }
    let total: f64 = weights.iter().sum();
    let centre = points.iter().zip(&weights).map(|(point, w)| w * point.instrument).sum::<f64>() / total;
    let (mut spread, mut lever) = (0.0, 0.0);
    let x = points.iter().zip(&weights).map(|(point, w)| w * point.values[own]).sum::<f64>() / total;
    for (point, weight) in points.iter().zip(&weights) {
        let e = line.residual(point, own, channel);
        let u = (e / (TUKEY * deviation)).powi(2);
        let z = point.instrument - centre;
        spread += (weight * e * z).powi(2);
        lever += if u < 1.0 { (1.0 - u) * (1.0 - 5.0 * u) * z * (point.values[own] - x) } else { 0.0 };
    }
    Some(Share { value: line.slope, error: spread.sqrt() / lever.abs() })
}

struct Line {
    offset: f64,
    slope: f64,
}

impl Line {
    fn through(points: &[LightPixel], weights: &[f64], own: usize, channel: usize) -> Option<Line> {
        let mean = |value: &dyn Fn(&LightPixel) -> f64| {
            let (mut total, mut sum) = (0.0, 0.0);
            for (point, weight) in points.iter().zip(weights) {
                (total, sum) = (total + weight, sum + weight * value(point));
            }
            sum / total
        };
        let (x, y, z) = (mean(&|p| p.values[own]), mean(&|p| p.values[channel]), mean(&|p| p.instrument));
        let over = mean(&|p| (p.instrument - z) * (p.values[own] - x));
        let slope = mean(&|p| (p.instrument - z) * (p.values[channel] - y)) / over;
        slope.is_finite().then_some(Line { offset: y - slope * x, slope })
    }

    fn residual(&self, point: &LightPixel, own: usize, channel: usize) -> f64 {
        point.values[channel] - self.offset - self.slope * point.values[own]
    }
}

/// A standard deviation that outliers do not move.
fn spread(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.map(f64::abs).collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).map_or(0.0, |median| NORMAL * median)
}

/// The residuals' standard deviation by their differences between neighbours along a row.
fn roughness(points: &[LightPixel], line: &Line, own: usize, channel: usize) -> f64 {
    let neighbours = points.windows(2).filter(|pair| {
        let [[x, y], [next, row]] = [pair[0].place, pair[1].place];
        (x + 1, y) == (next, row)
    });
    let difference =
        |pair: &[LightPixel]| line.residual(&pair[1], own, channel) - line.residual(&pair[0], own, channel);
    spread(neighbours.map(difference)) / std::f64::consts::SQRT_2
}
