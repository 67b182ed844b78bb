//! Camera response: `CameraResponse` as in documents, and `Response`, prepared to linearise pixel values and to invert that.
//!
//! Light L, in DN above black, reads `c = black + W·(g L/W)^gamma`, with `W = saturation − black` and g the gain of the
//! pixel. So a clipped pixel of gain 1 has the light W, and a linear camera (gamma 1) has `L = c − black`. Below black,
//! where noise takes pixels, the curve is mirrored: otherwise the mean of dark pixels would be biased.

use std::sync::{Arc, OnceLock};

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use isophote_jit::{PixelFormat, PlaneView};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Range of gamma.
const GAMMAS: [f64; 2] = [0.1, 10.0];
/// Range of a pixel's gain.
const GAINS: [f64; 2] = [0.5, 2.0];
/// Rounding error of integer values.
const HALF_STEP: f64 = 0.5;

/// Relation of pixel values to light, between the black level and saturation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct CameraResponse {
    /// Exponent: values above black are proportional to light^`gamma`. 1 (default) for a linear camera, 0.45 for most cameras
    /// that produce pictures for display.
    #[serde(default = "linear")]
    pub gamma: f64,
    /// Relative sensitivity of each pixel.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gains: Option<GainMap>,
}

/// Relative gain of each pixel of a sensor; 1 for most pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct GainMap {
    /// Width of the image, px.
    pub width: u32,
    /// Height of the image, px.
    pub height: u32,
    /// Unit of `steps`: a pixel's gain is 1 + `step` × its number.
    pub step: f64,
    /// One number per pixel, row by row, -127 to 127: signed bytes in base64.
    #[serde(serialize_with = "to_base64", deserialize_with = "from_base64")]
    #[cfg_attr(feature = "schema", schema(value_type = String))]
    pub steps: Arc<[i8]>,
}

/// Why a response is invalid, or does not match the frames.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ResponseError {
    /// Gamma out of range.
    #[error("the response's gamma is {0}; it must be from {least} to {most}", least = GAMMAS[0], most = GAMMAS[1])]
    Gamma(f64),
    /// No saturation above black.
    #[error(
        "a response holds between `black` and `saturation`: the camera's document must say where pixels clip, above black"
    )]
    NoSaturation,
    /// Wrong number of gains.
    #[error("the response's gains are {found}; {width} × {height} px have {} of them", u64::from(*width) * u64::from(*height))]
    Count {
        /// The given number.
        found: usize,
        /// Of the map.
        width: u32,
        /// Of the map.
        height: u32,
    },
    /// Gains out of range.
    #[error("the response's gains go from {0:.3} to {1:.3}; they must be from {least} to {most}", least = GAINS[0], most = GAINS[1])]
    Gains(f64, f64),
    /// Gains for another image size.
    #[error(
        "the camera's response has gains for images of {0} × {1} px, the frames are {2} × {3} px: gains are those of pixels, so \
         measure them with frames of this size (`isophote calibrate response`)"
    )]
    Size(usize, usize, usize, usize),
}

fn linear() -> f64 {
    1.0
}

fn to_base64<S: Serializer>(steps: &Arc<[i8]>, serializer: S) -> Result<S::Ok, S::Error> {
    let bytes: Vec<u8> = steps.iter().map(|step| step.to_ne_bytes()[0]).collect();
    serializer.serialize_str(&BASE64_STANDARD.encode(bytes))
}

fn from_base64<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Arc<[i8]>, D::Error> {
    let text = String::deserialize(deserializer)?;
    let bytes = BASE64_STANDARD.decode(text).map_err(serde::de::Error::custom)?;
    Ok(bytes.into_iter().map(|byte| i8::from_ne_bytes([byte])).collect())
}

impl CameraResponse {
    /// Checks that the gains are for frames of this size, px, inner dimension first.
    ///
    /// # Errors
    /// When the gains are for another size.
    pub fn check_size(&self, size: &[usize]) -> Result<(), ResponseError> {
        let Some(map) = &self.gains else { return Ok(()) };
        let [width, height] = [0, 1].map(|axis| size.get(axis).copied().unwrap_or(1));
        match (map.width as usize, map.height as usize) {
            own if own == (width, height) => Ok(()),
            own => Err(ResponseError::Size(own.0, own.1, width, height)),
        }
    }

    /// Growth of the rounding variance per DN of light, for `range_dn` of light at clipping: the variance of 1/12 DN²
    /// in light, unscaled at black and exact at clipping. Linear for a gamma of 0.5.
    pub fn rounding_gain(&self, range_dn: f64) -> f64 {
        (self.gamma.powi(-2) - 1.0) / (12.0 * range_dn)
    }
}

impl GainMap {
    /// Quantises gains, row by row, with the finest step that covers all of them.
    pub fn of(width: usize, height: usize, gains: &[f64]) -> GainMap {
        let most = gains.iter().map(|gain| (gain - 1.0).abs()).fold(0.0, f64::max);
        let step = if most > 0.0 { most / f64::from(i8::MAX) } else { 1.0 };
        let steps = gains.iter().map(|gain| ((gain - 1.0) / step).round() as i8).collect();
        GainMap { width: width as u32, height: height as u32, step, steps }
    }
}

/// A prepared response with lookup tables.
#[derive(Debug)]
pub struct Response {
    black: f64,
    /// Clipping value minus black.
    range: f64,
    gamma: f64,
    gains: Option<Gains>,
    /// Lookup tables of light for 8-bit and 16-bit values.
    tables: [OnceLock<Vec<f32>>; 2],
}

#[derive(Debug)]
struct Gains {
    map: GainMap,
    /// Gain of each number of the map, indexed by byte.
    gains: Vec<f32>,
    /// Reciprocal gains.
    factors: Vec<f32>,
    largest: f64,
}

impl Response {
    /// The response of a camera with this black level that clips at `saturation`.
    ///
    /// # Errors
    /// When the response is invalid.
    pub fn new(black: f64, saturation: Option<f64>, response: &CameraResponse) -> Result<Response, ResponseError> {
        let range = saturation.map(|saturation| saturation - black).filter(|range| *range > 0.0 && range.is_finite());
        let range = range.ok_or(ResponseError::NoSaturation)?;
        if !(GAMMAS[0]..=GAMMAS[1]).contains(&response.gamma) {
            return Err(ResponseError::Gamma(response.gamma));
        }
        let gains = response.gains.as_ref().map(Gains::new).transpose()?;
        Ok(Response { black, range, gamma: response.gamma, gains, tables: Default::default() })
    }

    /// Light of a value at gain 1, DN above black.
    pub fn light(&self, value: f64) -> f64 {
        self.range * mirrored((value - self.black) / self.range, 1.0 / self.gamma)
    }

    /// The value, neither rounded nor clipped, of a light that includes its pixel's gain.
    pub fn value(&self, light: f64) -> f64 {
        self.black + self.range * mirrored(light / self.range, self.gamma)
    }

    /// The light at which a pixel of gain 1 clips, DN above black.
    pub fn range(&self) -> f64 {
        self.range
    }

    /// Gains of the pixels of a row, if any.
    pub fn gains(&self, y: usize) -> Option<impl Iterator<Item = f32>> {
        let gains = self.gains.as_ref()?;
        Some(gains.row(y).iter().map(|step| gains.gains[usize::from(step.to_ne_bytes()[0])]))
    }

    /// The least light of any clipped pixel, over all gains. An integer value stands for all light that rounds to it.
    pub(crate) fn clipped(&self, format: PixelFormat) -> f64 {
        let half = if matches!(format, PixelFormat::U8 | PixelFormat::U16) { HALF_STEP } else { 0.0 };
        let light = self.light(self.black + self.range - half);
        light / self.gains.as_ref().map_or(1.0, |gains| gains.largest)
    }

    /// Linearises one row, from its first pixel on.
    pub(crate) fn linear_row(&self, view: &PlaneView, place: [usize; 4], light: &mut [f32]) {
        let width = light.len();
        match (self.table(view.format()), view.bytes_of_row(place, width), view.words_of_row(place, width)) {
            (Some(table), Some(row), _) => {
                light.iter_mut().zip(row).for_each(|(light, value)| *light = table[usize::from(*value)]);
            }
            (Some(table), _, Some(row)) => {
                let values = row.chunks_exact(2).map(|word| u16::from_ne_bytes([word[0], word[1]]));
                light.iter_mut().zip(values).for_each(|(light, value)| *light = table[usize::from(value)]);
            }
            (table, _, _) => {
                for (x, light) in light.iter_mut().enumerate() {
                    let value = view.pixel_at([x, place[1], place[2], place[3]]);
                    *light = table.map_or_else(|| self.light(value) as f32, |table| table[value as usize]);
                }
            }
        }
        if let Some(gains) = &self.gains {
            let factors = gains.row(place[1]).iter().map(|step| gains.factors[usize::from(step.to_ne_bytes()[0])]);
            light.iter_mut().zip(factors).for_each(|(light, factor)| *light *= factor);
        }
    }

    fn table(&self, format: PixelFormat) -> Option<&[f32]> {
        let (table, values) = match format {
            PixelFormat::U8 => (&self.tables[0], 1 << 8),
            PixelFormat::U16 => (&self.tables[1], 1 << 16),
            PixelFormat::F32 | PixelFormat::F64 => return None,
        };
        Some(table.get_or_init(|| (0..values).map(|value| self.light(f64::from(value)) as f32).collect()))
    }
}

impl Gains {
    fn new(map: &GainMap) -> Result<Gains, ResponseError> {
        let (width, height, found) = (map.width, map.height, map.steps.len());
        if found as u64 != u64::from(width) * u64::from(height) || found == 0 {
            return Err(ResponseError::Count { found, width, height });
        }
        let gain = |step: i8| 1.0 + map.step * f64::from(step);
        let ends = map.steps.iter().fold([i8::MAX, i8::MIN], |[low, high], step| [low.min(*step), high.max(*step)]);
        let [one, other] = ends.map(gain);
        let (least, largest) = (one.min(other), one.max(other));
        if !(least >= GAINS[0] && largest <= GAINS[1]) {
            return Err(ResponseError::Gains(least, largest));
        }
        let gains: Vec<f32> = (0..=u8::MAX).map(|byte| gain(i8::from_ne_bytes([byte])) as f32).collect();
        let factors = gains.iter().map(|gain| gain.recip()).collect();
        Ok(Gains { map: map.clone(), gains, factors, largest })
    }

    fn row(&self, y: usize) -> &[i8] {
        let width = self.map.width as usize;
        &self.map.steps[y * width..][..width]
    }
}

/// A power of the magnitude, with the sign of `share`. Bit-identical on every machine.
fn mirrored(share: f64, power: f64) -> f64 {
    if power == 1.0 { share } else { libm::pow(share.abs(), power).copysign(share) }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn response(gamma: f64, gains: Option<GainMap>) -> Response {
        Response::new(16.0, Some(255.0), &CameraResponse { gamma, gains }).unwrap()
    }

    #[test]
    fn value_inverts_light() {
        for gamma in [0.45, 1.0, 2.2] {
            let camera = response(gamma, None);
            for value in [3.0, 16.0, 17.0, 100.0, 254.5, 255.0] {
                assert!((camera.value(camera.light(value)) - value).abs() < 1e-9, "{gamma} {value}");
            }
            assert_eq!((camera.light(16.0), camera.light(255.0)), (0.0, 239.0));
            // The curve is mirrored at black.
            assert_eq!(camera.light(13.0), -camera.light(19.0));
        }
        assert_eq!(response(1.0, None).light(200.25), 184.25);
        // Half the light of a camera with display gamma is 73 % of its range.
        assert!((response(1.0 / 2.2, None).value(119.5) - (16.0 + 239.0 * 0.7297)).abs() < 0.01);
    }

    #[test]
    fn gains_round_trip_and_invalid_responses_are_rejected() {
        let map = GainMap::of(3, 1, &[0.98, 1.0, 1.03]);
        let text = serde_json::to_string(&CameraResponse { gamma: 0.45, gains: Some(map.clone()) }).unwrap();
        let read: CameraResponse = serde_json::from_str(&text).unwrap();
        assert_eq!(read.gains, Some(map.clone()));
        assert!(serde_json::from_str::<CameraResponse>(&text.replace("\"steps\":\"", "\"steps\":\"?")).is_err());
        let refused = |black: f64, saturation, gamma, gains| {
            Response::new(black, saturation, &CameraResponse { gamma, gains }).unwrap_err()
        };
        assert_eq!(refused(0.0, None, 1.0, None), ResponseError::NoSaturation);
        assert_eq!(refused(255.0, Some(255.0), 1.0, None), ResponseError::NoSaturation);
        for gamma in [0.0, 0.09, 10.1, f64::NAN] {
            assert!(matches!(refused(0.0, Some(1.0), gamma, None), ResponseError::Gamma(_)), "{gamma}");
        }
        let short = GainMap { width: 2, ..map.clone() };
        assert_eq!(refused(0.0, Some(1.0), 1.0, Some(short)), ResponseError::Count { found: 3, width: 2, height: 1 });
        for step in [0.02, f64::NAN, f64::INFINITY] {
            let wide = GainMap { step, ..map.clone() };
            assert!(matches!(refused(0.0, Some(1.0), 1.0, Some(wide)), ResponseError::Gains(..)), "{step}");
        }
    }
}
