//! A camera and its lens as plain data, the same in documents and in memory.

use isophote_frame::{CameraResponse, Response, ResponseError};
use isophote_jit::PixelFormat;
use serde::{Deserialize, Serialize};

use super::defects::DefectMap;

/// Facts about a camera; what is not known is absent.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Camera {
    /// The pixel value at which the sensor clips (many clip at 253 and not at 255). Default: where the pixels of a frame show
    /// that they are clipped, else the format's largest value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub saturation: Option<f64>,
    /// The pixel value without light.
    pub black: f64,
    /// Electrons that raise the pixel value by one; with a `response` the light, which is in the same unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub electrons_per_dn: Option<f64>,
    /// Standard deviation of a pixel without light, in electrons.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub read_noise_e: Option<f64>,
    /// Standard deviation of what all pixels of a row are off by together, another one in every row and frame, in electrons.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub row_noise_e: Option<f64>,
    /// The share of pixels that are at `saturation` whatever the light (hot pixels). Default: what the model says, or 0.001.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub defects: Option<f64>,
    /// Pixels that fits and searches leave out, because they say nothing about light.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub defect_map: Option<DefectMap>,
    /// How pixel values follow from light: fits and searches see light then, in DN above `black`. Needs `saturation`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub response: Option<CameraResponse>,
    /// The lens.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub intrinsics: Option<Intrinsics>,
}

/// The projection of directions to pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Intrinsics {
    /// Width of the image that the figures are for, px.
    pub width: u32,
    /// Height of that image, px.
    pub height: u32,
    /// Focal length along x, px.
    pub fx: f64,
    /// Focal length along y, px.
    pub fy: f64,
    /// Principal point, x, px.
    pub cx: f64,
    /// Principal point, y, px.
    pub cy: f64,
    /// What `coefficients` mean.
    #[serde(default)]
    pub model: Distortion,
    /// Distortion, in OpenCV's order.
    #[serde(default)]
    pub coefficients: Vec<f64>,
    /// How sure they are, rows of the covariance of fx, fy, cx, cy, px², and, where there are more than four, of the
    /// coefficients: poses are no surer than their lens.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub covariance: Option<Vec<Vec<f64>>>,
}

/// Models of lens distortion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Distortion {
    /// A pinhole.
    #[default]
    None,
    /// Brown–Conrady: k1 k2 p1 p2 k3.
    PlumbBob,
    /// With a denominator: k1 k2 p1 p2 k3 k4 k5 k6.
    Rational,
    /// Kannala–Brandt: k1 k2 k3 k4.
    Fisheye,
}

impl Camera {
    /// What makes light of its pixel values, where they are not taken for light as they are.
    ///
    /// # Errors
    /// When there can be no such response.
    pub fn linear_response(&self) -> Result<Option<Response>, ResponseError> {
        let response = self.response.as_ref();
        response.map(|response| Response::new(self.black, self.saturation, response)).transpose()
    }

    /// By how much the variance of rounding grows with each DN of light: not at all without a response.
    pub fn rounding_gain(&self) -> f64 {
        let range_dn = self.saturation.unwrap_or(f64::INFINITY) - self.black;
        self.response.as_ref().map_or(0.0, |response| response.rounding_gain(range_dn))
    }

    /// The format of pixels as fits see them.
    pub fn seen_format(&self, format: PixelFormat) -> PixelFormat {
        if self.response.is_some() { PixelFormat::F32 } else { format }
    }

    /// What pixels read without light as fits see them.
    pub(crate) fn linear_black(&self) -> f64 {
        if self.response.is_some() { 0.0 } else { self.black }
    }

    /// The variance of what rows are off by, in pixel values², where it is known and there is some.
    pub(crate) fn row_variance(&self) -> Option<f64> {
        Some((self.row_noise_e? / self.electrons_per_dn?).powi(2)).filter(|variance| *variance > 0.0)
    }

    /// The value of a model's constant of that name, as far as this camera gives it: `gain` is pixel values per electron
    /// (and what rounding adds to the variance of light, where there is a response),
    /// `read_noise` and `black` in pixel values (a black level of 0 is one that was not given), `defects` a share of all
    /// pixels, `fx` `fy` `cx` `cy` the lens,
    /// in px, and `lens_k1` … `lens_k6`, `lens_p1`, `lens_p2` its distortion (0 where the lens has none).
    pub fn constant(&self, name: &str) -> Option<f64> {
        let lens = self.intrinsics.as_ref();
        match name {
            "fx" => Some(lens?.fx),
            "fy" => Some(lens?.fy),
            "cx" => Some(lens?.cx),
            "cy" => Some(lens?.cy),
            "black" if self.response.is_some() => Some(0.0),
            "black" => Some(self.black).filter(|black| *black != 0.0),
            "gain" => Some(1.0 / self.electrons_per_dn? + self.rounding_gain()),
            "defects" => self.defects,
            "read_noise" => Some(self.read_noise_e? / self.electrons_per_dn?),
            _ => lens?.coefficient(name.strip_prefix("lens_")?),
        }
    }
}
