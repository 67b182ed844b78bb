//! How a thing of another shape is told from the target without any knowledge of the noise, or of its profile.
//!
//! What comes in: a fit, and the picture around it. What goes out: its asymmetry, and the log odds that it takes away. It never
//! knows a target or a track.
//!
//! *Asymmetry* is the share of the target's height by which residuals go as cos mφ or sin mφ around the outline, m = 3 … 6, in
//! the frame in which it is a circle. An ellipse has none, whatever its profile; corners and ends do. What noise makes of it
//! is taken off, and what lies beside the target: one that stands on clutter is seen through it.
//!
//! The limit and the weight were chosen by 2,042 fits of `spot` and `gaussian` to things among clutter and to photographs of
//! beams: docs/confidence.md.

use isophote_jit::Window;
use nalgebra::Complex;

use super::around::Around;
use crate::sight::background::spread;
use crate::solve::residuals::Residual;

/// Light makes the middle of a target noisier than its domain is on average, by about this factor.
const LIT: f64 = 1.4;
/// Waves around the outline, one after the other, …
const WAVES: [u32; 4] = [3, 4, 5, 6];
/// … looked at between these values of s.
const RIM: [f64; 2] = [0.2, 1.6];
/// Fewer pixels say nothing.
const PIXELS_MIN: usize = 12;
/// So much of the height is forgiven, since no target is quite even …
const FORGIVEN: f64 = 0.01;
/// … more than this says nothing more, …
const MOST: f64 = 0.3;
/// … and what lies between takes so much of the log odds.
const WEIGHT: f64 = 450.0;

/// The log odds that an asymmetry takes away.
pub(super) fn against(asymmetry: f64) -> f64 {
    WEIGHT * (asymmetry.min(MOST) - FORGIVEN).max(0.0)
}

/// Residuals of a window, pixel values; NaN where there is none.
struct Plane {
    values: Vec<f64>,
    width: usize,
}

impl Plane {
    fn of(residuals: &[Residual], window: Window) -> Plane {
        let mut values = vec![f64::NAN; window.pixels()];
        for residual in residuals.iter().filter(|residual| !residual.saturated) {
            values[residual.pixel] = residual.whitened * residual.deviation;
        }
        Plane { values, width: window.width }
    }

    /// The mean over 3 × 3 pixels, as far as they are known.
    fn smoothed(&self, pixel: usize) -> f64 {
        let (x, y) = (pixel % self.width, pixel / self.width);
        let height = self.values.len() / self.width;
        let (mut sum, mut count) = (0.0, 0.0);
        for row in y.saturating_sub(1)..(y + 2).min(height) {
            for column in x.saturating_sub(1)..(x + 2).min(self.width) {
                let value = self.values[row * self.width + column];
                if !value.is_nan() {
                    (sum, count) = (sum + value, count + 1.0);
                }
            }
        }
        sum / count
    }

    /// Curvature along the row: of white noise of unit variance its variance is 6.
    fn curvature(&self, pixel: usize) -> f64 {
        let x = pixel % self.width;
        match x > 0 && x + 1 < self.width {
            true => self.values[pixel - 1] - 2.0 * self.values[pixel] + self.values[pixel + 1],
            false => f64::NAN,
        }
    }
}

/// Of a target in two dimensions; `limit` is the largest value that a pixel may have. `None` where hardly any pixel says something.
pub(super) fn of(around: &Around, limit: f64) -> Option<f64> {
    let plane = Plane::of(&around.everything, around.window);
    let pixels: Vec<usize> = around.clear().collect();
    if pixels.len() < PIXELS_MIN {
        return None;
    }
    let (mut sums, mut count) = ([[0.0; 2]; WAVES.len()], 0.0);
    for pixel in &pixels {
        let place = around.place(*pixel);
        if (RIM[0]..=RIM[1]).contains(&place.norm_squared()) {
            count += 1.0;
            // The m-th power of a number on the unit circle has m times its angle.
            let once = Complex::new(place.x, place.y).unscale(place.norm());
            let mut turned = once.powu(WAVES[0]);
            for sum in &mut sums {
                sum[0] += plane.values[*pixel] * turned.re;
                sum[1] += plane.values[*pixel] * turned.im;
                turned *= once;
            }
        }
    }
    let count = f64::max(count, 1.0);
    let power = sums.iter().flatten().map(|sum| (2.0 * sum / count).powi(2)).sum::<f64>();
    let curvatures = pixels.iter().map(|pixel| plane.curvature(*pixel)).filter(|value| !value.is_nan());
    let noise = LIT * spread(&curvatures.collect::<Vec<f64>>()) / 6.0_f64.sqrt();
    let beside = around.beside().map(|pixel| plane.smoothed(pixel));
    let beside: Vec<f64> = beside.filter(|value| !value.is_nan()).collect();
    let beside = if beside.len() < PIXELS_MIN { 0.0 } else { spread(&beside) };
    // Each of the squares is 2σ²/n of noise alone; thrice that is hardly ever exceeded.
    let forgiven = 3.0 * 4.0 * WAVES.len() as f64 * noise * noise / count + beside * beside;
    let predicted = || around.inside.iter().map(|residual| residual.predicted.min(limit));
    let height = predicted().fold(f64::NEG_INFINITY, f64::max) - predicted().fold(f64::INFINITY, f64::min);
    Some((power - forgiven).max(0.0).sqrt() / height).filter(|asymmetry| asymmetry.is_finite())
}
