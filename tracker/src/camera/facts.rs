//! Camera and lens as plain data, the same in documents and in memory.

use isophote_frame::{CameraResponse, Response, ResponseError};
use isophote_jit::PixelFormat;
use serde::{Deserialize, Serialize};

use super::defects::DefectMap;

/// Properties of a camera; unknown ones are absent.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Camera {
    /// Pixel value at which the sensor clips (many clip at 253, not at 255). Default: the value at which a frame's pixels are
    /// visibly clipped, else the format's largest value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub saturation: Option<f64>,
    /// Black level: the pixel value without light.
    pub black: f64,
    /// Electrons per pixel value (DN); with a `response`, per DN of light.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub electrons_per_dn: Option<f64>,
    /// Read noise: standard deviation of a pixel without light, in electrons.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub read_noise_e: Option<f64>,
    /// Row noise: standard deviation of the offset that all pixels of a row share, independent in every row and frame, in
    /// electrons.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub row_noise_e: Option<f64>,
    /// Share of pixels that are at `saturation` whatever the light (hot pixels). Default: the model's `defects`, or 0.001.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub defects: Option<f64>,
    /// Defective pixels, which fits and searches ignore.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub defect_map: Option<DefectMap>,
    /// Relation of pixel values to light. Fits and searches then use light, in DN above `black`. Requires `saturation`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub response: Option<CameraResponse>,
    /// Intrinsics of camera and lens.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub intrinsics: Option<Intrinsics>,
}

/// Camera intrinsics: the projection of directions to pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Intrinsics {
    /// Width of the calibrated image, px.
    pub width: u32,
    /// Height of the calibrated image, px.
    pub height: u32,
    /// Focal length along x, px.
    pub fx: f64,
    /// Focal length along y, px.
    pub fy: f64,
    /// Principal point, x, px.
    pub cx: f64,
    /// Principal point, y, px.
    pub cy: f64,
    /// Distortion model.
    #[serde(default)]
    pub model: Distortion,
    /// Distortion coefficients, in OpenCV's order.
    #[serde(default)]
    pub coefficients: Vec<f64>,
    /// Covariance of fx, fy, cx, cy (px²) and, with more than four rows, of the coefficients, row by row. It adds to the
    /// covariance of poses.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub covariance: Option<Vec<Vec<f64>>>,
}

/// Models of lens distortion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Distortion {
    /// No distortion (pinhole).
    #[default]
    None,
    /// Brown–Conrady: k1 k2 p1 p2 k3.
    PlumbBob,
    /// Brown–Conrady with a denominator: k1 k2 p1 p2 k3 k4 k5 k6.
    Rational,
    /// Kannala–Brandt: k1 k2 k3 k4.
    Fisheye,
}

impl Camera {
    /// The response that linearises pixel values; `None` when they are linear in light already.
    ///
    /// # Errors
    /// When the response is invalid.
    pub fn linear_response(&self) -> Result<Option<Response>, ResponseError> {
        let response = self.response.as_ref();
        response.map(|response| Response::new(self.black, self.saturation, response)).transpose()
    }

    /// Growth of the rounding variance per DN of light; 0 without a response.
    pub fn rounding_gain(&self) -> f64 {
        let range_dn = self.saturation.unwrap_or(f64::INFINITY) - self.black;
        self.response.as_ref().map_or(0.0, |response| response.rounding_gain(range_dn))
    }

    /// The format of pixels as fits see them.
    pub fn seen_format(&self, format: PixelFormat) -> PixelFormat {
        if self.response.is_some() { PixelFormat::F32 } else { format }
    }

    /// The black level as fits see it.
    pub(crate) fn linear_black(&self) -> f64 {
        if self.response.is_some() { 0.0 } else { self.black }
    }

    /// The variance of row offsets, in pixel values², where known and positive.
    pub(crate) fn row_variance(&self) -> Option<f64> {
        Some((self.row_noise_e? / self.electrons_per_dn?).powi(2)).filter(|variance| *variance > 0.0)
    }

    /// The value that the camera gives a model constant, by name: `gain` in pixel values per electron (plus the
    /// rounding's share of the variance of light, with a response), `read_noise` and `black` in pixel values (a black
    /// level of 0 counts as not given), `defects` as a share of all pixels, `fx` `fy` `cx` `cy` of the lens, px, and
    /// its distortion `lens_k1` … `lens_k6`, `lens_p1`, `lens_p2` (0 where the lens has no such term).
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
