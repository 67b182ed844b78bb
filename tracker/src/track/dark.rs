//! Whether there is anything at all where a target should be: a dark frame is told from one that shows something by one pass
//! over the pixels of a window, before anything is fitted.
//!
//! What comes in: a frame, the start of a fit, and how large the target was. What goes out: yes or no. It never knows what the
//! target looks like: what is brighter or darker than its surroundings on the scale of the target is something.
//!
//! 1. Where the target's middle is clearly brighter or darker than what is around it, by a few pixels of each, there is something:
//!    a frame in which the target is seen costs no more than that.
//! 2. Else, in the window of a fit, a plane through all pixels is taken away, and what is left is summed over boxes of about the target's size all over the
//!    window. The noise is that of differences of neighbouring pixels, so whatever hangs together counts as
//!    something, too. Where no sum is [`EVEN`] standard deviations off there is nothing that a fit would be believed of.

use isophote_jit::Window;

use super::faint::SIGNIFICANT;
use super::solver::{Look, Solver};
use super::window::Margin;
use crate::sight::background::median;
use crate::sight::grey::{Grey, Mixture};

/// No sum of an even window is so many of its standard deviations off. A box has seven eighths of the significance of a target of
/// its size, and the plane takes a seventh of that: this is what a target leaves that is brighter than noise.
const EVEN: f64 = 0.75 * SIGNIFICANT;
/// Sides of the boxes, in half widths of the target.
const SIDES: [f64; 2] = [0.8, 1.6];
/// From one box to the next there are so many parts of a side: of boxes at every pixel many more of noise alone are far off.
const PARTS: usize = 4;
/// Pixels along a side that the first glance takes of the middle, and of a square around the target.
const GLANCE: usize = 4;
/// Half the side of either, in half widths of the target.
const MIDDLE: f64 = 0.6;
const AROUND: f64 = 2.0;
/// The two differ clearly by so many standard deviations.
const CLEAR: f64 = 6.0;
/// Pairs of neighbours that the noise is told from, about.
const PAIRS: usize = 1024;
/// A difference of so many times the usual one is an edge.
const EDGE: f64 = 6.0;

impl Solver {
    /// True where the window about `start`, larger by `margin`, shows nothing of the size of a target of that half width, px.
    /// Only of models of one target with a centre in two dimensions; of others nothing is said.
    pub(super) fn is_dark(&self, look: &Look, start: &[f64], margin: Margin, half_px: Option<f64>) -> bool {
        let (model, Some(half_px)) = (self.model(), half_px) else { return false };
        let [roles] = model.roles() else { return false };
        let [x, y] = roles.centre[..] else { return false };
        let is_suited = model.coordinates().len() == 2 && model.entries() == 1 && !self.fits_pose() && self.reaches();
        if !is_suited {
            return false;
        }
        let centre = [x, y].map(|centre| start[centre.index()]);
        let plane = model.observed_channel().map(|channel| &look.planes[channel.index()]);
        if plane.is_some_and(|plane| is_clear(look.window, centre, half_px, |[x, y]| plane.pixel_at([x, y, 0, 0]))) {
            return false;
        }
        let window = self.window(look, start, margin);
        let side = |share: f64| (share * half_px).round().max(1.0);
        if 2.0 * side(SIDES[1]) > window.width.min(window.height) as f64 {
            return false;
        }
        let view = self.view(look, window);
        let mixture = Mixture::observed(model, &self.constants);
        let grey = Grey::read(&view.planes, window, &view.saturation, &mixture);
        grey.saturated() == 0 && is_even(&grey, SIDES.map(|share| side(share) as usize))
    }
}

/// The middle of a target is clearly brighter or darker than what is around it in `window`.
fn is_clear(window: Window, centre: [f64; 2], half_px: f64, value: impl Fn([usize; 2]) -> f64) -> bool {
    let (first, size) = ([window.x, window.y], [window.width, window.height]);
    // So many half widths from the centre.
    let at = |off: [f64; 2]| {
        let place = |axis: usize| {
            let place = (centre[axis] + half_px * off[axis]).round().max(0.0) as usize;
            place.clamp(first[axis], first[axis] + size[axis] - 1)
        };
        value([0, 1].map(place))
    };
    let step = |number: usize| 2.0 * (number as f64 + 0.5) / GLANCE as f64 - 1.0;
    let middle = (0..GLANCE * GLANCE).map(|i| at([i % GLANCE, i / GLANCE].map(|number| MIDDLE * step(number))));
    let around = (0..GLANCE).flat_map(|i| {
        let along = AROUND * step(i);
        [[along, -AROUND], [along, AROUND], [-AROUND, along], [AROUND, along]].map(at)
    });
    let [(middle, spread), (ground, noise)] = [moments(middle), moments(around)];
    (middle - ground).powi(2) > CLEAR.powi(2) * (spread + noise) / (GLANCE * GLANCE) as f64
}

/// Mean and variance.
fn moments(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (mut count, mut sum, mut squares) = (0.0, 0.0, 0.0);
    for value in values {
        (count, sum, squares) = (count + 1.0, sum + value, squares + value * value);
    }
    let mean = sum / count;
    (mean, (squares / count - mean * mean).max(0.0))
}

/// No box of these sides holds more than noise would.
fn is_even(grey: &Grey, sides: [usize; 2]) -> bool {
    let [width, height, ..] = grey.size;
    let noise = noise(grey);
    let plane = Plane::through(grey);
    // Sums of all pixels above and to the left.
    let across = width + 1;
    let mut sums = vec![0.0; across * (height + 1)];
    for (y, row) in grey.values.chunks_exact(width).enumerate() {
        let mut sum = 0.0;
        for (x, value) in row.iter().enumerate() {
            sum += value - plane.at(x, y);
            sums[(y + 1) * across + x + 1] = sums[y * across + x + 1] + sum;
        }
    }
    sides.into_iter().filter(|side| *side <= width.min(height)).all(|side| {
        let most = EVEN * noise * side as f64;
        let stride = (side / PARTS).max(1);
        (0..=height - side).step_by(stride).all(|y| {
            let (upper, lower) = (&sums[y * across..][..across], &sums[(y + side) * across..][..across]);
            (0..=width - side).step_by(stride).all(|x| {
                let sum = lower[x + side] - lower[x] - upper[x + side] + upper[x];
                sum.abs() <= most
            })
        })
    })
}

/// The standard deviation of a pixel, from differences of neighbours. Their mean square, since of whole pixel values the median is
/// a whole number.
fn noise(grey: &Grey) -> f64 {
    let every = (grey.values.len() / PAIRS).max(1);
    let steps: Vec<f64> = grey.values.windows(2).step_by(every).map(|two| (two[1] - two[0]).abs()).collect();
    let edge = EDGE * median(&steps).max(grey.step);
    let (count, squares) = steps
        .iter()
        .filter(|step| **step <= edge)
        .fold((0.0_f64, 0.0), |(count, squares), step| (count + 1.0, squares + step * step));
    (0.5 * squares / count.max(1.0)).sqrt().max(grey.step / 12.0_f64.sqrt())
}

/// The plane of least squares through all pixels of a picture.
struct Plane {
    level: f64,
    slope: [f64; 2],
    middle: [f64; 2],
}

impl Plane {
    fn through(grey: &Grey) -> Plane {
        let [width, height, ..] = grey.size;
        let middle = [width, height].map(|count| (count - 1) as f64 / 2.0);
        let (mut sum, mut moment) = (0.0, [0.0; 2]);
        for (y, row) in grey.values.chunks_exact(width).enumerate() {
            let mut of_row = 0.0;
            for (x, value) in row.iter().enumerate() {
                of_row += value;
                moment[0] += value * (x as f64 - middle[0]);
            }
            sum += of_row;
            moment[1] += of_row * (y as f64 - middle[1]);
        }
        let count = grey.values.len() as f64;
        // Σ (x − x̄)² of n places in a row is n (n² − 1)/12.
        let slope = |axis: usize, n: usize| {
            let squares = count * ((n * n) as f64 - 1.0) / 12.0;
            if squares > 0.0 { moment[axis] / squares } else { 0.0 }
        };
        Plane { level: sum / count, slope: [slope(0, width), slope(1, height)], middle }
    }

    fn at(&self, x: usize, y: usize) -> f64 {
        self.level + self.slope[0] * (x as f64 - self.middle[0]) + self.slope[1] * (y as f64 - self.middle[1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::Noise;

    /// A sloping ground with noise of 2 DN and a Gaussian of σ 6 px in the middle.
    fn picture(seed: u64, height: f64) -> Grey {
        let mut noise = Noise(0x5851_F42D_4C95_7F2D ^ (seed + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15));
        let value = |i: usize| {
            let (x, y) = ((i % 60) as f64, (i / 60) as f64);
            let light = height * (-((x - 29.3).powi(2) + (y - 24.6).powi(2)) / 72.0).exp();
            (80.0 + 0.2 * x - 0.1 * y + light + 2.0 * noise.normal()).round()
        };
        let values = (0..60 * 50).map(value).collect();
        Grey { values, size: [60, 50, 1, 1], saturation: 255.0, step: 1.0 }
    }

    /// Half of its width at 1/e² is 12 px.
    const SIDES_PX: [usize; 2] = [10, 19];

    #[test]
    fn noise_on_a_slope_is_even() {
        let count = (0..100).filter(|seed| is_even(&picture(*seed, 0.0), SIDES_PX)).count();
        assert!(count >= 90, "{count} of 100");
    }

    #[test]
    fn a_target_that_a_fit_would_be_believed_of_is_not() {
        // A height h is worth h σ √π over the noise of a pixel: seven standard deviations.
        let height = 7.0 * 2.0 / (6.0 * std::f64::consts::PI.sqrt());
        for sign in [1.0, -1.0] {
            let count = (0..100).filter(|seed| is_even(&picture(*seed, sign * height), SIDES_PX)).count();
            assert!(count <= 8, "{count} of 100");
        }
    }

    #[test]
    fn what_hangs_together_is_not() {
        let mut stripes = picture(3, 0.0);
        stripes
            .values
            .iter_mut()
            .enumerate()
            .for_each(|(i, value)| *value += if i % 60 / 15 % 2 == 0 { 2.0 } else { 0.0 });
        assert!(!is_even(&stripes, SIDES_PX));
    }

    #[test]
    fn a_glance_sees_a_target_and_no_noise() {
        let window = Window::of_size([60, 50, 1, 1]);
        let glance = |grey: &Grey| is_clear(window, [29.3, 24.6], 12.0, |[x, y]| grey.values[60 * y + x]);
        assert!((0..50).all(|seed| glance(&picture(seed, 40.0)) && glance(&picture(seed, -40.0))));
        assert!((0..50).all(|seed| !glance(&picture(seed, 0.0))));
    }
}
