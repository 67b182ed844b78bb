//! By how much a thing's profile differs from that of the document, at least, whatever the noise is.
//!
//! What comes in: a fit, and the picture around it. What goes out: its *deviation*, the root mean square over its domain as a share
//! of its height. It never knows a target or a track.
//!
//! In the frame in which the outline is a circle the residuals are described by `uⁱ vʲ exp(−2s)` with i + j = 3 and 4, as far as no
//! fit can have taken that up: the prediction, its slopes and what stretches it, and a ground that slopes, come first. A thing of
//! any shape that is blurred differs from a Gaussian by such terms (Gram and Charlier). What noise makes of them on average is taken
//! off, and three standard deviations more, and what hangs together beside the target: one that stands on clutter is seen through
//! it. The noise is that of the curvature along rows, so that no formula for it is needed.

use nalgebra::{DMatrix, DVector, SymmetricEigen, Vector2};

use super::around::Around;
use crate::sight::background::spread;
use crate::solve::residuals::Residual;

/// The mean of so many neighbours shows what hangs together.
const NEIGHBOURS: f64 = 9.0;
/// 1, u, v, the prediction, its two slopes, and each of these times u and v.
const TAKEN: usize = 10;
/// Products of u and v of third and fourth order.
const POWERS: [[i32; 2]; 9] = [[3, 0], [2, 1], [1, 2], [0, 3], [4, 0], [3, 1], [2, 2], [1, 3], [0, 4]];
const TERMS: usize = TAKEN + POWERS.len();
/// How fast they fall with s.
const FALL: f64 = 2.0;
/// Fewer pixels say nothing.
const PIXELS_MIN: usize = 3 * TERMS;
/// Of larger things every so many pixels are looked at, that there be about so many.
const PIXELS: usize = 16_384;
/// A sum of squares may be larger than its mean by so many of its standard deviations.
const SCATTER: f64 = 3.0;
/// Of few pixels, and of noise that is not that of the target's own, the variance may be so many times as large.
const UNEVEN: f64 = 1.3;
/// The variance of a curvature of white noise, over that of the noise.
const CURVED: f64 = 6.0;
/// Directions of smaller eigenvalues, of unit vectors' products, are those of larger ones.
const DISTINCT: [f64; 2] = [1e-9, 1e-6];

/// Residuals and predictions of a window in standard deviations of the noise, as the model states it; NaN where there is none.
struct Plane {
    residuals: Vec<f64>,
    predicted: Vec<f64>,
    width: usize,
}

/// Of a target in two dimensions. `None` where too few pixels say something.
pub(super) fn of(around: &Around) -> Option<f64> {
    let plane = Plane::of(&around.everything, around.window.pixels(), around.window.width);
    let pixels: Vec<usize> = around.clear().filter(|pixel| plane.slopes(*pixel).is_some()).collect();
    if pixels.len() < PIXELS_MIN {
        return None;
    }
    let beside: Vec<f64> = around.beside().filter_map(|pixel| plane.smoothed(pixel)).collect();
    plane.deviation(&pixels, &beside, |pixel| around.place(pixel))
}

impl Plane {
    fn of(residuals: &[Residual], pixels: usize, width: usize) -> Plane {
        let mut plane = Plane { residuals: vec![f64::NAN; pixels], predicted: vec![f64::NAN; pixels], width };
        for residual in residuals {
            plane.predicted[residual.pixel] = residual.predicted / residual.deviation;
            if !residual.saturated {
                plane.residuals[residual.pixel] = residual.whitened;
            }
        }
        plane
    }

    /// Of the prediction, along x and y; `None` at the border.
    fn slopes(&self, pixel: usize) -> Option<[f64; 2]> {
        let x = pixel % self.width;
        let is_inside = x > 0 && x + 1 < self.width && pixel >= self.width;
        let below = *self.predicted.get(pixel + self.width).filter(|_| is_inside)?;
        let along = 0.5 * (self.predicted[pixel + 1] - self.predicted[pixel - 1]);
        let down = 0.5 * (below - self.predicted[pixel - self.width]);
        (along.is_finite() && down.is_finite()).then_some([along, down])
    }

    /// The mean over 3 × 3 pixels, where all are known.
    fn smoothed(&self, pixel: usize) -> Option<f64> {
        let x = pixel % self.width;
        let row = |middle: usize| Some(self.residuals.get(middle - 1..middle + 2)?.iter().sum::<f64>());
        let is_inside = x > 0 && x + 1 < self.width && pixel >= self.width;
        let rows = [row(is_inside.then(|| pixel - self.width)?)?, row(pixel)?, row(pixel + self.width)?];
        Some(rows.iter().sum::<f64>() / NEIGHBOURS).filter(|mean| mean.is_finite())
    }

    /// The variance of the noise.
    fn noise(&self, pixels: &[usize]) -> Option<f64> {
        let curvature = |pixel: &usize| {
            let row = &self.residuals[pixel - 1..pixel + 2];
            row[0] - 2.0 * row[1] + row[2]
        };
        let squares = pixels.iter().map(curvature).filter(|value| !value.is_nan()).map(|value| value * value);
        let (count, sum) = squares.fold((0, 0.0), |(count, sum), square| (count + 1, sum + square));
        (count >= PIXELS_MIN).then(|| sum / (CURVED * f64::from(count as u32))).filter(|noise| *noise > 0.0)
    }

    /// `beside`: smoothed residuals beside the target.
    fn deviation(&self, pixels: &[usize], beside: &[f64], place: impl Fn(usize) -> Vector2<f64>) -> Option<f64> {
        let noise = self.noise(pixels)?;
        let ground = (spread(beside).powi(2) - UNEVEN * noise / NEIGHBOURS).max(0.0);
        let height = |pixel: &usize| self.predicted[*pixel];
        let heights = pixels
            .iter()
            .map(height)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), height| (least.min(height), most.max(height)));
        let (mut products, mut sums, mut count) = (DMatrix::zeros(TERMS, TERMS), DVector::zeros(TERMS), 0.0);
        for pixel in pixels.iter().step_by(pixels.len().div_ceil(PIXELS)) {
            let terms = terms(place(*pixel), self.predicted[*pixel] - heights.0, self.slopes(*pixel)?);
            products.syger(1.0, &terms, &terms, 1.0);
            sums.axpy(self.residuals[*pixel], &terms, 1.0);
            count += 1.0;
        }
        products.fill_upper_triangle_with_lower_triangle();
        let (explained, freedom) = explained(products, sums)?;
        let excess = explained / noise - freedom - SCATTER * (2.0 * freedom).sqrt();
        let deviation = (excess * noise / count - ground).max(0.0).sqrt() / (heights.1 - heights.0);
        Some(deviation).filter(|deviation| deviation.is_finite())
    }
}

/// What a pixel has of each term.
fn terms(place: Vector2<f64>, predicted: f64, [along, down]: [f64; 2]) -> DVector<f64> {
    let (u, v) = (place.x, place.y);
    let taken = [1.0, u, v, predicted, along, down, u * along, v * along, u * down, v * down];
    let fall = (-FALL * place.norm_squared()).exp();
    let powers = POWERS.iter().map(|[i, j]| u.powi(*i) * v.powi(*j) * fall);
    DVector::from_iterator(TERMS, taken.into_iter().chain(powers))
}

/// By how much the powers lower the sum of squares once everything else has, and how many of them there are.
fn explained(products: DMatrix<f64>, sums: DVector<f64>) -> Option<(f64, f64)> {
    let scale = products.diagonal().map(|square| if square > 0.0 { square.sqrt().recip() } else { 0.0 });
    let products = DMatrix::from_fn(TERMS, TERMS, |i, j| products[(i, j)] * scale[i] * scale[j]);
    let sums = sums.component_mul(&scale);
    let powers = TERMS - TAKEN;
    let (own, shared) = (products.view((0, 0), (TAKEN, TAKEN)), products.view((0, TAKEN), (TAKEN, powers)));
    let (inverse, _) = inverse(own.into_owned(), DISTINCT[0])?;
    let left = products.view((TAKEN, TAKEN), (powers, powers)) - shared.transpose() * &inverse * shared;
    let sums = sums.rows(TAKEN, powers) - shared.transpose() * inverse * sums.rows(0, TAKEN);
    let (inverse, freedom) = self::inverse(left, DISTINCT[1])?;
    Some(((sums.transpose() * inverse * sums)[(0, 0)], freedom))
}

/// Of what has eigenvalues that are not smaller than this, of the largest, and how many it has.
fn inverse(matrix: DMatrix<f64>, least: f64) -> Option<(DMatrix<f64>, f64)> {
    if matrix.iter().any(|value| !value.is_finite()) {
        return None;
    }
    let eigen = SymmetricEigen::new(matrix);
    let largest = eigen.eigenvalues.max();
    let kept = eigen.eigenvalues.map(|value| if value > least * largest { value.recip() } else { 0.0 });
    let count = kept.iter().filter(|value| **value > 0.0).count();
    (count > 0).then(|| {
        let vectors = &eigen.eigenvectors;
        (vectors * DMatrix::from_diagonal(&kept) * vectors.transpose(), f64::from(count as u32))
    })
}
