//! The pose from fitted ellipses, for any model whose named roles are spots of the target.

use isophote_symbolic::{Model, ParameterId};
use nalgebra::{DMatrix, Matrix6};

use super::joint::{Joint, Minimum, SpotSeen};
use super::profile::Profile;
use super::seen::Five;
use super::target::{Target, TargetSpot};
use super::{Alternative, DELTA_CHI_SQUARE_MAX, Pose};
use crate::budget::Spend;
use crate::camera::Intrinsics;
use crate::scaled;

/// Fitted parameters of a model.
pub(crate) struct Fitted<'a> {
    pub parameters: &'a [f64],
    pub constants: &'a [f64],
    /// Free parameters of the last stage.
    pub order: &'a [ParameterId],
    /// Covariance of the free parameters.
    pub covariance: &'a DMatrix<f64>,
    /// Pixels at or above this value are excluded; infinite unless `observed` is a plane, or one of each.
    pub saturation: f64,
}

/// The pose of the spots common to model and target; `None` when there is none, an ellipse is not free, or `spend`
/// stops the search.
pub(crate) fn of_ellipses(
    model: &Model,
    lens: &Intrinsics,
    target: &Target,
    fitted: &Fitted,
    spend: Spend,
) -> Option<Pose> {
    let (mut spots, mut columns) = (Vec::new(), Vec::new());
    for roles in model.roles() {
        let named = target.spots.iter().find(|spot| Some(&spot.name) == roles.name.as_ref());
        let only: Option<&TargetSpot> = match (&roles.name, &target.spots[..], model.roles()) {
            (None, [spot], [_]) => Some(spot),
            _ => None,
        };
        let (Some(spot), &[x, y], &[a1, a2, a3]) = (named.or(only), &roles.centre[..], &roles.shape[..]) else {
            continue;
        };
        let ids = [x, y, a1, a2, a3];
        let ellipse = Five::from_iterator(ids.iter().map(|id| fitted.parameters[id.index()]));
        let profile = Profile::of(model, roles, fitted.parameters, fitted.constants, fitted.saturation);
        spots.push(SpotSeen { spot, ellipse, profile });
        for id in ids {
            columns.push(fitted.order.iter().position(|free| *free == id)?);
        }
    }
    let n = columns.len();
    let covariance = DMatrix::from_fn(n, n, |i, j| fitted.covariance[(columns[i], columns[j])]);
    published(&Joint::new(lens, &spots, &covariance)?.minima(spend).ok()?, spots.len())
}

/// The best minimum, with the others that are as good as alternatives.
fn published(minima: &[Minimum], spots: usize) -> Option<Pose> {
    let (best, others) = minima.split_first()?;
    let near = others.iter().map(|other| Alternative {
        position_mm: other.pose.translation.into(),
        orientation_xyzw: other.pose.quaternion(),
        delta_chi_square: other.chi_square - best.chi_square,
    });
    let information = DMatrix::from_column_slice(6, 6, best.information.as_slice());
    let covariance = scaled::inverse(&information);
    Some(Pose {
        position_mm: best.pose.translation.into(),
        orientation_xyzw: best.pose.quaternion(),
        covariance: covariance.map(|c| row_major(&Matrix6::from_column_slice(c.as_slice()))),
        degrees_of_freedom: if spots == 1 { 5 } else { 6 },
        chi_square: Some(best.chi_square),
        left_out: Vec::new(),
        alternatives: near.filter(|other| other.delta_chi_square < DELTA_CHI_SQUARE_MAX).collect(),
    })
}

/// 36 numbers, row by row.
pub(crate) fn row_major(matrix: &Matrix6<f64>) -> Vec<f64> {
    matrix.row_iter().flat_map(|row| row.iter().copied().collect::<Vec<f64>>()).collect()
}
