//! The response of a camera from frames of an even field in several lights: its gamma, and the gain of each pixel.
//!
//! What comes in: frames of one size, each with how much light it had beside the others (its exposure time, say). What goes out: the
//! power by which values grow with light, and, looking at the frames again, the gains. It never knows a model.
//!
//! Where values above black grow as light^γ, they are a straight line of slope γ over light, both as logarithms. What is drawn is
//! the mean over a frame of the light that a power reads there, and the power is the one that makes the slope 1: the mean of values
//! is not that of their light.

mod gains;

use isophote_frame::{CameraResponse, Frame, Response, ResponseError};
use isophote_jit::{PixelFormat, Window};

use super::view;

pub use gains::{GainMeasurement, MeasuredGains};

/// Lights that are told apart.
const LIGHTS_MAX: usize = 64;
/// A line through fewer shows nothing of whether it is one; one with a black level to be found takes one more.
const LIGHTS_MIN: usize = 3;
/// The strongest light is at least so many times the weakest.
const SPAN_MIN: f64 = 4.0;
/// So many of the pixels of a field may be clipped: hot ones.
const CLIPPED_MAX: f64 = 0.002;
/// By so much light a field may be off a power.
const OFF_MAX: f64 = 0.02;
/// Steps to a slope of 1, each of which leaves a hundredth of the distance, about, …
const STEPS: usize = 20;
/// … and when it is reached.
const SLOPE_OFF: f64 = 1e-10;
/// A black level is sought to so much, DN, …
const BLACK_DN: f64 = 1e-4;
/// … and how it bends the power is seen so far from it.
const BESIDE: f64 = 0.01;

/// The camera as far as it is known before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResponseOptions {
    /// The pixel value without light, DN; where it is absent the fields say it, of which there is to be one more.
    pub black: Option<f64>,
    /// The pixel value at which the sensor clips, DN; the largest that frames can hold where it is absent.
    pub saturation: Option<f64>,
}

/// What was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredResponse {
    /// The power by which values grow with light, and one standard deviation of that.
    pub gamma: [f64; 2],
    /// The pixel value without light, DN, and one standard deviation of that: 0 where it was given.
    pub black: [f64; 2],
    /// The pixel value at which pixels clip, DN.
    pub saturation: f64,
    /// By how much of its light the field that is farthest off is beside the power.
    pub off: f64,
    /// Lights that were told apart.
    pub lights: usize,
    /// Frames that were looked at.
    pub frames: usize,
}

/// Why there is no answer.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ResponseFault {
    /// See the text.
    #[error("a field's light is a positive number, such as its exposure time; {0} is none")]
    Light(f64),
    /// See the text.
    #[error(
        "fields in {found} light(s); it takes {needed} and more, up to {LIGHTS_MAX}, and one less where the black level is known \
         (dark frames that are not clipped at 0)"
    )]
    Lights {
        /// Told apart.
        found: usize,
        /// As things are.
        needed: usize,
    },
    /// See the text.
    #[error("the strongest light is {0:.2} times the weakest; it must be {SPAN_MIN} times and more")]
    Narrow(f64),
    /// A frame unlike the first.
    #[error("frames of different sizes or planes: {0}, then {1}")]
    Unlike(String, String),
    /// See the text.
    #[error("frames in fractions; a response is measured on the whole values that a camera reads")]
    Fractions,
    /// See the text.
    #[error("{share:.1} % of the pixels in light {light} are clipped at {end}; {remedy}")]
    Clipped {
        /// Of the field.
        light: f64,
        /// Percent.
        share: f64,
        /// The value, DN.
        end: f64,
        /// Less or more light.
        remedy: &'static str,
    },
    /// See the text.
    #[error(
        "light {0} does not read more than the black level of {1} DN; take more light, and the black level from dark frames"
    )]
    Black(f64, f64),
    /// See the text.
    #[error(
        "values do not grow with a power of the light: light {light} reads as {:.1} % off; is the light steady, its exposure as \
         stated, the black level right (dark frames), and is every tone curve switched off?", 100.0 * off
    )]
    Crooked {
        /// Of the field.
        light: f64,
        /// A share of its light.
        off: f64,
    },
    /// What follows is no response.
    #[error(transparent)]
    Response(#[from] ResponseError),
}

/// A measurement that takes frame after frame.
#[derive(Clone, Debug)]
pub struct ResponseMeasurement {
    options: ResponseOptions,
    /// Of the first frame: sides, planes, format.
    shape: Option<([usize; 4], usize, PixelFormat)>,
    limit: f64,
    fields: Vec<Field>,
    frames: usize,
}

/// All pixels in one light.
#[derive(Clone, Debug)]
struct Field {
    light: f64,
    /// Pixels of each value.
    counts: Vec<u64>,
}

impl ResponseMeasurement {
    /// One that has seen nothing yet.
    pub fn new(options: ResponseOptions) -> ResponseMeasurement {
        let limit = options.saturation.unwrap_or(f64::INFINITY);
        ResponseMeasurement { options, shape: None, limit, fields: Vec::new(), frames: 0 }
    }

    /// Takes a frame in so much light, in any unit that is the same for all.
    ///
    /// # Errors
    /// When it is unlike the first, in fractions, or in too many lights.
    pub fn add(&mut self, light: f64, frame: &Frame) -> Result<(), ResponseFault> {
        if !(light > 0.0 && light.is_finite()) {
            return Err(ResponseFault::Light(light));
        }
        let shape = (frame.sides(), frame.planes().len(), frame.plane_view(0).format());
        let first = *self.shape.get_or_insert(shape);
        if first != shape {
            let told = |(sides, planes, format): ([usize; 4], usize, PixelFormat)| {
                format!("{} × {} px in {planes} plane(s) of {format:?}", sides[0], sides[1])
            };
            return Err(ResponseFault::Unlike(told(first), told(shape)));
        }
        let values = match shape.2 {
            PixelFormat::U8 => 1 << 8,
            PixelFormat::U16 => 1 << 16,
            PixelFormat::F32 | PixelFormat::F64 => return Err(ResponseFault::Fractions),
        };
        let at = self.fields.iter().position(|field| field.light == light).unwrap_or_else(|| {
            self.fields.push(Field { light, counts: vec![0; values] });
            self.fields.len() - 1
        });
        if self.fields.len() > LIGHTS_MAX {
            return Err(self.lights());
        }
        let [width, height, depth, length] = shape.0;
        for plane in 0..shape.1 {
            let view = frame.plane_view(plane);
            for place in 0..width * height * depth * length {
                let (x, rest) = (place % width, place / width);
                let (y, rest) = (rest % height, rest / height);
                self.fields[at].counts[view.pixel_at([x, y, rest % depth, rest / depth]) as usize] += 1;
            }
            if self.options.saturation.is_none() {
                let largest = frame.largest.unwrap_or(f64::INFINITY);
                self.limit = self.limit.min(view::limit(&view, Window::of_size(shape.0), largest));
            }
        }
        self.frames += 1;
        Ok(())
    }

    /// So many lights show whether values are a power of them.
    fn needed(&self) -> usize {
        LIGHTS_MIN + usize::from(self.options.black.is_none())
    }

    fn lights(&self) -> ResponseFault {
        ResponseFault::Lights { found: self.fields.len(), needed: self.needed() }
    }

    /// The answer from all of them.
    ///
    /// # Errors
    /// Where they do not say it.
    pub fn finish(&self) -> Result<MeasuredResponse, ResponseFault> {
        if self.fields.len() < self.needed() {
            return Err(self.lights());
        }
        let lights = || self.fields.iter().map(|field| field.light);
        let span = lights().fold(0.0, f64::max) / lights().fold(f64::INFINITY, f64::min);
        if span < SPAN_MIN {
            return Err(ResponseFault::Narrow(span));
        }
        self.fields.iter().try_for_each(|field| field.check(self.limit))?;
        let (lights, frames, saturation) = (self.fields.len(), self.frames, self.limit);
        let (black, freedoms) = match self.options.black {
            Some(black) => (black, 2.0),
            None => (self.black(), 3.0),
        };
        let power = self.power(black)?;
        let variance = power.squares() / (lights as f64 - freedoms);
        let mut gamma_variance = variance / power.spread;
        let mut black_sigma = 0.0;
        if self.options.black.is_none() {
            let beside = self.power(black + BESIDE)?;
            let moved = beside.residuals.iter().zip(&power.residuals).map(|(beside, here)| (beside - here) / BESIDE);
            let black_variance = variance / moved.map(|slope| slope * slope).sum::<f64>();
            gamma_variance += black_variance * ((beside.gamma - power.gamma) / (BESIDE * power.gamma)).powi(2);
            black_sigma = black_variance.sqrt();
        }
        let far = self.fields.iter().zip(&power.residuals).max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
        let (light, off) = far.map_or((0.0, 0.0), |(field, residual)| (field.light, residual.abs()));
        if off > OFF_MAX {
            return Err(ResponseFault::Crooked { light, off });
        }
        let gamma = [power.gamma, power.gamma * gamma_variance.sqrt()];
        Ok(MeasuredResponse { gamma, black: [black, black_sigma], saturation, off, lights, frames })
    }

    /// The black level beside which values are a power of the light best, by golden sections.
    fn black(&self) -> f64 {
        let off = |black: f64| self.power(black).map_or(f64::INFINITY, |power| power.squares());
        let brightest = self.fields.iter().map(Field::mean_value).fold(f64::INFINITY, f64::min);
        let (mut low, mut high) = (0.0, brightest);
        let golden = 0.5 * (5f64.sqrt() - 1.0);
        let [mut left, mut right] = [high - golden * (high - low), low + golden * (high - low)];
        let [mut off_left, mut off_right] = [left, right].map(off);
        while high - low > BLACK_DN {
            // Beyond the darkest field nothing is a power.
            if off_left <= off_right {
                (high, right, off_right) = (right, left, off_left);
                left = high - golden * (high - low);
                off_left = off(left);
            } else {
                (low, left, off_left) = (left, right, off_right);
                right = low + golden * (high - low);
                off_right = off(right);
            }
        }
        0.5 * (low + high)
    }

    /// The power by which values grow above a black level.
    fn power(&self, black: f64) -> Result<Power, ResponseFault> {
        let x: Vec<f64> = self.fields.iter().map(|field| field.light.ln()).collect();
        let mut gamma = 1.0;
        let mut power = Power { gamma, spread: 0.0, residuals: Vec::new() };
        for _ in 0..STEPS {
            let response = CameraResponse { gamma, gains: None };
            let response = Response::new(black, Some(self.limit), &response)?;
            let seen = self.fields.iter().map(|field| match field.mean(&response) {
                seen if seen > 0.0 => Ok(seen.ln()),
                _ => Err(ResponseFault::Black(field.light, black)),
            });
            let seen = seen.collect::<Result<Vec<f64>, _>>()?;
            let (slope, spread, residuals) = line(&x, &seen);
            power = Power { gamma, spread, residuals };
            if (slope - 1.0).abs() < SLOPE_OFF {
                break;
            }
            gamma *= slope;
        }
        Ok(power)
    }
}

/// How values grow with light.
struct Power {
    gamma: f64,
    /// Of the lights' logarithms: the sum of the squares of their distances from the mean.
    spread: f64,
    /// By how much of its light each field is beside the power.
    residuals: Vec<f64>,
}

impl Power {
    fn squares(&self) -> f64 {
        self.residuals.iter().map(|residual| residual * residual).sum()
    }
}

impl Field {
    /// Hardly a pixel is clipped, below or above.
    fn check(&self, limit: f64) -> Result<(), ResponseFault> {
        let all: u64 = self.counts.iter().sum();
        let ceiling = limit.clamp(0.0, self.counts.len() as f64 - 1.0).ceil() as usize;
        let at_limit: u64 = self.counts[ceiling..].iter().sum();
        let ends = [
            (at_limit, limit, "take less light: this says nothing of how much there was"),
            (self.counts[0], 0.0, "take more light, or an offset that keeps the noise above 0"),
        ];
        for (count, end, remedy) in ends {
            let share = count as f64 / all as f64;
            if share > CLIPPED_MAX {
                return Err(ResponseFault::Clipped { light: self.light, share: 100.0 * share, end, remedy });
            }
        }
        Ok(())
    }

    fn mean(&self, response: &Response) -> f64 {
        self.mean_of(|value| response.light(value))
    }

    fn mean_value(&self) -> f64 {
        self.mean_of(|value| value)
    }

    fn mean_of(&self, of: impl Fn(f64) -> f64) -> f64 {
        let counted = self.counts.iter().enumerate().filter(|(_, count)| **count > 0);
        let [sum, all] = counted
            .fold([0.0; 2], |[sum, all], (value, count)| [sum + *count as f64 * of(value as f64), all + *count as f64]);
        sum / all
    }
}

/// A straight line, every point as sure as the others: its slope, the spread of x, and what is left.
fn line(x: &[f64], y: &[f64]) -> (f64, f64, Vec<f64>) {
    let count = x.len() as f64;
    let [mean_x, mean_y] = [x, y].map(|all| all.iter().sum::<f64>() / count);
    let points = || x.iter().zip(y).map(|(x, y)| (x - mean_x, y - mean_y));
    let spread: f64 = points().map(|(x, _)| x * x).sum();
    let slope = points().map(|(x, y)| x * y).sum::<f64>() / spread;
    (slope, spread, points().map(|(x, y)| y - slope * x).collect())
}

#[cfg(test)]
mod tests;
