//! Projection geometry for benchmarks and programs with ellipses of their own.

use isophote_symbolic::Model;
use nalgebra::Vector2;

pub use super::conic::{Circle, Ellipse, circles_of_ellipse};
pub use super::p3p::p3p;
use super::profile::Profile;
pub use super::rigid::{Rigid, kabsch};
use super::seen::{outline, seen};
use super::target::TargetSpot;
use crate::camera::Intrinsics;

/// Centre and half extents of the projected contour s = 1 of a spot: x, y, half width, half height, px. `None` when it
/// is not in front of the camera.
pub fn bounds(lens: &Intrinsics, pose: &Rigid, spot: &TargetSpot) -> Option<[f64; 4]> {
    let [x, y, a1, a2, a3] = <[f64; 5]>::from(outline(lens, pose, spot)?);
    let determinant = a1 * a3 - a2 * a2;
    Some([x, y, (a3 / determinant).sqrt(), (a1 / determinant).sqrt()])
}

/// The ellipse (x, y, a1, a2, a3) of the projected contour s = 1 of a spot, px, px⁻². `None` when it is not in front of
/// the camera.
pub fn outline_ellipse(lens: &Intrinsics, pose: &Rigid, spot: &TargetSpot) -> Option<[f64; 5]> {
    outline(lens, pose, spot).map(Into::into)
}

/// The ellipse (x, y, a1, a2, a3) that a fit of `model` finds for a spot, given the profile with these parameters and
/// constants. The spot's name selects the table of roles. Pixels at or above `saturation` are excluded.
pub fn fitted_ellipse(
    (model, parameters, constants): (&Model, &[f64], &[f64]),
    saturation: f64,
    lens: &Intrinsics,
    pose: &Rigid,
    spot: &TargetSpot,
) -> Option<[f64; 5]> {
    let roles = model.roles().iter().find(|roles| roles.name.as_ref() == Some(&spot.name))?;
    let profile = Profile::of(model, roles, parameters, constants, saturation)?;
    seen(lens, pose, spot, &profile).map(Into::into)
}

/// The ellipse (x, y, a1, a2, a3), px, in normalised coordinates, where the lens is a pinhole of focal length 1.
pub fn normalised_ellipse(lens: &Intrinsics, [x, y, a1, a2, a3]: [f64; 5]) -> Option<Ellipse> {
    let at = lens.normalised([x, y])?;
    let (_, [[xx, xy], [yx, yy]]) = lens.pixel(at)?;
    let slopes = nalgebra::Matrix2::new(xx, xy, yx, yy);
    let shape = nalgebra::Matrix2::new(a1, a2, a2, a3);
    Some(Ellipse { centre: Vector2::from(at), shape: slopes.transpose() * shape * slopes })
}
