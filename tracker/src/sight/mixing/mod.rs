//! Measures the mixing matrix of a colour camera from frames that show one light at a time, or several apart from each
//! other.
//!
//! Rows are channels, columns are lights; a light reads 1 in its own channel, the one in which it is brightest. Entries
//! have standard errors.
//!
//! 1. Bright components of the channels' mean are lights ([`crate::sight::start`]).
//! 2. A light's own channel is the one that reads most of it where no channel clips.
//! 3. Every other channel's share is the slope of that channel over the own one, pixel by pixel ([`slope`]). The offset is free, so
//!    neither black level nor an even background matters.
//! 4. Several views of a light are averaged with their inverse variances.

mod slope;

use isophote_jit::{PlaneView, Window};

use crate::sight::grey::{Grey, Mixture};
use crate::sight::start::{Detection, FindOptions, Sign, find};
use crate::sight::view::largest_value;
use isophote_frame::Frame;
use slope::{FAR, LightPixel, Share, slope};

/// Most lights per frame.
const LIGHTS_MAX: usize = 16;
/// Components with less light than this share of the frame's first are ignored.
const MASS_SHARE: f64 = 0.02;
/// Largest dᵀAd of a light's pixels: the spot and a little background.
const INSIDE: f64 = 1.3;
/// Fewest pixels for a slope.
const PIXELS_MIN: usize = 40;
/// Half as many must exceed this share of the peak.
const LIT: f64 = 0.1;
/// Pixels whose neighbours exceed this share of the limit are left out: otherwise noise would select among them.
const BELOW_LIMIT: f64 = 0.95;
/// Cosine of the angle between two columns from which on they are the same colour.
const SAME: f64 = 0.98;
/// Largest difference of two views of a light, beside five standard errors.
const VIEWS_DIFFER: f64 = 0.05;

/// A measured mixing matrix.
#[derive(Clone, Debug, PartialEq)]
pub struct Mixing {
    /// Rows: channels; columns: lights, in the channels' order.
    pub matrix: Vec<Vec<f64>>,
    /// Standard errors; 0 on the diagonal, which is 1 by definition.
    pub errors: Vec<Vec<f64>>,
    /// Pixels used for each light.
    pub pixels: Vec<usize>,
}

/// Why there is none. Channels are counted from 0.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MixingError {
    /// A frame that has other planes than the first, or fewer than two.
    #[error("a frame has {found} channels, {wanted} are needed")]
    Planes {
        /// Planes of the frame.
        found: usize,
        /// Planes that the measurement needs.
        wanted: usize,
    },
    /// Nothing is brightest in this channel.
    #[error("no light is brightest in channel {channel}")]
    NoLight {
        /// The channel.
        channel: usize,
        /// Number of lights that are brightest in each channel.
        seen: Vec<usize>,
    },
    /// The light's channel is clipped wherever there is light.
    #[error("the light of channel {0} is clipped everywhere")]
    Clipped(usize),
    /// Two lights of the same colour.
    #[error("two lights have the same colour: that of channel {0} and that of channel {1}")]
    SameColour(usize, usize),
    /// Two different colours in views of one light.
    #[error("two lights are brightest in channel {0}, of different colours")]
    TwoLights(usize),
    /// A light that has several colours.
    #[error("what is brightest in channel {0} has more than one colour")]
    Mixed(usize),
}

/// A measurement to which frames are added.
#[derive(Clone, Debug)]
pub struct MixingMeasurement {
    channels: usize,
    saturation: Option<f64>,
    views: Vec<View>,
    /// Channels that clip wherever a light is.
    clipped: Vec<usize>,
}

/// One light in one frame.
#[derive(Clone, Debug)]
struct View {
    own: usize,
    shares: Vec<Share>,
    pixels: usize,
}

impl MixingMeasurement {
    /// For this many channels; `saturation` in pixel values, by default the largest that frames can hold.
    pub fn new(channels: usize, saturation: Option<f64>) -> MixingMeasurement {
        MixingMeasurement { channels, saturation, views: Vec::new(), clipped: Vec::new() }
    }

    /// Adds a frame's lights, of its first slice.
    pub fn add(&mut self, frame: &Frame) -> Result<(), MixingError> {
        let planes: Vec<PlaneView> = (0..frame.planes().len()).map(|number| frame.plane_view(number)).collect();
        if planes.len() != self.channels || self.channels < 2 {
            return Err(MixingError::Planes { found: planes.len(), wanted: self.channels.max(2) });
        }
        let largest = frame.largest.unwrap_or(f64::INFINITY).min(largest_value(planes[0].format()));
        let limit = self.saturation.unwrap_or(largest);
        let window = Window::whole(frame.width(), frame.rows());
        let limits = vec![limit; planes.len()];
        let grey = Grey::read(&planes, window, &limits, &Mixture::mean(planes.len()));
        let options =
            FindOptions { sign: Some(Sign::Bright), targets_max: LIGHTS_MAX, faint: true, ..FindOptions::default() };
        let found = find(&grey, &options, &|_| Ok(())).map_or_else(|_| Vec::new(), |found| found.detections);
        let mass = |detection: &Detection| detection.amplitude * detection.size[0] * detection.size[1];
        let most = found.first().map_or(0.0, mass);
        for detection in found.iter().filter(|detection| mass(detection) > MASS_SHARE * most) {
            self.add_light(&planes, window, limit, detection)?;
        }
        Ok(())
    }

    fn add_light(
        &mut self,
        planes: &[PlaneView],
        window: Window,
        limit: f64,
        detection: &Detection,
    ) -> Result<(), MixingError> {
        let places = places(detection, window);
        let read = |[x, y]: [usize; 2]| -> Vec<f64> { planes.iter().map(|plane| plane.pixel(x, y)).collect() };
        let is_whole = |values: &[f64]| values.iter().all(|value| *value < limit);
        let pixels: Vec<([usize; 2], Vec<f64>)> = places.iter().map(|place| (*place, read(*place))).collect();
        let seen = || pixels.iter().filter(|(_, values)| is_whole(values));
        let least = |channel: usize| pixels.iter().map(|(_, v)| v[channel]).fold(f64::INFINITY, f64::min);
        let light = |channel: usize| seen().map(|(_, values)| values[channel] - least(channel)).sum::<f64>();
        let clips = |channel: usize| pixels.iter().filter(|(_, values)| values[channel] >= limit).count();
        let most_of = |value: &dyn Fn(usize) -> f64| {
            (0..self.channels).rev().max_by(|a, b| value(*a).total_cmp(&value(*b))).unwrap_or(0)
        };
        let own = most_of(&light);
        let mut points: Vec<LightPixel> = Vec::new();
        for ([x, y], values) in seen() {
            let around = [[x + 1, *y], [x - 1, *y], [*x, y + 1], [*x, y - 1]].map(&read);
            let mean = around.iter().map(|values| values[own]).sum::<f64>() / 4.0;
            if mean < BELOW_LIMIT * limit && around.iter().all(|values| is_whole(values)) {
                let is_inside = (FAR..window.width.saturating_sub(FAR)).contains(x)
                    && (FAR..window.height.saturating_sub(FAR)).contains(y);
                let far = || {
                    [[x + FAR, *y], [x - FAR, *y], [*x, y + FAR], [*x, y - FAR]].map(|[x, y]| planes[own].pixel(x, y))
                };
                let far = is_inside.then(|| far().iter().sum::<f64>() / 4.0);
                points.push(LightPixel { place: [*x, *y], near: mean, far, values: values.clone() });
            }
        }
        let instruments = || points.iter().map(|point| point.near);
        let ground = instruments().fold(f64::INFINITY, f64::min);
        let peak = pixels.iter().map(|(_, values)| values[own]).fold(0.0, f64::max);
        let lit = instruments().filter(|mean| mean - ground > LIT * (peak - ground)).count();
        if points.len() < PIXELS_MIN || lit < PIXELS_MIN / 2 {
            // Where several channels clip alike, the light may be that of any.
            let most = (0..self.channels).map(clips).max().unwrap_or(0);
            self.clipped.extend((0..self.channels).filter(|channel| most > 0 && 10 * clips(*channel) >= 9 * most));
            return Ok(());
        }
        let shares: Option<Vec<Share>> = (0..self.channels).map(|channel| slope(&points, own, channel)).collect();
        let shares = shares.ok_or(MixingError::Mixed(own))?;
        self.views.push(View { own, shares, pixels: points.len() });
        Ok(())
    }

    /// The matrix from all frames.
    pub fn finish(self) -> Result<Mixing, MixingError> {
        let n = self.channels;
        let (mut matrix, mut errors, mut pixels) = (vec![vec![0.0; n]; n], vec![vec![0.0; n]; n], vec![0; n]);
        let views = |light: usize| self.views.iter().filter(move |view| view.own == light);
        for light in 0..n {
            if views(light).next().is_none() {
                let seen = (0..n).map(|channel| views(channel).count()).collect();
                return Err(match self.clipped.contains(&light) {
                    true => MixingError::Clipped(light),
                    false => MixingError::NoLight { channel: light, seen },
                });
            }
            pixels[light] = views(light).map(|view| view.pixels).sum();
            for channel in 0..n {
                let shares: Vec<Share> = views(light).map(|view| view.shares[channel]).collect();
                let mean = mean(&shares);
                if shares.iter().any(|share| (share.value - mean.value).abs() > VIEWS_DIFFER + 5.0 * share.error) {
                    return Err(MixingError::TwoLights(light));
                }
                (matrix[channel][light], errors[channel][light]) = (mean.value, mean.error);
            }
        }
        let product = |a: usize, b: usize| matrix.iter().map(|row| row[a] * row[b]).sum::<f64>();
        for (a, b) in (0..n).flat_map(|a| (a + 1..n).map(move |b| (a, b))) {
            if product(a, b) > SAME * (product(a, a) * product(b, b)).sqrt() {
                return Err(MixingError::SameColour(a, b));
            }
        }
        Ok(Mixing { matrix, errors, pixels })
    }
}

/// Pixels of a detection with four neighbours.
fn places(detection: &Detection, window: Window) -> Vec<[usize; 2]> {
    let [cx, cy, ..] = detection.centre;
    let [[a1, a2, ..], [_, a3, ..], ..] = detection.extent;
    let side = |centre: f64, half: f64, count: usize| {
        let reach = INSIDE.sqrt() * half + 1.0;
        let first = (centre - reach).floor().max(1.0) as usize;
        let end = ((centre + reach).ceil().max(0.0) as usize + 1).min(count.saturating_sub(1));
        first..end.max(first)
    };
    let (xs, ys) = (side(cx, detection.size[0], window.width), side(cy, detection.size[1], window.height));
    let all = ys.flat_map(|y| xs.clone().map(move |x| [x, y]));
    let is_inside = |[x, y]: &[usize; 2]| {
        let (x, y) = (*x as f64 - cx, *y as f64 - cy);
        a1 * x * x + 2.0 * a2 * x * y + a3 * y * y <= INSIDE
    };
    all.filter(is_inside).collect()
}

/// The mean weighted by inverse variances; unweighted for zero errors.
fn mean(shares: &[Share]) -> Share {
    let weight = |share: &Share| share.error.max(f64::MIN_POSITIVE.sqrt()).powi(-2);
    let total: f64 = shares.iter().map(weight).sum();
    let value = shares.iter().map(|share| weight(share) * share.value).sum::<f64>() / total;
    let exact = shares.iter().all(|share| share.error == 0.0);
    Share { value, error: if exact { 0.0 } else { total.sqrt().recip() } }
}

#[cfg(test)]
mod tests;
