//! The Cramér–Rao bound of a pose: the inverse Fisher information of all unsaturated pixels.

use isophote_tracker::Target;
use isophote_tracker::geometry::Rigid;
use nalgebra::{DMatrix, DVector, Matrix6, Vector6};

use super::light::Light;
use super::scene::{BACKGROUND, LIMIT, WIDTH, patch, place_inside, variance};

/// Covariance of (δt, δω) with each spot's brightness and one background unknown; the PSF known.
pub fn bound(pose: &Rigid, target: &Target, brightness: f64) -> Option<Matrix6<f64>> {
    bound_of(pose, target, &Light::grey(brightness, target.spots.len()), &|_| true)
}

/// The same for any light, with a background per channel, using only the pixels for which `is_left` holds.
pub fn bound_of(pose: &Rigid, target: &Target, light: &Light, is_left: &dyn Fn(usize) -> bool) -> Option<Matrix6<f64>> {
    let (spots, channels) = (&target.spots, light.mixing.len());
    let unknowns = 6 + channels + spots.len();
    let mut information = DMatrix::zeros(unknowns, unknowns);
    for (index, spot) in spots.iter().enumerate() {
        let Some(at) = place_inside(pose, spot) else { continue };
        let shares = |pose: &Rigid| patch(pose, spot, light.rim, at, 4).shares;
        let here = shares(pose);
        let slopes: Vec<Vec<f64>> = (0..6)
            .map(|k| {
                let nudge = if k < 3 { 1e-3 } else { 1e-5 };
                let mut by = Vector6::zeros();
                by[k] = nudge;
                let (ahead, back) = (shares(&pose.moved(&by)), shares(&pose.moved(&-by)));
                ahead.iter().zip(back).map(|(a, b)| (a - b) / (2.0 * nudge)).collect()
            })
            .collect();
        for (channel, mixing) in light.mixing.iter().enumerate() {
            let height = mixing[index] * light.brightness[index];
            for (pixel, share) in here.iter().enumerate() {
                let mean = BACKGROUND + height * share;
                let number = (at[1] + pixel / at[2]) * WIDTH + at[0] + pixel % at[2];
                if mean > LIMIT - 0.5 || !is_left(number) {
                    continue;
                }
                let mut row = DVector::zeros(unknowns);
                slopes.iter().enumerate().for_each(|(k, slope)| row[k] = height * slope[pixel]);
                row[6 + channel] = 1.0;
                row[6 + channels + index] = mixing[index] * share;
                information.ger(1.0 / variance(mean), &row, &row, 1.0);
            }
        }
    }
    // A completely hidden spot carries no information: fix its brightness.
    for index in 6..unknowns {
        if information[(index, index)] == 0.0 {
            information[(index, index)] = 1.0;
        }
    }
    let scale = information.diagonal().map(|d: f64| d.sqrt().recip());
    let scaled = DMatrix::from_fn(unknowns, unknowns, |i, j| scale[i] * information[(i, j)] * scale[j]);
    let inverse = scaled.cholesky()?.inverse();
    Some(Matrix6::from_fn(|i, j| scale[i] * inverse[(i, j)] * scale[j]))
}
