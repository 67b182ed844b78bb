//! Measures each pixel's gain from frames of an even field.
//!
//! A pixel's gain is its light relative to its surroundings: the field's own slope and curvature, a polynomial of second
//! degree in x and y, are not the sensor's. The difference between two halves of the frames gives the uncertainty; the
//! remaining scatter is that of the pixels (the photo response non-uniformity of EMVA 1288), and each gain is shrunk
//! towards 1 by its uncertainty.

use isophote_frame::{Frame, GainMap, Response};
use nalgebra::{SMatrix, SVector};

use crate::statistics::{DEVIATION_OF_MEDIAN, median};

/// Pixels with a gain farther from 1 are left to the defect map.
const FAR: f64 = 0.25;
/// Significance of the pixels' scatter beyond noise, in standard deviations.
const SURE: f64 = 5.0;
/// Iterations of the surface fit, each without the outliers of the previous one.
const ROUNDS: usize = 3;

/// The result.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasuredGains {
    /// The gains; absent where the scatter does not exceed noise.
    pub map: Option<GainMap>,
    /// The standard deviation of pixels' gains, and its own; without a map, 0 and an upper limit.
    pub nonuniformity: [f64; 2],
    /// Standard error of a gain in the map.
    pub sigma: f64,
    /// Outlier pixels whose gain is left at 1.
    pub left_out: usize,
}

/// A measurement to which frames of one size and plane are added.
#[derive(Debug)]
pub struct GainMeasurement {
    response: Response,
    size: [usize; 2],
    /// Summed light of each pixel, of every other frame.
    halves: [Vec<f64>; 2],
    /// The means of these.
    totals: [f64; 2],
    frames: usize,
}

impl GainMeasurement {
    /// A measurement without frames, for a camera with this response.
    pub fn new(response: Response) -> GainMeasurement {
        GainMeasurement { response, size: [0; 2], halves: Default::default(), totals: [0.0; 2], frames: 0 }
    }

    /// Adds a picture of an even field, at any light level; ignores one of several planes, or of another size than the
    /// first.
    pub fn add(&mut self, frame: &Frame) {
        let size = [frame.width(), frame.rows()];
        if frame.planes().len() != 1 || frame.size().len() != 2 || (self.frames > 0 && size != self.size) {
            return;
        }
        self.size = size;
        let linear = frame.linear(&self.response);
        let view = linear.plane_view(0);
        let half = self.frames % 2;
        let sums = &mut self.halves[half];
        sums.resize(size[0] * size[1], 0.0);
        let places = (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (x, y)));
        let mut total = 0.0;
        for (sum, (x, y)) in sums.iter_mut().zip(places) {
            let light = view.pixel(x, y);
            *sum += light;
            total += light;
        }
        self.totals[half] += total / (size[0] * size[1]) as f64;
        self.frames += 1;
    }

    /// The result from all frames; `None` from fewer than two.
    pub fn finish(self) -> Option<MeasuredGains> {
        if self.frames < 2 || self.totals.iter().any(|total| *total <= 0.0) {
            return None;
        }
        let [a, b] = self.totals;
        let [first, second] = &self.halves;
        let field: Vec<f64> = first.iter().zip(second).map(|(first, second)| (first + second) / (a + b)).collect();
        let surface = surface(&field, self.size);
        let mut gains: Vec<f64> = field.iter().zip(&surface).map(|(light, even)| light / even).collect();
        let is_sound = |gain: f64| (gain - 1.0).abs() <= FAR;
        let mut differences: Vec<f64> = (first.iter().zip(second).zip(&surface).zip(&gains))
            .filter(|(_, gain)| is_sound(**gain))
            .map(|(((first, second), even), _)| ((first / a - second / b) / even).abs())
            .collect();
        let sound = differences.len();
        let median = median(&mut differences)?;
        // For halves of unequal light: the difference has 1/a + 1/b of the variance per DN, the mean 1/(a + b).
        let noise = (DEVIATION_OF_MEDIAN * median).powi(2) * a * b / (a + b).powi(2);
        let scatter = gains.iter().filter(|gain| is_sound(**gain)).map(|gain| (gain - 1.0).powi(2)).sum::<f64>();
        let scatter = scatter / sound as f64;
        let scatter_sigma = scatter * (2.0 / sound as f64).sqrt();
        let own = scatter - noise;
        if own.is_nan() || own < SURE * scatter_sigma {
            let nonuniformity = [0.0, (own.max(0.0) + 2.0 * scatter_sigma).sqrt()];
            return Some(MeasuredGains { map: None, nonuniformity, sigma: nonuniformity[1], left_out: 0 });
        }
        let sure = own / scatter;
        for gain in &mut gains {
            *gain = if is_sound(*gain) { 1.0 + sure * (*gain - 1.0) } else { 1.0 };
        }
        let map = Some(GainMap::of(self.size[0], self.size[1], &gains));
        let nonuniformity = [own.sqrt(), 0.5 * scatter_sigma / own.sqrt()];
        Some(MeasuredGains { map, nonuniformity, sigma: (sure * noise).sqrt(), left_out: gains.len() - sound })
    }
}

/// The second-degree polynomial fitted to a field, at each of its pixels.
fn surface(field: &[f64], [width, height]: [usize; 2]) -> Vec<f64> {
    let across = |at: usize, side: usize| 2.0 * at as f64 / (side.max(2) - 1) as f64 - 1.0;
    let powers = |place: usize| {
        let (x, y) = (across(place % width, width), across(place / width, height));
        SVector::<f64, 6>::from([1.0, x, y, x * x, x * y, y * y])
    };
    let mut surface = vec![1.0; field.len()];
    for _ in 0..ROUNDS {
        let (mut sums, mut right) = (SMatrix::<f64, 6, 6>::zeros(), SVector::<f64, 6>::zeros());
        for (place, (light, even)) in field.iter().zip(&surface).enumerate() {
            if (light / even - 1.0).abs() <= FAR {
                let powers = powers(place);
                sums += powers * powers.transpose();
                right += powers * *light;
            }
        }
        let Some(found) = sums.cholesky().map(|sums| sums.solve(&right)) else { break };
        surface.iter_mut().enumerate().for_each(|(place, even)| *even = powers(place).dot(&found));
    }
    surface
}
