//! Poses on a track: what of a fit is published as a pose, and how large its target is.
//!
//! What comes in: fits, or predicted parameters. What goes out: a [`Pose`]. It never knows where a target was before.

use isophote_symbolic::Roles;
use nalgebra::DMatrix;

use super::faint::SIGNIFICANT;
use super::solver::{Attempt, Solver};
use crate::budget::Spend;
use crate::pose::{Fitted, Geometry, Pose, of_ellipses, with_lens};
use crate::solve::fit::Fit;

impl Solver {
    /// True when the model's parameters are a pose.
    pub fn fits_pose(&self) -> bool {
        self.model().roles().iter().any(|roles| !roles.position.is_empty())
    }

    /// From the parameters where they are a pose, else from the spots' ellipses where lens and target are given.
    /// `saturation`: pixel values from there on did not take part.
    pub fn pose(&self, attempt: &Attempt, saturation: f64, spend: Spend) -> Option<Pose> {
        let fit = attempt.fit.as_ref().filter(|_| attempt.is_good())?;
        let covariance = fit.worth.as_ref()?.covariance.as_ref();
        if let Some(geometry) = &self.geometry {
            let alternatives = attempt.rival.iter().filter_map(|rival| rival.alternative(geometry)).collect();
            let left_out = self.left_out(geometry, fit);
            let pose = geometry.published(&fit.parameters, self.compiled.last_parameters(), covariance);
            return Some(self.no_surer_than_its_lens(geometry, Pose { alternatives, left_out, ..pose }));
        }
        let (lens, target) = (self.options.camera.intrinsics.as_ref()?, self.options.target.as_ref()?);
        let fitted = Fitted {
            parameters: &fit.parameters,
            constants: &self.constants,
            order: self.compiled.last_parameters(),
            covariance: covariance?,
            saturation,
        };
        Some(with_lens(of_ellipses(self.model(), lens, target, &fitted, spend)?, lens, target))
    }

    /// Spots that were left out of a fit, or that do not shine.
    fn left_out(&self, geometry: &Geometry, fit: &Fit) -> Vec<String> {
        let dark = self.dark_spots(geometry, fit);
        let spots = geometry.target.spots.iter().enumerate();
        let left_out = spots.filter(|(number, _)| fit.unused.contains(number) || dark.contains(number));
        left_out.map(|(_, spot)| spot.name.clone()).collect()
    }

    /// Spots that do not shine, by their numbers.
    pub(super) fn dark_spots(&self, geometry: &Geometry, fit: &Fit) -> Vec<usize> {
        let order = self.compiled.last_parameters();
        let shines = |spot: &usize| {
            let brightness = geometry.roles(self.model(), *spot).and_then(|roles| roles.brightness);
            let row = brightness.and_then(|brightness| order.iter().position(|&one| one == brightness));
            let (Some(row), Some(worth)) = (row, &fit.worth) else { return true };
            let variance = worth.covariance.as_ref().map_or(worth.variance_alone[row], |c| c[(row, row)]);
            fit.parameters[order[row].index()].abs() >= SIGNIFICANT * variance.sqrt()
        };
        (0..geometry.target.spots.len()).filter(|spot| !shines(spot)).collect()
    }

    /// The pose that parameters are; `None` where they are none.
    pub fn pose_of(&self, parameters: &[f64], covariance: Option<&DMatrix<f64>>) -> Option<Pose> {
        let geometry = self.geometry.as_ref()?;
        let pose = geometry.published(parameters, self.compiled.last_parameters(), covariance);
        Some(self.no_surer_than_its_lens(geometry, pose))
    }

    fn no_surer_than_its_lens(&self, geometry: &Geometry, pose: Pose) -> Pose {
        match &self.options.camera.intrinsics {
            Some(lens) => with_lens(pose, lens, &geometry.target),
            None => pose,
        }
    }

    /// Half the size of a pose's target, mm; 0 where there is none.
    pub fn target_size_mm(&self) -> f64 {
        let spots = self.geometry.iter().flat_map(|geometry| &geometry.target.spots);
        spots.map(|spot| spot.centre().norm() + spot.radius_mm).fold(0.0, f64::max)
    }

    /// By which factor a brightness changed, up or down: the largest of all targets, of a pose's spots the least, since a
    /// pose goes on while one of its spots is as it was. `None` where unknown.
    pub fn brightness_change(&self, last: &[f64], parameters: &[f64]) -> Option<f64> {
        let ratio = |roles: &Roles| {
            let index = roles.brightness?.index();
            let (old, new) = (last.get(index)?.abs(), parameters[index].abs());
            Some((new / old).max(old / new))
        };
        let ratios = self.model().roles().iter().filter_map(ratio);
        ratios.reduce(if self.fits_pose() { f64::min } else { f64::max })
    }
}
