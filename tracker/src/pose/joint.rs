//! Joint refinement: one pose for the ellipses of all spots, weighted by their covariance.
//!
//! From 5k numbers for k spots (centre and shape of each ellipse) with their covariance it finds every local minimum of
//! `χ² = eᵀ C⁻¹ e`, e = measured − seen, the best first. Seeds are both circles of each spot with the spin that suits
//! the other spots' centres, and the P3P poses of every three spots; each is refined by least squares over six small
//! moves.

use nalgebra::{DMatrix, DVector, Matrix6, MatrixXx6, Vector3, Vector6};

use super::conic::{Circle, circles_of_ellipse};
use super::geometry::normalised_ellipse;
use super::p3p::p3p;
use super::profile::Profile;
use super::rigid::{Rigid, upright};
use super::seen::{Five, outline, seen};
use super::target::TargetSpot;
use crate::budget::{Spend, Stop};
use crate::camera::Intrinsics;
use crate::least_squares::{NormalEquations, Solution, least_squares};
use crate::scaled;

/// A spot and its fitted ellipse.
#[derive(Clone, Debug)]
pub(crate) struct SpotSeen<'a> {
    pub spot: &'a TargetSpot,
    /// x, y, a1, a2, a3; px, px⁻².
    pub ellipse: Five,
    /// Without a profile the ellipse is that of the contour s = 1.
    pub profile: Option<Profile>,
}

/// Cost of a search step per spot, in pixels of a pass that take as long.
const STEP_COST: u64 = 8_000;

/// A local minimum.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Minimum {
    pub pose: Rigid,
    pub chi_square: f64,
    /// Inverse covariance of (δt, δω).
    pub information: Matrix6<f64>,
}

/// Ellipses to fit with one pose.
pub(crate) struct Joint<'a> {
    lens: &'a Intrinsics,
    spots: &'a [SpotSeen<'a>],
    /// C⁻¹, 5k × 5k.
    weight: DMatrix<f64>,
}

/// Searches converge when the next step would lower χ² by less: a thousandth of a standard deviation.
const ENOUGH: f64 = 1e-6;
/// Number of best rough minima that are refined to the end.
const FOLLOWED: usize = 4;
/// Step of numerical derivatives: mm per mm of distance, and rad.
const NUDGE: f64 = 1e-6;
/// Distance within which two minima are the same, in rad and as a share of the distance.
const SAME: f64 = 2e-3;
/// Variance of an unknown angle.
const ANY_ANGLE: f64 = std::f64::consts::PI * std::f64::consts::PI / 3.0;

impl<'a> Joint<'a> {
    /// `covariance`: 5k × 5k, in the order of the spots. `None` when its size is wrong, or it is not positive definite.
    pub fn new(lens: &'a Intrinsics, spots: &'a [SpotSeen<'a>], covariance: &DMatrix<f64>) -> Option<Joint<'a>> {
        if covariance.nrows() != 5 * spots.len() || spots.is_empty() {
            return None;
        }
        Some(Joint { lens, spots, weight: scaled::inverse(covariance)? })
    }

    /// Every local minimum, the best first.
    ///
    /// # Errors
    /// When `spend` ends the search.
    pub fn minima(&self, spend: Spend) -> Result<Vec<Minimum>, Stop> {
        let mut rough = self.all_refined(&self.seeds(), outline_of, spend)?;
        rough.truncate(FOLLOWED);
        let rough: Vec<Rigid> = rough.into_iter().map(|minimum| minimum.pose).collect();
        let mut fine = self.all_refined(&rough, seen_of, spend)?;
        fine.retain(|minimum| self.is_facing(&minimum.pose));
        Ok(fine)
    }

    /// The distinct minima reached from the seeds, the best first.
    fn all_refined(&self, seeds: &[Rigid], predict: Predict, spend: Spend) -> Result<Vec<Minimum>, Stop> {
        let mut minima = Vec::new();
        for seed in seeds {
            minima.extend(self.refined(seed, predict, spend)?);
        }
        distinct(&mut minima);
        Ok(minima)
    }

    /// Rejects poses with spots behind the camera; one or two spots, whose visible side is unknown, are seen from −z.
    fn is_facing(&self, pose: &Rigid) -> bool {
        let towards = |spot: &SpotSeen| pose.rotation.column(2).dot(&pose.apply(spot.spot.centre())) > 0.0;
        self.spots.len() > 2 || self.spots.iter().all(towards)
    }

    fn seeds(&self) -> Vec<Rigid> {
        let mut seeds = Vec::new();
        let rays: Vec<Vector3<f64>> = self
            .spots
            .iter()
            .filter_map(|seen| self.lens.ray([seen.ellipse[0], seen.ellipse[1]]).map(Vector3::from))
            .collect();
        if rays.len() < self.spots.len() {
            return seeds;
        }
        for (index, seen) in self.spots.iter().enumerate() {
            let circles = normalised_ellipse(self.lens, seen.ellipse.into())
                .and_then(|e| circles_of_ellipse(&e, seen.spot.radius_mm));
            for circle in circles.into_iter().flatten() {
                seeds.push(self.spun(index, &circle, &rays));
            }
        }
        for k in 2..self.spots.len() {
            for j in 1..k {
                for i in 0..j {
                    let three = [i, j, k];
                    seeds.extend(p3p(&three.map(|n| self.spots[n].spot.centre()), &three.map(|n| rays[n])));
                }
            }
        }
        seeds
    }

    /// The pose of a circle, spun about its normal so that the other spots come near their rays; without others, the
    /// one with the least rotation.
    fn spun(&self, index: usize, circle: &Circle, rays: &[Vector3<f64>]) -> Rigid {
        let spot = self.spots[index].spot.centre();
        let upright = upright(&circle.normal);
        let (e1, e2) = (upright.column(0), upright.column(1));
        let (mut along, mut across) = (0.0, 0.0);
        for (other, ray) in
            self.spots.iter().zip(rays).filter(|(other, _)| other.spot.name != self.spots[index].spot.name)
        {
            let from = other.spot.centre() - spot;
            let depth = (circle.normal.dot(&circle.centre) + from.z) / circle.normal.dot(ray);
            let seen = ray * depth - circle.centre;
            let (u, v) = (e1.dot(&seen), e2.dot(&seen));
            along += from.x * u + from.y * v;
            across += from.x * v - from.y * u;
        }
        let spin = if along == 0.0 && across == 0.0 { 0.0 } else { across.atan2(along) };
        let rotation = upright * nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), spin).into_inner();
        Rigid { rotation, translation: circle.centre - rotation * spot }
    }

    /// The minimum reached from a pose; `None` when there is none.
    fn refined(&self, seed: &Rigid, predict: Predict, spend: Spend) -> Result<Option<Minimum>, Stop> {
        let mut stop = None;
        let equations = |pose: &Rigid| {
            stop = stop.or_else(|| spend(STEP_COST * self.spots.len() as u64).err());
            stop.map_or_else(|| self.equations(pose, predict), |_| None)
        };
        let found = least_squares(*seed, ENOUGH, equations, Rigid::moved).filter(|found| found.is_converged);
        stop.map_or(Ok(()), Err)?;
        Ok(found.map(|Solution { point, equations, .. }| Minimum {
            pose: point,
            chi_square: equations.cost,
            information: equations.information,
        }))
    }

    /// Uses the derivatives of the outline: the offset to the seen ellipse changes little.
    fn equations(&self, pose: &Rigid, predict: Predict) -> Option<NormalEquations<6>> {
        let (rest, slopes) = (self.rest(pose, predict)?, self.slopes(pose)?);
        let weighed = &self.weight * &slopes;
        let mut information = slopes.transpose() * &weighed;
        if self.spots.len() == 1 {
            let normal = pose.rotation.column(2).into_owned();
            let mut spin = information.fixed_view_mut::<3, 3>(3, 3);
            spin += normal * normal.transpose() / ANY_ANGLE;
        }
        let cost = rest.dot(&(&self.weight * &rest));
        Some(NormalEquations { cost, right: weighed.transpose() * &rest, information })
    }

    /// measured − predicted.
    fn rest(&self, pose: &Rigid, predict: Predict) -> Option<DVector<f64>> {
        let mut rest = DVector::zeros(5 * self.spots.len());
        for (index, seen) in self.spots.iter().enumerate() {
            rest.fixed_rows_mut::<5>(5 * index).copy_from(&(seen.ellipse - predict(self.lens, pose, seen)?));
        }
        Some(rest)
    }

    fn slopes(&self, pose: &Rigid) -> Option<MatrixXx6<f64>> {
        let mut slopes = MatrixXx6::zeros(5 * self.spots.len());
        for k in 0..6 {
            let nudge = if k < 3 { NUDGE * pose.translation.norm() } else { NUDGE };
            let by = |sign: f64| {
                let mut by = Vector6::zeros();
                by[k] = sign * nudge;
                pose.moved(&by)
            };
            let (ahead, back) = (by(1.0), by(-1.0));
            for (index, seen) in self.spots.iter().enumerate() {
                let change = outline(self.lens, &ahead, seen.spot)? - outline(self.lens, &back, seen.spot)?;
                slopes.fixed_view_mut::<5, 1>(5 * index, k).copy_from(&(change / (2.0 * nudge)));
            }
        }
        Some(slopes)
    }
}

type Predict = fn(&Intrinsics, &Rigid, &SpotSeen) -> Option<Five>;

fn outline_of(lens: &Intrinsics, pose: &Rigid, spot: &SpotSeen) -> Option<Five> {
    outline(lens, pose, spot.spot)
}

fn seen_of(lens: &Intrinsics, pose: &Rigid, spot: &SpotSeen) -> Option<Five> {
    match &spot.profile {
        Some(profile) => seen(lens, pose, spot.spot, profile),
        None => outline(lens, pose, spot.spot),
    }
}

/// Sorts by χ² and removes duplicates.
fn distinct(minima: &mut Vec<Minimum>) {
    minima.sort_by(|a, b| a.chi_square.total_cmp(&b.chi_square));
    let mut kept: Vec<Minimum> = Vec::new();
    for minimum in minima.iter() {
        let same = |other: &Minimum| {
            let apart = (other.pose.translation - minimum.pose.translation).norm();
            apart < SAME * minimum.pose.translation.norm() && other.pose.angle_to(&minimum.pose) < SAME
        };
        if !kept.iter().any(same) {
            kept.push(*minimum);
        }
    }
    *minima = kept;
}

#[cfg(test)]
#[path = "joint_tests.rs"]
pub(super) mod tests;
