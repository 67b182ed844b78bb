//! Measures a camera's response, its gamma and each pixel's gain, from frames of an even field at several light levels.
//!
//! Each frame has a relative amount of light (its exposure time, say). Where values above black grow as light^γ, their
//! logarithm is a line of slope γ over that of light. The mean of values is not that of their light, so the fitted quantity
//! is the frame's mean of the light that a power reads there, raised to that power. γ, and the black level if unknown, are
//! those of least squares. Gains need a second pass over the frames.

mod gains;

use isophote_frame::{CameraResponse, Frame, Response, ResponseError};
use isophote_jit::{PixelFormat, Window};
use nalgebra::{DVector, Matrix2, MatrixXx2, Vector2};

use super::view;
use crate::least_squares::{NormalEquations, Solution, least_squares};

pub use gains::{GainMeasurement, MeasuredGains};

/// Most distinct light levels.
const LIGHTS_MAX: usize = 64;
/// Fewest light levels that test a line; an unknown black level needs one more.
const LIGHTS_MIN: usize = 3;
/// Least ratio of the strongest to the weakest light.
const SPAN_MIN: f64 = 4.0;
/// Largest share of clipped pixels in a field: hot ones.
const CLIPPED_MAX: f64 = 0.002;
/// Largest relative deviation of a field from the power law.
const OFF_MAX: f64 = 0.02;
/// Budget: converged when another step changes no light by more than this share.
const FOUND: f64 = 1e-8;
/// Derived: half the span of a central difference by the power; its error, about its square, is as small as [`FOUND`].
const NUDGE: f64 = 1e-4;
/// Derived: the same by the black level, DN; for a field of 10 DN the error is a millionth, and moves the result by that
/// share of its standard deviation.
const NUDGE_DN: f64 = 1e-2;

/// Prior knowledge of the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResponseOptions {
    /// The pixel value without light, DN; if absent it is fitted, which takes one more field.
    pub black: Option<f64>,
    /// The pixel value at which the sensor clips, DN; by default the largest that frames can hold.
    pub saturation: Option<f64>,
}

/// The result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredResponse {
    /// The exponent γ, and its standard deviation.
    pub gamma: [f64; 2],
    /// The pixel value without light, DN, and its standard deviation: 0 where it was given.
    pub black: [f64; 2],
    /// The pixel value at which pixels clip, DN.
    pub saturation: f64,
    /// Largest relative deviation of a field's light from the power law.
    pub off: f64,
    /// Number of distinct light levels.
    pub lights: usize,
    /// Number of frames used.
    pub frames: usize,
}

/// Why there is no result.
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
        /// Distinct levels.
        found: usize,
        /// With or without a known black level.
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
        /// Light of the field.
        light: f64,
        /// Percent.
        share: f64,
        /// The value, DN.
        end: f64,
        /// The advice: less or more light.
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
        /// Light of the field.
        light: f64,
        /// A share of its light.
        off: f64,
    },
    /// The result is not a valid response.
    #[error(transparent)]
    Response(#[from] ResponseError),
}

/// A measurement to which frames are added.
#[derive(Clone, Debug)]
pub struct ResponseMeasurement {
    options: ResponseOptions,
    /// Sides, planes and format of the first frame.
    shape: Option<([usize; 4], usize, PixelFormat)>,
    limit: f64,
    fields: Vec<Field>,
    frames: usize,
}

/// The histogram of all pixels at one light level.
#[derive(Clone, Debug)]
struct Field {
    light: f64,
    /// Pixels by value.
    counts: Vec<u64>,
}

impl ResponseMeasurement {
    /// A measurement without frames.
    pub fn new(options: ResponseOptions) -> ResponseMeasurement {
        let limit = options.saturation.unwrap_or(f64::INFINITY);
        ResponseMeasurement { options, shape: None, limit, fields: Vec::new(), frames: 0 }
    }

    /// Adds a frame with its light, in any unit common to all.
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
            let describe = |(sides, planes, format): ([usize; 4], usize, PixelFormat)| {
                format!("{} × {} px in {planes} plane(s) of {format:?}", sides[0], sides[1])
            };
            return Err(ResponseFault::Unlike(describe(first), describe(shape)));
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

    /// Fewest light levels that test a power law.
    fn needed(&self) -> usize {
        LIGHTS_MIN + usize::from(self.options.black.is_none())
    }

    fn lights(&self) -> ResponseFault {
        ResponseFault::Lights { found: self.fields.len(), needed: self.needed() }
    }

    /// The result from all frames.
    ///
    /// # Errors
    /// When they do not determine it.
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
        let found = self.power()?;
        let [gamma, black] = found.point.into();
        let residuals = self.residuals(&found.point)? / gamma;
        let (far, off) = residuals.abs().argmax();
        if off > OFF_MAX {
            return Err(ResponseFault::Crooked { light: self.fields[far].light, off });
        }
        let information = found.equations.information;
        let inverse = match self.options.black {
            Some(_) => Some(Matrix2::new(information.m11.recip(), 0.0, 0.0, 0.0)),
            None => information.try_inverse(),
        };
        let freedom = (lights + 1 - self.needed()) as f64;
        let variances = inverse.map_or(Vector2::repeat(f64::INFINITY), |inverse| inverse.diagonal());
        let [gamma_sigma, black_sigma] = variances.map(|entry| (entry * found.equations.cost / freedom).sqrt()).into();
        let (gamma, black) = ([gamma, gamma_sigma], [black, black_sigma]);
        Ok(MeasuredResponse { gamma, black, saturation, off, lights, frames })
    }

    /// Fits γ, and the black level if unknown.
    fn power(&self) -> Result<Solution<Vector2<f64>, 2>, ResponseFault> {
        let start = Vector2::new(1.0, self.options.black.unwrap_or(0.0));
        self.residuals(&start)?;
        let nudges = [NUDGE, if self.options.black.is_none() { NUDGE_DN } else { 0.0 }];
        let equations = |at: &Vector2<f64>| {
            let residuals = self.residuals(at).ok()?;
            let mut slopes = MatrixXx2::zeros(residuals.len());
            for (axis, nudge) in nudges.into_iter().enumerate().filter(|(_, nudge)| *nudge > 0.0) {
                let nudged = |by: f64| self.residuals(&(at + Vector2::ith(axis, by))).ok();
                slopes.set_column(axis, &((nudged(-nudge)? - nudged(nudge)?) / (2.0 * nudge)));
            }
            let rows = residuals.iter().zip(slopes.row_iter());
            Some(NormalEquations::of(rows.map(|(residual, row)| (*residual, row.transpose(), 1.0))))
        };
        let darkest = self.fields.iter().map(|field| field.light).fold(f64::INFINITY, f64::min);
        let found = least_squares(start, FOUND * FOUND, equations, |at, by| at + by);
        found.ok_or(ResponseFault::Black(darkest, start.y))
    }

    /// Residuals of ln(values above black) from a line of slope γ over ln(light): γ times those of the light that is read
    /// there.
    fn residuals(&self, at: &Vector2<f64>) -> Result<DVector<f64>, ResponseFault> {
        let [gamma, black] = (*at).into();
        let response = Response::new(black, Some(self.limit), &CameraResponse { gamma, gains: None })?;
        let beside = self.fields.iter().map(|field| match field.mean(&response) / field.light {
            ratio if ratio > 0.0 => Ok(gamma * ratio.ln()),
            _ => Err(ResponseFault::Black(field.light, black)),
        });
        let beside = DVector::from_vec(beside.collect::<Result<Vec<f64>, _>>()?);
        let mean = beside.mean();
        Ok(beside.add_scalar(-mean))
    }
}

impl Field {
    /// Checks that hardly a pixel is clipped, below or above.
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
        let counted = self.counts.iter().enumerate().filter(|(_, count)| **count > 0);
        let [sum, all] = counted.fold([0.0; 2], |[sum, all], (value, count)| {
            [sum + *count as f64 * response.light(value as f64), all + *count as f64]
        });
        sum / all
    }
}

#[cfg(test)]
mod tests;
