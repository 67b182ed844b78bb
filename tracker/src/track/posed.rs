//! Poses on a track: what of a fit is published as a pose, and how large its target is.
//!
//! What comes in: fits, or predicted parameters. What goes out: a [`Pose`]. It never knows where a target was before.

use isophote_symbolic::Roles;
use nalgebra::DMatrix;

use super::solver::{Attempt, Solver};
use crate::budget::Spend;
use crate::pose::{Fitted, Pose, of_ellipses};

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
            let pose = self.pose_of(&fit.parameters, covariance)?;
            return Some(Pose { alternatives, ..pose });
        }
        let (lens, target) = (self.options.camera.intrinsics.as_ref()?, self.options.target.as_ref()?);
        let fitted = Fitted {
            parameters: &fit.parameters,
            constants: &self.constants,
            order: self.compiled.last_parameters(),
            covariance: covariance?,
            saturation,
        };
        of_ellipses(self.model(), lens, target, &fitted, spend)
    }

    /// The pose that parameters are; `None` where they are none.
    pub fn pose_of(&self, parameters: &[f64], covariance: Option<&DMatrix<f64>>) -> Option<Pose> {
        let geometry = self.geometry.as_ref()?;
        Some(geometry.published(parameters, self.compiled.last_parameters(), covariance))
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
