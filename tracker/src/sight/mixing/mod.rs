//! Mixing: how much of each light every channel reads, measured from frames.
//!
//! What comes in: colour frames that show one light at a time, or several apart from each other. What goes out: the mixing
//! matrix (rows: channels; columns: lights; a light reads 1 in its own channel) with standard errors. It never knows a
//! model: a light is called after the channel in which it is brightest.
//!
//! 1. What stands out in the mean of the channels is a light ([`crate::sight::start`]).
//! 2. Its own channel is the one that reads most of it where no channel clips.
//! 3. Every other channel's share is the slope of that channel over the own one, pixel by pixel ([`slope`]). The offset is
//!    free, so neither black level nor an even ground counts.
//! 4. Several views of a light are averaged with their inverse variances.

mod slope;

use isophote_jit::{PlaneView, Window};

use crate::sight::grey::{Grey, Mixture};
use crate::sight::start::{Sight, Sign, Wanted, find};
use crate::sight::view::largest_value;
use isophote_frame::Frame;
use slope::{FAR, LightPixel, Share, slope};

/// Lights that are looked for in a frame.
const LIGHTS_MAX: usize = 16;
/// What has less light than this share of the frame's first is left alone.
const MASS_SHARE: f64 = 0.02;
/// A light's pixels have dᵀAd up to this: the spot and a little of its ground.
const INSIDE: f64 = 1.3;
/// Pixels that a slope is taken from at least.
const PIXELS_MIN: usize = 40;
/// Half as many at least must have this share of the light that there is.
const LIT: f64 = 0.1;
/// Pixels whose neighbours read more than this share of the limit are left out: noise would choose among them.
const BELOW_LIMIT: f64 = 0.95;
/// Cosine of the angle between two columns, from which on they are the same colour.
const SAME: f64 = 0.98;
/// By how much two views of a light may differ, beside five standard errors.
const VIEWS_DIFFER: f64 = 0.05;

/// The answer.
#[derive(Clone, Debug, PartialEq)]
pub struct Mixing {
    /// Rows: channels; columns: lights, in the channels' order.
    pub matrix: Vec<Vec<f64>>,
    /// Standard errors; 0 on the diagonal, which is 1 by definition.
    pub errors: Vec<Vec<f64>>,
    /// Pixels that each light was measured with.
    pub pixels: Vec<usize>,
}

/// Why there is none. Channels are numbers from 0.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MixingError {
    /// A frame that has other planes than the first, or fewer than two.
    #[error("a frame has {found} channels, {wanted} are needed")]
    Planes {
        /// Of the frame.
        found: usize,
        /// Of the measurement.
        wanted: usize,
    },
    /// Nothing is brightest in this channel.
    #[error("no light is brightest in channel {channel}")]
    NoLight {
        /// The channel.
        channel: usize,
        /// Things that are brightest in each.
        seen: Vec<usize>,
    },
    /// The light's channel is clipped wherever there is light.
    #[error("the light of channel {0} is clipped everywhere")]
    Clipped(usize),
    /// Two lights that cannot be told apart.
    #[error("two lights have the same colour: that of channel {0} and that of channel {1}")]
    SameColour(usize, usize),
    /// Two views of what should be one light.
    #[error("two lights are brightest in channel {0}, of different colours")]
    TwoLights(usize),
    /// What was taken for a light has several colours.
    #[error("what is brightest in channel {0} has more than one colour")]
    Mixed(usize),
}

/// A measurement that takes frame after frame.
#[derive(Clone, Debug)]
pub struct MixingMeasurement {
    channels: usize,
    saturation: Option<f64>,
    views: Vec<View>,
    /// Channels that clip wherever a light was seen.
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
    /// For so many channels; `saturation` in pixel values, by default the largest that frames can hold.
    pub fn new(channels: usize, saturation: Option<f64>) -> MixingMeasurement {
        MixingMeasurement { channels, saturation, views: Vec::new(), clipped: Vec::new() }
    }

    /// Looks at a frame, of its slices the first.
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
        let wanted = Wanted { sign: Some(Sign::Bright), targets_max: LIGHTS_MAX, faint: true, ..Wanted::default() };
        let found = find(&grey, &wanted, &|_| Ok(())).map_or_else(|_| Vec::new(), |found| found.sights);
        let mass = |sight: &Sight| sight.amplitude * sight.size[0] * sight.size[1];
        let most = found.first().map_or(0.0, mass);
        for sight in found.iter().filter(|sight| mass(sight) > MASS_SHARE * most) {
            self.look(&planes, window, limit, sight)?;
        }
        Ok(())
    }

    fn look(&mut self, planes: &[PlaneView], window: Window, limit: f64, sight: &Sight) -> Result<(), MixingError> {
        let places = places(sight, window);
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
            // Where several channels clip alike, it may be the light of any of them.
            let most = (0..self.channels).map(clips).max().unwrap_or(0);
            self.clipped.extend((0..self.channels).filter(|channel| most > 0 && 10 * clips(*channel) >= 9 * most));
            return Ok(());
        }
        let shares: Option<Vec<Share>> = (0..self.channels).map(|channel| slope(&points, own, channel)).collect();
        let shares = shares.ok_or(MixingError::Mixed(own))?;
        self.views.push(View { own, shares, pixels: points.len() });
        Ok(())
    }

    /// The matrix of all frames.
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

/// Pixels of a sight that have four neighbours.
fn places(sight: &Sight, window: Window) -> Vec<[usize; 2]> {
    let [cx, cy, ..] = sight.centre;
    let [[a1, a2, ..], [_, a3, ..], ..] = sight.extent;
    let side = |centre: f64, half: f64, count: usize| {
        let reach = INSIDE.sqrt() * half + 1.0;
        let first = (centre - reach).floor().max(1.0) as usize;
        let end = ((centre + reach).ceil().max(0.0) as usize + 1).min(count.saturating_sub(1));
        first..end.max(first)
    };
    let (xs, ys) = (side(cx, sight.size[0], window.width), side(cy, sight.size[1], window.height));
    let all = ys.flat_map(|y| xs.clone().map(move |x| [x, y]));
    let is_inside = |[x, y]: &[usize; 2]| {
        let (x, y) = (*x as f64 - cx, *y as f64 - cy);
        a1 * x * x + 2.0 * a2 * x * y + a3 * y * y <= INSIDE
    };
    all.filter(is_inside).collect()
}

/// Weighted by inverse variances; of errors 0 evenly.
fn mean(shares: &[Share]) -> Share {
    let weight = |share: &Share| share.error.max(f64::MIN_POSITIVE.sqrt()).powi(-2);
    let total: f64 = shares.iter().map(weight).sum();
    let value = shares.iter().map(|share| weight(share) * share.value).sum::<f64>() / total;
    let exact = shares.iter().all(|share| share.error == 0.0);
    Share { value, error: if exact { 0.0 } else { total.sqrt().recip() } }
}

#[cfg(test)]
mod tests;
