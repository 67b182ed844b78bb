//! How far a thing is from the image that a document has of its target, before the camera's noise.
//!
//! What comes in: the light of a frame, and what was fitted to it. What goes out: the root mean square of what is left of the
//! light once the document's image is taken away, by the image's height. It never knows how the fit was made.

use nalgebra::{DMatrix, DVector};

use super::scene::{SIZE, share};
use crate::accuracy::search::scene::over_pixel;

/// What belongs to a target, in s of its outline.
const REACH: f64 = 2.2;
/// What no pixel exceeds, DN.
const WHITE: f64 = 255.0;

/// The centre and outline are those of the fit; height and ground, with a slope where the document has one, those that suit the
/// light best. Infinite where that cannot be said.
pub fn unlike(document: &str, parameters: &[f64], light: &[f64]) -> f64 {
    let &[bx, by, a1, a2, a3, ..] = parameters else { return f64::INFINITY };
    let s = |x: f64, y: f64| a1 * x * x + 2.0 * a2 * x * y + a3 * y * y;
    let image = |x: f64, y: f64| over_pixel(|dx, dy| share(document, s(x + dx, y + dy)));
    let place = |i: usize| ((i % SIZE[0]) as f64 - bx, (i / SIZE[0]) as f64 - by);
    let inside = |i: &usize| {
        let (x, y) = place(*i);
        s(x, y) <= REACH
    };
    let pixels: Vec<usize> = (0..light.len()).filter(inside).collect();
    let slopes = if document == "spot-plane" { 2 } else { 0 };
    let terms = DMatrix::from_fn(pixels.len(), 2 + slopes, |row, term| {
        let (x, y) = place(pixels[row]);
        [image(x, y), 1.0, x, y][term]
    });
    let seen = DVector::from_iterator(pixels.len(), pixels.iter().map(|i| light[*i].min(WHITE)));
    let Some(inverse) = (terms.transpose() * &terms).try_inverse() else { return f64::INFINITY };
    let best = inverse * terms.transpose() * &seen;
    let left = (seen - &terms * &best).norm() / (pixels.len() as f64).sqrt();
    Some(left / best[0].abs()).filter(|share| share.is_finite()).unwrap_or(f64::INFINITY)
}

#[cfg(test)]
mod tests {
    use super::super::scene::add_target;
    use super::*;

    #[test]
    fn a_target_is_alike_and_a_square_is_not() {
        let a = 12.0_f64.powi(-2);
        let mut light = vec![20.0; SIZE[0] * SIZE[1]];
        add_target(&mut light, "gaussian", [300.3, 200.8], [12.0; 2], 0.0, 100.0);
        let own = unlike("gaussian", &[300.3, 200.8, a, 0.0, a], &light);
        let spot = unlike("spot", &[300.3, 200.8, a, 0.0, a], &light);
        assert!(own < 1e-6 && spot > 0.02, "{own} {spot}");
    }
}
