//! Rotations and rigid motions: a pose's axes and origin, and small moves of them.
//!
//! `X_camera = R X_target + t`. A small move δ = (δt, δω) is in camera axes: `t ← t + δt`, `R ← exp([δω]×) R`.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3, Vector6};

/// A rotation and a translation, from the target's axes to the camera's; mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rigid {
    /// R.
    pub rotation: Matrix3<f64>,
    /// t, mm.
    pub translation: Vector3<f64>,
}

impl Rigid {
    /// A point of the target in the camera's frame.
    pub fn apply(&self, point: Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.translation
    }

    /// Moved by (δt, δω): mm, rad, camera axes.
    pub fn moved(&self, by: &Vector6<f64>) -> Rigid {
        let turn = Rotation3::new(Vector3::new(by[3], by[4], by[5]));
        Rigid {
            rotation: turn.matrix() * self.rotation,
            translation: self.translation + Vector3::new(by[0], by[1], by[2]),
        }
    }

    /// The move that leads from here to `other`.
    pub fn to(&self, other: &Rigid) -> Vector6<f64> {
        let turn = Rotation3::from_matrix_unchecked(other.rotation * self.rotation.transpose());
        // By way of the quaternion: the angle by its cosine has half the digits near 0, and none where it rounds above 1.
        let turn = UnitQuaternion::from_rotation_matrix(&turn).scaled_axis();
        let shift = other.translation - self.translation;
        Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
    }

    /// Angle between two poses' axes, rad.
    pub fn angle_to(&self, other: &Rigid) -> f64 {
        let turn = self.to(other);
        turn.fixed_rows::<3>(3).norm()
    }

    /// x, y, z, w of the rotation, w ≥ 0.
    pub fn quaternion(&self) -> [f64; 4] {
        let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(self.rotation));
        let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
        [q.i, q.j, q.k, q.w].map(|c| sign * c)
    }

    /// From a position and x, y, z, w.
    pub fn of_quaternion(position: [f64; 3], [x, y, z, w]: [f64; 4]) -> Rigid {
        let q = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
        Rigid { rotation: q.to_rotation_matrix().into_inner(), translation: Vector3::from(position) }
    }

    /// Modified Rodrigues parameters of the rotation, of length ≤ 1: the axis times tan(angle / 4), which is the
    /// quaternion's vector over 1 + w.
    pub fn rodrigues(&self) -> Vector3<f64> {
        let [x, y, z, w] = self.quaternion();
        Vector3::new(x, y, z) / (1.0 + w)
    }

    /// The rotation of modified Rodrigues parameters: `I + (8 [m]² + 4 (1 − m²) [m]) / (1 + m²)²`, [m] the cross product.
    pub fn of_rodrigues(m: Vector3<f64>, translation: Vector3<f64>) -> Rigid {
        let (cross, square) = (m.cross_matrix(), m.norm_squared());
        let turn = (cross * cross * 8.0 + cross * (4.0 * (1.0 - square))) / (1.0 + square).powi(2);
        Rigid { rotation: Matrix3::identity() + turn, translation }
    }
}

/// The rotation that turns the z axis to `normal` about an axis across both: without spin. About x where they are opposite.
pub(super) fn upright(normal: &Vector3<f64>) -> Matrix3<f64> {
    let turn = Rotation3::rotation_between(&Vector3::z(), normal);
    turn.map_or_else(|| Rigid::of_rodrigues(Vector3::x(), Vector3::zeros()).rotation, Rotation3::into_inner)
}

/// The rigid motion that brings `from` nearest to `to`, by least squares. Kabsch 1976.
pub fn kabsch(from: &[Vector3<f64>], to: &[Vector3<f64>]) -> Option<Rigid> {
    if from.len() != to.len() || from.len() < 3 {
        return None;
    }
    let mean = |points: &[Vector3<f64>]| points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let (middle_from, middle_to) = (mean(from), mean(to));
    let spread: Matrix3<f64> = from.iter().zip(to).map(|(a, b)| (a - middle_from) * (b - middle_to).transpose()).sum();
    let svd = spread.svd(true, true);
    let (u, v) = (svd.u?, svd.v_t?.transpose());
    // A reflection is turned into the nearest rotation along the direction of least spread.
    let mut signs = Vector3::repeat(1.0);
    signs[svd.singular_values.imin()] = (v * u.transpose()).determinant().signum();
    let rotation = v * Matrix3::from_diagonal(&signs) * u.transpose();
    Some(Rigid { rotation, translation: middle_to - rotation * middle_from })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn poses() -> impl Iterator<Item = Rigid> {
        let axes = [
            [0.3, -0.5, 1.2],
            [0.0, 0.0, 0.0],
            [3.1, 0.1, 0.2],
            [-2.0, 1.0, -1.5],
            [0.0, 0.0, std::f64::consts::PI - 1e-9],
        ];
        axes.into_iter().map(|axis| Rigid {
            rotation: Rotation3::new(Vector3::from(axis)).into_inner(),
            translation: Vector3::new(10.0, -20.0, 900.0),
        })
    }

    #[test]
    fn rotations_go_to_quaternions_and_rodrigues_parameters_and_back() {
        for pose in poses() {
            let q = Rigid::of_quaternion(pose.translation.into(), pose.quaternion());
            assert!((q.rotation - pose.rotation).norm() < 1e-9 && q.quaternion()[3] >= 0.0);
            let m = pose.rodrigues();
            assert!(m.norm() <= 1.0 + 1e-12);
            let back = Rigid::of_rodrigues(m, pose.translation);
            assert!((back.rotation - pose.rotation).norm() < 1e-9, "{:?}", pose.rotation);
            // The same rotation has a second triple.
            if m.norm() > 0.1 {
                let shadow = Rigid::of_rodrigues(-m / m.norm_squared(), pose.translation);
                assert!((shadow.rotation - pose.rotation).norm() < 1e-8);
            }
        }
    }

    #[test]
    fn to_inverts_moved() {
        let by = Vector6::new(1.0, 2.0, -3.0, 0.01, -0.02, 0.03);
        for pose in poses() {
            assert!((pose.to(&pose.moved(&by)) - by).norm() < 1e-9);
            assert!((pose.angle_to(&pose.moved(&by)) - 0.0014_f64.sqrt()).abs() < 1e-9);
        }
    }

    #[test]
    fn kabsch_finds_the_motion_of_flat_points() {
        let from = [[0.0, 80.0, 0.0], [-70.0, -40.0, 0.0], [70.0, -40.0, 0.0]].map(Vector3::from);
        for pose in poses() {
            let to = from.map(|point| pose.apply(point));
            let found = kabsch(&from, &to).unwrap();
            assert!((found.rotation - pose.rotation).norm() < 1e-9);
            assert!((found.translation - pose.translation).norm() < 1e-8);
        }
        assert!(kabsch(&from[..2], &from[..2]).is_none());
    }
}
