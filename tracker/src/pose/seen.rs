//! The ellipse that a fit finds for a round spot: that of the best elliptic spot, although the spot's projected
//! contours are not concentric ellipses.
//!
//! Under perspective each contour s = const projects to an ellipse with a centre of its own, none of which is the
//! projection of the spot's centre. A model with one centre for all contours settles in between: for weights w the
//! fitted centre lies at the share `∫ w f'² s² ds / ∫ w f'² s ds` of the offset from the projected centre to the centre
//! of the contour s = 1, to first order in perspective. To all orders, and with lens distortion, it is the
//! least-squares fit itself, carried out here on a grid of the spot's plane: f(s) of each point is compared with f of
//! the ellipse there, weighted as the pixels are.

use nalgebra::{Matrix2, SVector, Vector2, Vector3};

use super::conic::{Ellipse, conic_of_circle};
use super::profile::{Profile, REACH};
use super::rigid::Rigid;
use super::target::TargetSpot;
use crate::camera::Intrinsics;
use crate::least_squares::{NormalEquations, least_squares};

/// x, y of the centre and a1, a2, a3: px, px⁻².
pub(crate) type Five = SVector<f64, 5>;

/// Budget: the fit converges when the next step would change the light by less than this share, about a millionth of
/// the spot's radius.
const ALIKE: f64 = 1e-6;
/// Places along a contour.
const ANGLES: usize = 12;
/// Bounds of the rings in s.
const RINGS: [f64; 6] = [0.0, 0.35, 0.7, 1.0, 1.2, REACH];
/// Gauss–Legendre nodes on [−1, 1].
const NODES: [f64; 4] =
    [-0.861_136_311_594_052_6, -0.339_981_043_584_856_3, 0.339_981_043_584_856_3, 0.861_136_311_594_052_6];
/// Gauss–Legendre weights.
const WEIGHTS: [f64; 4] =
    [0.347_854_845_137_453_9, 0.652_145_154_862_546_1, 0.652_145_154_862_546_1, 0.347_854_845_137_453_9];

/// The projected contour s = 1, with the lens linearised at its centre.
pub(crate) fn outline(lens: &Intrinsics, pose: &Rigid, spot: &TargetSpot) -> Option<Five> {
    let conic = conic_of_circle(pose, spot.centre(), spot.radius_mm)?;
    let ellipse = Ellipse::of_conic(&conic)?;
    if pose.apply(spot.centre()).z <= 0.0 {
        return None;
    }
    let (pixel, [[xx, xy], [yx, yy]]) = lens.pixel(ellipse.centre.into())?;
    let ellipse = ellipse.mapped(&Matrix2::new(xx, xy, yx, yy), Vector2::from(pixel))?;
    let (c, a) = (ellipse.centre, ellipse.shape);
    Some(Five::new(c.x, c.y, a.m11, a.m12, a.m22))
}

/// The ellipse of the best elliptic spot of that profile.
pub(crate) fn seen(lens: &Intrinsics, pose: &Rigid, spot: &TargetSpot, profile: &Profile) -> Option<Five> {
    let ellipse = outline(lens, pose, spot)?;
    let grid = grid(lens, pose, spot, profile)?;
    let rim = profile.at(REACH).0;
    // Free parameters: the ellipse, the background and the height.
    let equations = |fit: &SVector<f64, 7>| {
        Some(NormalEquations::of(grid.iter().map(|sample| {
            let (dx, dy) = (sample.pixel[0] - fit[0], sample.pixel[1] - fit[1]);
            let s = fit[2] * dx * dx + 2.0 * fit[3] * dx * dy + fit[4] * dy * dy;
            let (value, slope) = profile.at(s);
            let slope = fit[6] * slope;
            let row = SVector::from([
                -2.0 * slope * (fit[2] * dx + fit[3] * dy),
                -2.0 * slope * (fit[3] * dx + fit[4] * dy),
                slope * dx * dx,
                2.0 * slope * dx * dy,
                slope * dy * dy,
                1.0,
                value - rim,
            ]);
            (sample.value - fit[5] - fit[6] * (value - rim), row, sample.weight)
        })))
    };
    let light: f64 = grid.iter().map(|sample| sample.weight * (sample.value - rim).powi(2)).sum();
    let start = SVector::from([ellipse[0], ellipse[1], ellipse[2], ellipse[3], ellipse[4], rim, 1.0]);
    let found = least_squares(start, ALIKE * ALIKE * light, equations, |fit, by| fit + by)?;
    found.is_converged.then(|| found.point.fixed_rows::<5>(0).into_owned())
}

struct Sample {
    pixel: [f64; 2],
    value: f64,
    /// Area in the picture times 1 / variance.
    weight: f64,
}

/// Quadrature points of the spot's plane with their projections.
fn grid(lens: &Intrinsics, pose: &Rigid, spot: &TargetSpot, profile: &Profile) -> Option<Vec<Sample>> {
    let mut bounds = RINGS.to_vec();
    bounds.extend(profile.clipped_to().filter(|edge| *edge < REACH));
    bounds.sort_by(f64::total_cmp);
    let mut samples = Vec::with_capacity((bounds.len() - 1) * NODES.len() * ANGLES);
    let normal = pose.rotation.column(2);
    for ring in bounds.windows(2) {
        let half = 0.5 * (ring[1] - ring[0]);
        for (node, share) in NODES.into_iter().zip(WEIGHTS) {
            let s = ring[0] + half * (1.0 + node);
            let (value, weight) = (profile.at(s).0, profile.weight(s));
            if weight == 0.0 {
                continue;
            }
            for k in 0..ANGLES {
                let (sin, cos) = (std::f64::consts::TAU * (k as f64 + 0.5) / ANGLES as f64).sin_cos();
                let radius = spot.radius_mm * s.sqrt();
                let point = pose.apply(spot.centre() + Vector3::new(radius * cos, radius * sin, 0.0));
                if point.z <= 0.0 {
                    return None;
                }
                let (pixel, [[xx, xy], [yx, yy]]) = lens.pixel([point.x / point.z, point.y / point.z])?;
                // A piece dX dY of the plane covers (n·P / Z³) dX dY of normalised coordinates.
                let area = (normal.dot(&point) / point.z.powi(3)).abs() * (xx * yy - xy * yx);
                samples.push(Sample { pixel, value, weight: weight * area * half * share });
            }
        }
    }
    Some(samples)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::camera::Distortion;
    use crate::pose::profile::tests::cubic;
    use nalgebra::Rotation3;

    pub fn pinhole() -> Intrinsics {
        Intrinsics {
            width: 640,
            height: 480,
            fx: 600.0,
            fy: 600.0,
            cx: 319.5,
            cy: 239.5,
            model: Distortion::None,
            coefficients: Vec::new(),
            covariance: None,
        }
    }

    fn spot() -> TargetSpot {
        TargetSpot { name: "one".into(), position_mm: [0.0; 3], radius_mm: 30.0 }
    }

    fn tilted(degrees: f64, distance: f64) -> Rigid {
        let rotation = Rotation3::new(Vector3::new(0.0, f64::to_radians(degrees), 0.0)).into_inner();
        Rigid { rotation, translation: Vector3::new(0.0, 0.0, distance) }
    }

    /// Notes' table of centres: 0.17, 0.27, 0.23 px at 1 m and 20°, 45°, 60°; 1.08 px at 500 mm and 45°.
    #[test]
    fn the_centre_of_the_outline_differs_from_the_projected_centre() {
        for (degrees, distance, expected) in
            [(20.0, 1000.0, 0.17), (45.0, 1000.0, 0.27), (60.0, 1000.0, 0.23), (45.0, 500.0, 1.08)]
        {
            let ellipse = outline(&pinhole(), &tilted(degrees, distance), &spot()).unwrap();
            let off = (ellipse[0] - 319.5).hypot(ellipse[1] - 239.5);
            assert!((off - expected).abs() < 0.01, "{degrees}° at {distance} mm: {off} px");
        }
    }

    /// `∫ f'² s² ds / ∫ f'² s ds` = (1/3 − 2/5 + 1/7) / (1/6) for f' ∝ 1 − s² and even weights.
    #[test]
    fn the_fitted_centre_is_at_the_share_of_the_profile() {
        let mut even = cubic(100.0, f64::INFINITY);
        even.flatten();
        let pose = tilted(30.0, 3000.0);
        let (all, fit) =
            (outline(&pinhole(), &pose, &spot()).unwrap(), seen(&pinhole(), &pose, &spot(), &even).unwrap());
        let share = (fit[0] - 319.5) / (all[0] - 319.5);
        assert!((share - 16.0 / 35.0).abs() < 0.005, "{share}");
        // Noise weighs the bright middle less, saturation removes it: the rim counts more.
        let noisy = seen(&pinhole(), &pose, &spot(), &cubic(130.0, 255.0)).unwrap();
        let noisy = (noisy[0] - 319.5) / (all[0] - 319.5);
        let clipped = seen(&pinhole(), &pose, &spot(), &cubic(470.0, 255.0)).unwrap();
        let clipped = (clipped[0] - 319.5) / (all[0] - 319.5);
        assert!(noisy > share + 0.03 && clipped > noisy + 0.05, "{share} {noisy} {clipped}");
    }

    #[test]
    fn a_frontal_spot_on_the_axis_is_not_biased() {
        let pose = tilted(0.0, 800.0);
        let (all, fit) = (
            outline(&pinhole(), &pose, &spot()).unwrap(),
            seen(&pinhole(), &pose, &spot(), &cubic(100.0, 255.0)).unwrap(),
        );
        assert!((all - fit).amax() < 1e-9);
    }

    #[test]
    fn lens_distortion_changes_the_ellipse() {
        let lens =
            Intrinsics { model: Distortion::PlumbBob, coefficients: vec![-0.3, 0.1, 0.001, -0.001, 0.0], ..pinhole() };
        let pose = Rigid { translation: Vector3::new(300.0, 200.0, 800.0), ..tilted(0.0, 800.0) };
        let (all, fit) =
            (outline(&lens, &pose, &spot()).unwrap(), seen(&lens, &pose, &spot(), &cubic(100.0, 255.0)).unwrap());
        let apart = (all - fit).fixed_rows::<2>(0).norm();
        assert!((0.01..1.0).contains(&apart), "{apart} px");
    }
}
