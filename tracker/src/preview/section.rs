//! `CrossSection`: a row of pixels through the first target's centre with the model's prediction.

use isophote_jit::Window;

use super::level;
use super::viewer::{FrameScene, SeenTarget};

/// Largest number of pixels of a section; a wider window is cropped around the centre.
const PIXELS_MAX: usize = 1024;

/// A section along x through a target's centre.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct CrossSection {
    /// The row, px.
    pub y: usize,
    /// Its first pixel, px.
    pub x: usize,
    /// The observation, the first value of a document with several; NaN for pixels without a value.
    pub observed: Vec<f64>,
    /// The prediction; NaN outside of the domain.
    pub model: Vec<f32>,
    /// The standard deviation of a pixel; NaN outside of the domain.
    pub sigma: Vec<f32>,
    /// The observed value of a clipped pixel; infinite where none clips.
    pub saturation: f64,
}

impl FrameScene<'_> {
    /// The section through the first target.
    pub(super) fn section(&self) -> Option<CrossSection> {
        let target = self.targets.first()?;
        let window = target.window;
        let [x, y] = self.centre(target)?.map(|at| at.round().max(0.0) as usize);
        let is_inside = (window.y..window.y + window.height).contains(&y) && x < window.x + window.width;
        if !is_inside {
            return None;
        }
        let first = x.saturating_sub(PIXELS_MAX / 2).max(window.x);
        let width = (window.x + window.width - first).min(PIXELS_MAX);
        let row = Window { x: first, y, width, height: 1, ..window };
        let seen = self.unexplained(target, row).into_iter().next()?;
        let sigma = seen.deviation.iter().zip(&seen.intensity);
        let sigma = sigma.map(|(sigma, predicted)| if predicted.is_nan() { f32::NAN } else { *sigma }).collect();
        let (observed, model) = (seen.observed, seen.intensity);
        Some(CrossSection { y, x: first, observed, model, sigma, saturation: seen.limit })
    }

    /// x, y of a target's centre: its role, else the first spot of a pose, else where the prediction is farthest from the
    /// background. A line has y = 0.
    fn centre(&self, target: &SeenTarget) -> Option<[f64; 2]> {
        let (model, solver) = (self.viewer.model(), self.viewer.solver());
        let roles = model.roles().first().map(|roles| &roles.centre[..]).unwrap_or_default();
        match roles {
            [x] => return Some([target.parameters[x.index()], 0.0]),
            [x, y, ..] => return Some([target.parameters[x.index()], target.parameters[y.index()]]),
            [] => {}
        }
        if let Some(geometry) = &solver.geometry {
            let outlines = geometry.outlines(&target.parameters);
            return outlines.into_iter().flatten().next().map(|spot| [spot[0], spot[1]]);
        }
        let intensity = self.viewer.predicted().first(&target.parameters, target.window)?;
        level::peak(model, &target.parameters, target.window, &intensity)
    }
}
