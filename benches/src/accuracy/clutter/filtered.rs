//! How far a target stands out of what its own image finds over the frame that it is in, clutter included.
//!
//! What comes in: the light of a target alone, and the frame without it. What goes out: the signal-to-noise ratio of a
//! matched filter. It never knows a fit.

use isophote_tracker::Frame;

use super::scene::SIZE;

/// The filter reaches to where this share of the target's height is left, …
const RIM: f64 = 0.05;
/// … and so many times as far beyond, with its mean taken off.
const DISC: f64 = 1.5;
/// The filter is applied every so many pixels along x and y.
const STEP: usize = 17;

/// `image`: the target's light alone, about `centre`. The scatter is the standard deviation of what the filter finds.
pub fn ratio(image: &[f64], centre: [f64; 2], frame: &Frame) -> f64 {
    let [width, height] = SIZE.map(|side| side as i64);
    let middle = centre.map(|at| at.round() as i64);
    let most = image.iter().copied().fold(0.0, f64::max);
    let place = |pixel: usize| [pixel as i64 % width - middle[0], pixel as i64 / width - middle[1]];
    let distance = |[dx, dy]: [i64; 2]| ((dx * dx + dy * dy) as f64).sqrt();
    let lit = (0..image.len()).filter(|pixel| image[*pixel] > RIM * most);
    let disc = DISC * lit.map(|pixel| distance(place(pixel))).fold(1.0, f64::max);
    let pixels = (0..image.len()).filter(|pixel| distance(place(*pixel)) <= disc);
    let weights: Vec<([i64; 2], f64)> = pixels.map(|pixel| (place(pixel), image[pixel])).collect();
    let mean = weights.iter().map(|(_, weight)| weight).sum::<f64>() / weights.len() as f64;
    let own = weights.iter().map(|(_, weight)| (weight - mean).powi(2)).sum::<f64>();
    let plane = frame.plane_view(0);
    let found = |x: i64, y: i64| {
        let at = |[dx, dy]: [i64; 2]| plane.pixel_at([(x + dx) as usize, (y + dy) as usize, 0, 0]);
        weights.iter().map(|(place, weight)| (weight - mean) * at(*place)).sum::<f64>() / own
    };
    let reach = disc.ceil() as i64;
    let along = |side: i64| (reach..side - reach).step_by(STEP);
    let found: Vec<f64> =
        along(height).flat_map(|y| along(width).map(move |x| (x, y))).map(|(x, y)| found(x, y)).collect();
    let n = found.len() as f64;
    let mean = found.iter().sum::<f64>() / n;
    (found.iter().map(|one| (one - mean).powi(2)).sum::<f64>() / n).sqrt().recip()
}
