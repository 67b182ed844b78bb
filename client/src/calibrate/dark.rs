//! Frames taken without light, for the black level.

use std::path::Path;

use isophote_capture::{FrameSource, Recording};

use crate::failure::Failure;

/// Statistics of frames without light.
pub struct Dark {
    /// Mean and its standard deviation.
    pub mean: [f64; 2],
    /// Share of values at 0: clipping there biases the mean.
    pub clipped: f64,
}

impl Dark {
    /// Over all pixels of all frames.
    pub fn of(path: &Path) -> Result<Dark, Failure> {
        let mut recording = Recording::open(path).map_err(Failure::other)?;
        let (mut sum, mut squares, mut clipped, mut count) = (0.0, 0.0, 0.0, 0.0);
        while let Some(captured) = recording.next().map_err(Failure::other)? {
            for plane in 0..captured.frame.planes().len() {
                let view = captured.frame.plane_view(plane);
                let places = (0..view.height()).flat_map(|y| (0..view.width()).map(move |x| (x, y)));
                for value in places.map(|(x, y)| view.pixel(x, y)).filter(|value| value.is_finite()) {
                    (sum, squares, count) = (sum + value, squares + value * value, count + 1.0);
                    clipped += f64::from(u8::from(value == 0.0));
                }
            }
        }
        if count == 0.0 {
            return Err(Failure::Other(format!("{}: there is no pixel", path.display())));
        }
        let mean: f64 = sum / count;
        let sigma = ((squares / count - mean * mean).max(0.0) / count).sqrt();
        Ok(Dark { mean: [mean, sigma], clipped: clipped / count })
    }
}
