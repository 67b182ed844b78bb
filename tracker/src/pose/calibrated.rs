//! The contribution of the lens calibration's covariance to a pose's covariance.
//!
//! When the lens' figures change by δ, a fit changes the pose so that the spots' outlines stay as close as possible to
//! the observed ones, with equal weight for each point: `(GᵀG)⁻¹ Gᵀ E δ`, with G and E the derivatives of the points,
//! across the outline, by the pose and by the figures.

use nalgebra::{DMatrix, DVector, Matrix6, Vector6};

use super::Pose;
use super::measured::row_major;
use super::rigid::Rigid;
use super::seen::{Five, outline};
use super::target::{Target, TargetSpot};
use crate::camera::Intrinsics;

/// Points along each outline.
const PLACES: usize = 16;
/// Steps of numerical derivatives by the pose, mm and rad.
const NUDGES: [f64; 6] = [1e-3, 1e-3, 1e-3, 1e-6, 1e-6, 1e-6];
/// The same by focal lengths and principal points, px.
const NUDGE_PX: f64 = 1e-3;
/// The same by distortion coefficients.
const NUDGE: f64 = 1e-7;
/// Directions in which points move less than this share of the largest motion are unobservable: a round spot's spin.
const UNSEEN: f64 = 1e-9;

/// Adds the lens' uncertainty to the pose's covariance.
pub(crate) fn with_lens(pose: Pose, lens: &Intrinsics, target: &Target) -> Pose {
    let spots: Vec<&TargetSpot> = target.spots.iter().filter(|spot| !pose.left_out.contains(&spot.name)).collect();
    let rigid = Rigid::of_quaternion(pose.position_mm, pose.orientation_xyzw);
    let Some(added) = of_lens(lens, &rigid, &spots) else { return pose };
    let sum = |covariance: Vec<f64>| covariance.iter().zip(row_major(&added)).map(|(own, added)| own + added).collect();
    Pose { covariance: pose.covariance.map(sum), ..pose }
}

/// The contribution in camera axes, as a pose's own covariance: mm², mm rad, rad². `None` when the lens has no
/// covariance, or a spot cannot be projected.
fn of_lens(lens: &Intrinsics, pose: &Rigid, spots: &[&TargetSpot]) -> Option<Matrix6<f64>> {
    let rows = lens.covariance.as_ref()?;
    let count = rows.len();
    let covariance = DMatrix::from_fn(count, count, |i, j| rows[i][j]);
    let outlines: Vec<Five> = spots.iter().map(|spot| outline(lens, pose, spot)).collect::<Option<_>>()?;
    let places = |lens: &Intrinsics, pose: &Rigid| moved(lens, pose, spots, &outlines);
    let mut by_pose = DMatrix::zeros(PLACES * spots.len(), 6);
    for (axis, nudge) in NUDGES.into_iter().enumerate() {
        let nudged = |by: f64| places(lens, &pose.moved(&Vector6::from_fn(|i, _| if i == axis { by } else { 0.0 })));
        by_pose.set_column(axis, &((nudged(nudge)? - nudged(-nudge)?) / (2.0 * nudge)));
    }
    let mut by_lens = DMatrix::zeros(PLACES * spots.len(), count);
    for figure in 0..count {
        let nudge = if figure < 4 { NUDGE_PX } else { NUDGE };
        let nudged = |by: f64| places(&lens.nudged(figure, by), pose);
        by_lens.set_column(figure, &((nudged(nudge)? - nudged(-nudge)?) / (2.0 * nudge)));
    }
    let normal = by_pose.transpose() * &by_pose;
    let scale = normal.diagonal().map(|entry| if entry > 0.0 { entry.sqrt().recip() } else { 0.0 });
    let eigen = DMatrix::from_fn(6, 6, |i, j| scale[i] * normal[(i, j)] * scale[j]).symmetric_eigen();
    let most = eigen.eigenvalues.max();
    let inverse = eigen.eigenvalues.map(|value| if value > UNSEEN * most { value.recip() } else { 0.0 });
    let inverse = &eigen.eigenvectors * DMatrix::from_diagonal(&inverse) * eigen.eigenvectors.transpose();
    let inverse = DMatrix::from_fn(6, 6, |i, j| scale[i] * inverse[(i, j)] * scale[j]);
    let slopes = inverse * by_pose.transpose() * by_lens;
    let all = &slopes * covariance * slopes.transpose();
    let all = all.fixed_view::<6, 6>(0, 0).into_owned();
    all.iter().all(|entry| entry.is_finite()).then(|| 0.5 * (all + all.transpose()))
}

/// Outward displacement of the outlines at points along the previous ones, px.
fn moved(lens: &Intrinsics, pose: &Rigid, spots: &[&TargetSpot], before: &[Five]) -> Option<DVector<f64>> {
    let mut all = Vec::with_capacity(PLACES * spots.len());
    for (spot, before) in spots.iter().zip(before) {
        let now = outline(lens, pose, spot)?;
        for k in 0..PLACES {
            let (sin, cos) = (std::f64::consts::TAU * k as f64 / PLACES as f64).sin_cos();
            let radius = level(before, [cos, sin]).sqrt().recip();
            let at = [before[0] + radius * cos, before[1] + radius * sin];
            let slope = [
                2.0 * radius * (before[2] * cos + before[3] * sin),
                2.0 * radius * (before[3] * cos + before[4] * sin),
            ];
            all.push((1.0 - level(&now, [at[0] - now[0], at[1] - now[1]])) / slope[0].hypot(slope[1]));
        }
    }
    Some(DVector::from_vec(all))
}

/// s at an offset from an ellipse's centre.
fn level(ellipse: &Five, [x, y]: [f64; 2]) -> f64 {
    ellipse[2] * x * x + 2.0 * ellipse[3] * x * y + ellipse[4] * y * y
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::camera::Distortion;
    use nalgebra::Vector3;

    fn lens(covariance: Option<Vec<Vec<f64>>>) -> Intrinsics {
        let exact = crate::pose::joint::tests::lens(Distortion::PlumbBob, &[-0.1, 0.02, 0.0, 0.0, 0.0]);
        Intrinsics { covariance, ..exact }
    }

    fn spots(count: usize) -> Vec<TargetSpot> {
        let places = [[0.0, 80.0, 0.0], [-70.0, -40.0, 0.0], [70.0, -40.0, -40.0]];
        let spot = |(i, at): (usize, [f64; 3])| TargetSpot { name: i.to_string(), position_mm: at, radius_mm: 30.0 };
        places.into_iter().take(count).enumerate().map(spot).collect()
    }

    fn diagonal(variances: &[f64]) -> Option<Vec<Vec<f64>>> {
        Some(
            (0..variances.len())
                .map(|i| (0..variances.len()).map(|j| if i == j { variances[i] } else { 0.0 }).collect())
                .collect(),
        )
    }

    /// For any lens error within its covariance, the pose that restores the outlines is within the predicted
    /// covariance. To first order a focal length 1 % longer is a target 1 % farther away.
    #[test]
    fn a_focal_length_error_is_a_distance_error() {
        let spots = spots(3);
        let spots: Vec<&TargetSpot> = spots.iter().collect();
        let pose = Rigid::of_rodrigues(Vector3::new(0.02, -0.01, 0.1), Vector3::new(5.0, -8.0, 1500.0));
        // Both focal lengths are wrong by the same.
        let both = Some(vec![vec![36.0, 36.0, 0.0, 0.0], vec![36.0, 36.0, 0.0, 0.0], vec![0.0; 4], vec![0.0; 4]]);
        let straight = Intrinsics { model: Distortion::None, coefficients: Vec::new(), ..lens(both) };
        let added = of_lens(&straight, &pose, &spots).unwrap();
        assert!((added[(2, 2)].sqrt() / 15.0 - 1.0).abs() < 0.05, "{}", added[(2, 2)].sqrt());
        assert!(added[(0, 0)].sqrt() < 0.6 && added[(1, 1)].sqrt() < 0.6, "{added}");
        let aside = of_lens(&lens(diagonal(&[0.0, 0.0, 4.0, 0.0])), &pose, &spots).unwrap();
        assert!((aside[(0, 0)].sqrt() / 5.0 - 1.0).abs() < 0.1, "2 px are 5 mm: {}", aside[(0, 0)].sqrt());
    }

    #[test]
    fn the_spin_of_one_spot_stays_finite_and_coefficients_count() {
        let one = spots(1);
        let one: Vec<&TargetSpot> = one.iter().collect();
        let pose = Rigid::of_rodrigues(Vector3::new(0.15, 0.1, 0.0), Vector3::new(60.0, 20.0, 900.0));
        let added = of_lens(&lens(diagonal(&[9.0, 9.0, 1.0, 1.0])), &pose, &one).unwrap();
        let turns = added.fixed_view::<3, 3>(3, 3).into_owned();
        assert!(turns.trace() < 1e-3, "nothing shows the spin: {turns}");
        let mut variances = [0.0; 9];
        variances[4] = 1e-4;
        let bent = of_lens(&lens(diagonal(&variances)), &pose, &one).unwrap();
        assert!(bent[(2, 2)] > 0.0 && bent.iter().all(|entry| entry.is_finite()));
        assert_eq!(of_lens(&lens(None), &pose, &one), None);
    }
}
