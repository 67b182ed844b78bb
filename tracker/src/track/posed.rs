//! The published [`Pose`] of a fit or of predicted parameters, and the size of its target.

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

    /// The pose of a fit: from the parameters where they are a pose, else from the spots' ellipses where lens and
    /// target are given. `saturation`: pixel values from there on did not take part.
    pub fn pose(&self, attempt: &Attempt, saturation: f64, spend: Spend) -> Option<Pose> {
        let fit = attempt.fit.as_ref().filter(|_| attempt.is_good())?;
        let covariance = fit.summary.as_ref()?.covariance.as_ref();
        if let Some(geometry) = &self.geometry {
            let alternatives = attempt.rival.iter().filter_map(|rival| rival.alternative(geometry)).collect();
            let left_out = self.left_out(geometry, fit);
            let pose = geometry.published(&fit.parameters, self.compiled.last_parameters(), covariance);
            return Some(self.with_lens_uncertainty(geometry, Pose { alternatives, left_out, ..pose }));
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

    /// Names of the spots that were left out of a fit or are dark.
    fn left_out(&self, geometry: &Geometry, fit: &Fit) -> Vec<String> {
        let dark = self.dark_spots(geometry, fit);
        let spots = geometry.target.spots.iter().enumerate();
        let left_out = spots.filter(|(number, _)| fit.unused.contains(number) || dark.contains(number));
        left_out.map(|(_, spot)| spot.name.clone()).collect()
    }

    /// Numbers of the spots without significant brightness.
    pub(super) fn dark_spots(&self, geometry: &Geometry, fit: &Fit) -> Vec<usize> {
        let order = self.compiled.last_parameters();
        let shines = |spot: &usize| {
            let brightness = geometry.roles(self.model(), *spot).and_then(|roles| roles.brightness);
            let row = brightness.and_then(|brightness| order.iter().position(|&one| one == brightness));
            let (Some(row), Some(summary)) = (row, &fit.summary) else { return true };
            let variance = summary.covariance.as_ref().map_or(summary.variance_alone[row], |c| c[(row, row)]);
            fit.parameters[order[row].index()].abs() >= SIGNIFICANT * variance.sqrt()
        };
        (0..geometry.target.spots.len()).filter(|spot| !shines(spot)).collect()
    }

    /// The pose of parameters; `None` for a model that fits no pose.
    pub fn pose_of(&self, parameters: &[f64], covariance: Option<&DMatrix<f64>>) -> Option<Pose> {
        let geometry = self.geometry.as_ref()?;
        let pose = geometry.published(parameters, self.compiled.last_parameters(), covariance);
        Some(self.with_lens_uncertainty(geometry, pose))
    }

    fn with_lens_uncertainty(&self, geometry: &Geometry, pose: Pose) -> Pose {
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

    /// The factor by which a brightness changed, up or down: the largest over targets, but the least over a pose's
    /// spots, since a pose goes on while one of its spots is unchanged. `None` where unknown.
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
