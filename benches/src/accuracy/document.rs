//! A compiled shipped document, shared by all threads.

use std::sync::Arc;

use isophote_jit::PixelFormat;
use isophote_symbolic::{Model, ParameterId, Precision};
use isophote_tracker::{Camera, Compiled, Estimate, Frame, InTurn, Plane, TrackState, Tracker, TrackerOptions};

use super::light::PROFILE;
use super::sensor::{FULL, GAIN, READ_E};

/// A document with its kernels.
pub struct Document {
    compiled: Arc<Compiled>,
    centre: [ParameterId; 2],
    shape: [ParameterId; 3],
    brightness: ParameterId,
}

/// An answer, in the tracker's own units.
#[derive(Clone, Debug)]
pub struct Answer {
    /// px
    pub centre: [f64; 2],
    /// A, px⁻².
    pub shape: [f64; 3],
    /// DN
    pub brightness: f64,
    /// Covariance of the centre: xx, xy, yy.
    pub covariance: Option<[f64; 3]>,
    /// χ²/ν
    pub reduced: Option<f64>,
}

impl Document {
    /// A shipped document, compiled for 8-bit frames.
    pub fn shipped(name: &str) -> Document {
        let model = Arc::new(Model::from_toml(&crate::text(name)).unwrap());
        let roles = &model.roles()[0];
        let centre = [roles.centre[0], roles.centre[1]];
        let shape = [roles.shape[0], roles.shape[1], roles.shape[2]];
        let brightness = roles.brightness.unwrap();
        let compiled = Compiled::new(model, Precision::F32).unwrap();
        compiled.warm(PixelFormat::U8, &InTurn).unwrap();
        Document { compiled: Arc::new(compiled), centre, shape, brightness }
    }

    /// A fresh tracker with these starting values beside the profile, and the given camera with the usual light
    /// levels.
    pub fn tracker(&self, start: &[(&'static str, f64)], known: Camera) -> Tracker {
        let [k1, k2] = PROFILE;
        let start = [&[("k1", k1), ("k2", k2)], start].concat();
        let camera =
            Camera { saturation: Some(FULL), electrons_per_dn: Some(1.0 / GAIN), read_noise_e: Some(READ_E), ..known };
        self.tracker_with(&start, TrackerOptions { camera, ..TrackerOptions::default() })
    }

    /// The same with these starting values alone, and all else by the options.
    pub fn tracker_with(&self, start: &[(&'static str, f64)], options: TrackerOptions) -> Tracker {
        let start = start.iter().map(|(name, value)| (name.to_string(), *value)).collect();
        Tracker::new(self.compiled.clone(), TrackerOptions { start, ..options }).unwrap()
    }

    /// The answer of an estimate; `None` unless tracking.
    pub fn answer(&self, estimate: &Estimate) -> Option<Answer> {
        if estimate.state != TrackState::Tracking {
            return None;
        }
        let value = |id: ParameterId| estimate.parameters[id.index()];
        let place = |id: ParameterId| estimate.order.iter().position(|&free| free == id);
        let covariance = || {
            let matrix = estimate.covariance.as_ref()?;
            let [x, y] = [place(self.centre[0])?, place(self.centre[1])?];
            Some([matrix[x][x], matrix[x][y], matrix[y][y]])
        };
        Some(Answer {
            centre: self.centre.map(value),
            shape: self.shape.map(value),
            brightness: value(self.brightness),
            covariance: covariance(),
            reduced: estimate.reduced_chi_square,
        })
    }
}

/// A frame of `side` × `side` pixels.
pub fn frame(pixels: Vec<u8>, side: usize) -> Frame {
    Frame::new(&[side, side], vec![Plane::owned(PixelFormat::U8, pixels, side)]).unwrap()
}

/// Semi-axes of dᵀAd = 1, the longer first; NaN for non-ellipses.
pub fn semi_axes([a1, a2, a3]: [f64; 3]) -> [f64; 2] {
    let (mean, difference) = ((a1 + a3) / 2.0, (((a1 - a3) / 2.0).powi(2) + a2 * a2).sqrt());
    [(mean - difference).sqrt().recip(), (mean + difference).sqrt().recip()]
}
