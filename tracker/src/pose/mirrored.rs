//! Mirrored poses: a flat target looks nearly alike from two sides.
//!
//! Finds the poses with the same image under weak perspective.
//!
//! Under parallel projection along l, `(I − 2 l lᵀ) R diag(1, 1, −1)` moves points of the target's plane along l only,
//! so the images are identical. Under perspective they differ, the more the nearer and the more tilted the target is;
//! how much of the difference a small move can cancel depends on the point that is held fixed.

use nalgebra::Vector3;

use super::direct::Geometry;
use super::rigid::{Rigid, upright};
use super::target::TargetSpot;

/// Largest number of spots about which a pose is mirrored.
const SPOTS: usize = 3;

impl Geometry {
    /// The mirrored poses as parameters: about the spots' mean, then, with several spots, about each of them.
    pub fn mirrored(&self, parameters: &[f64]) -> Vec<Vec<f64>> {
        let pose = self.pose(parameters);
        let spots: Vec<Vector3<f64>> = self.target.spots.iter().map(TargetSpot::centre).collect();
        let middle = spots.iter().sum::<Vector3<f64>>() / spots.len().max(1) as f64;
        let each = spots.iter().filter(|_| spots.len() > 1).take(SPOTS);
        let put = |about: &Vector3<f64>| {
            let mut other = parameters.to_vec();
            self.put(&mirrored(&pose, *about), &mut other);
            other
        };
        std::iter::once(&middle).chain(each).map(put).collect()
    }

    /// The front-facing pose with the same image, when a single round spot's pose shows its back.
    pub fn facing(&self, parameters: &[f64]) -> Option<Vec<f64>> {
        let pose = self.pose(parameters);
        let about = self.target.spots.first().filter(|_| !self.has_spin())?.centre();
        let (at, normal) = (pose.apply(about), pose.rotation.column(2).into_owned());
        (normal.dot(&at) < 0.0).then(|| {
            let rotation = upright(&-normal);
            let mut faced = parameters.to_vec();
            self.put(&Rigid { rotation, translation: at - rotation * about }, &mut faced);
            faced
        })
    }

    /// The angle between two poses, rad; between the normals of a single round spot.
    pub fn apart(&self, a: &[f64], b: &[f64]) -> f64 {
        let (a, b) = (self.pose(a), self.pose(b));
        match self.has_spin() {
            true => a.angle_to(&b),
            false => a.rotation.column(2).angle(&b.rotation.column(2)),
        }
    }

    /// The angle between a pose and its first mirrored one, rad.
    pub fn to_mirrored(&self, parameters: &[f64]) -> f64 {
        self.mirrored(parameters).first().map_or(0.0, |other| self.apart(parameters, other))
    }
}

/// Reflects along the line of sight to a point of the target, which stays fixed.
fn mirrored(pose: &Rigid, about: Vector3<f64>) -> Rigid {
    let at = pose.apply(about);
    let detection = at.try_normalize(0.0).unwrap_or_else(Vector3::z);
    let mut rotation = pose.rotation - detection * (detection.transpose() * pose.rotation) * 2.0;
    rotation.column_mut(2).neg_mut();
    Rigid { rotation, translation: at - rotation * about }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Vector6};

    use super::*;
    use crate::pose::seen::outline;
    use isophote_symbolic::Model;

    fn geometry(text: &str) -> (Geometry, Vec<f64>) {
        let model = Model::from_toml(text).unwrap_or_else(|_| panic!("a shipped model"));
        let constants: Vec<f64> = model.constants().iter().map(|constant| constant.value).collect();
        let parameters = vec![0.0; model.parameters().len()];
        (Geometry::of(&model, &constants).unwrap_or_else(|| panic!("a pose")), parameters)
    }

    fn pose(turn: [f64; 3], at: [f64; 3]) -> Rigid {
        Rigid { rotation: Rotation3::new(Vector3::from(turn)).into_inner(), translation: Vector3::from(at) }
    }

    /// From far away the outlines of all spots are where they were, and mirrored twice the pose is itself.
    #[test]
    fn from_far_away_a_mirrored_pose_has_the_same_picture() {
        let (geometry, mut parameters) = geometry(include_str!("../../../models/three-spots-pose.toml"));
        let truth = pose([0.4, -0.5, 0.3], [2000.0, -1000.0, 30_000.0]);
        geometry.put(&truth, &mut parameters);
        let all = geometry.mirrored(&parameters);
        assert_eq!(all.len(), 4);
        for other in &all {
            assert!(geometry.apart(&parameters, other) > 0.5);
            for spot in &geometry.target.spots {
                let seen = |pose: &Rigid| outline(&geometry.lens, pose, spot).unwrap_or_else(|| panic!("in front"));
                let (was, is) = (seen(&truth), seen(&geometry.pose(other)));
                assert!((was - is).fixed_rows::<2>(0).norm() < 0.02, "{was} {is}");
                assert!((was - is).fixed_rows::<3>(2).norm() < 0.02 * was.fixed_rows::<3>(2).norm());
            }
        }
        let back = &geometry.mirrored(&all[0])[0];
        assert!(geometry.apart(&parameters, back) < 1e-9);
        assert!((geometry.to_mirrored(&parameters) - geometry.apart(&parameters, &all[0])).abs() < 1e-12);
    }

    /// The spin of one spot shows nowhere: only its normal is mirrored, and what faces the viewer is its own mirror image.
    #[test]
    fn one_spot_is_mirrored_by_its_normal() {
        let (geometry, mut parameters) = geometry(include_str!("../../../models/spot-pose.toml"));
        let truth = pose([0.5, -0.3, 0.0], [30.0, 20.0, 800.0]);
        geometry.put(&truth, &mut parameters);
        let [other] = &geometry.mirrored(&parameters)[..] else { panic!("one spot") };
        let detection = truth.translation.normalize();
        let normals = [&parameters, other].map(|one| geometry.pose(one).rotation.column(2).into_owned());
        assert!((normals[0] + normals[1] - detection * 2.0 * detection.dot(&normals[0])).norm() < 1e-9);
        assert!((geometry.pose(other).translation - truth.translation).norm() < 1e-9);
        assert_eq!(geometry.facing(&parameters), None);
        let mut behind = parameters.clone();
        let turned = truth.rotation * Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI).into_inner();
        geometry.put(&Rigid { rotation: turned, ..truth }, &mut behind);
        let faced = geometry.facing(&behind).unwrap_or_else(|| panic!("seen from behind"));
        assert!(geometry.apart(&faced, &parameters) < 1e-6, "{faced:?}");
        let facing = pose([0.0; 3], [0.0, 0.0, 800.0]).moved(&Vector6::zeros());
        geometry.put(&facing, &mut parameters);
        assert!(geometry.to_mirrored(&parameters) < 1e-9);
    }
}
