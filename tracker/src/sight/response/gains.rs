//! The gain of each pixel from frames of an even field.
//!
//! A pixel's gain is its light over that of its surroundings: the field's own slope and curvature, a polynomial of second degree in x
//! and y, are not the sensor's. What two halves of the frames say differently is how sure that is; the rest is what pixels differ by
//! (the photo response non-uniformity of EMVA 1288), and each gain is drawn towards 1 by as much as it is unsure.

use isophote_frame::{Frame, GainMap, Response};
use nalgebra::{SMatrix, SVector};

/// Pixels whose gain is farther from 1 are defects, for the map of those.
const FAR: f64 = 0.25;
/// So many standard deviations more than noise pixels differ by, where they have gains of their own.
const SURE: f64 = 5.0;
/// Surfaces that are laid through the field, each without what lies far from the one before.
const ROUNDS: usize = 3;
/// Of differences that are normally distributed, the standard deviation over the median of their magnitudes.
const NORMAL: f64 = 1.4826;

/// What was found.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasuredGains {
    /// The gains; absent where pixels do not differ by more than noise.
    pub map: Option<GainMap>,
    /// The standard deviation of pixels' gains, and one standard deviation of that; where there is no map, 0 and what it does not exceed.
    pub nonuniformity: [f64; 2],
    /// By how much a gain of the map may be off, one standard deviation.
    pub sigma: f64,
    /// Pixels that are so far off that their gain is left at 1.
    pub left_out: usize,
}

/// A measurement that takes frame after frame of one size and plane.
#[derive(Debug)]
pub struct GainMeasurement {
    response: Response,
    size: [usize; 2],
    /// Light of each pixel, of every other frame.
    halves: [Vec<f64>; 2],
    /// The mean of these.
    totals: [f64; 2],
    frames: usize,
}

impl GainMeasurement {
    /// One that has seen nothing yet, of a camera with that response.
    pub fn new(response: Response) -> GainMeasurement {
        GainMeasurement { response, size: [0; 2], halves: Default::default(), totals: [0.0; 2], frames: 0 }
    }

    /// Takes a picture of an even field, in any light; one of several planes, or of another size than the first, says nothing.
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

    /// The answer from all of them; none from fewer than two pictures.
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
        if sound == 0 {
            return None;
        }
        let median = differences.select_nth_unstable_by(sound / 2, f64::total_cmp).1;
        // Two halves of unequal light: 1/a + 1/b of one's variance for each DN, 1/(a + b) of both.
        let noise = (NORMAL * *median).powi(2) * a * b / (a + b).powi(2);
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

/// The polynomial of second degree through a field, at each of its pixels.
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
