//! Outlines `dᵀAd = 1` of targets: matrices, sizes, and the distance between two outlines.

use isophote_symbolic::{Estimator, Model, ParameterId, Roles, Start};
use nalgebra::{DMatrix, Matrix4, Vector4};
use smallvec::SmallVec;

/// Distance of synthetic targets, px: farther than any domain reaches.
const APART_PX: f64 = 10_000.0;
/// Semi-axis of a synthetic target, px. Arbitrary: formulas scale with it.
const MADE_UP_PX: f64 = 20.0;

/// Parameters of a target of that size at the origin, the others far away.
pub(crate) fn made_up(model: &Model, semi_axis: f64) -> Vec<f64> {
    let start = |start: &Start| match start {
        Start::Number(number) => *number,
        Start::Estimator(Estimator::Size(_)) => semi_axis,
        Start::Estimator(Estimator::Extent(row, column)) if row == column => semi_axis.powi(-2),
        Start::Estimator(Estimator::Extent(..)) => 0.0,
        Start::Estimator(_) => 100.0,
    };
    let mut parameters: Vec<f64> = model.parameters().iter().map(|parameter| start(&parameter.start)).collect();
    let n = model.coordinates().len();
    for (number, roles) in model.roles().iter().enumerate() {
        for parameter in &roles.centre {
            parameters[parameter.index()] = APART_PX * number as f64;
        }
        let mut entries = roles.shape.iter();
        for (row, column) in (0..n).flat_map(|row| (row..n).map(move |column| (row, column))) {
            if let Some(parameter) = entries.next() {
                parameters[parameter.index()] = if row == column { semi_axis.powi(-2) } else { 0.0 };
            }
        }
    }
    parameters
}

/// A point just outside an outline, in semi-axes: beyond the rounding of the formula, and short of the next round
/// number of a domain.
const BEYOND: f64 = 1.05;

/// Whether the document defines a domain.
pub(crate) fn has_domain(model: &Model) -> bool {
    model.document().pointer("/model/domain").is_some()
}

/// Whether a target's domain contains its centre, and no point beyond its outline.
pub(crate) fn ends_at_outline(model: &Model) -> bool {
    let constants: Vec<f64> = model.constants().iter().map(|constant| constant.value).collect();
    let parameters = made_up(model, MADE_UP_PX);
    let Some(roles) = model.roles().first().filter(|roles| !roles.shape.is_empty()) else { return false };
    let mut place: Vec<f64> = roles.centre.iter().map(|id| parameters[id.index()]).collect();
    let holds_centre = model.domain_holds(&place, &parameters, &constants);
    let Some(first) = place.first_mut() else { return false };
    *first += BEYOND * MADE_UP_PX;
    holds_centre && !model.domain_holds(&place, &parameters, &constants)
}

/// A of one target; `None` without the role `shape`.
pub(crate) fn shape(roles: &Roles, dimensions: usize, parameters: &[f64]) -> Option<DMatrix<f64>> {
    let mut a = DMatrix::zeros(dimensions, dimensions);
    set_shape(roles, dimensions, parameters, |place, entry| a[place] = entry)?;
    Some(a)
}

/// One number per coordinate.
pub(crate) type Extents = SmallVec<[f64; 4]>;

/// Calls with each entry of A and its row and column; `None` without the role `shape`.
fn set_shape(
    roles: &Roles,
    dimensions: usize,
    parameters: &[f64],
    mut set: impl FnMut((usize, usize), f64),
) -> Option<()> {
    let mut upper = roles.shape.iter().map(|parameter| parameters[parameter.index()]);
    for row in 0..dimensions {
        for column in row..dimensions {
            let entry = upper.next()?;
            set((row, column), entry);
            set((column, row), entry);
        }
    }
    Some(())
}

/// A⁻¹, padded with the identity, and det A; `None` when A is not positive definite. Called many times a frame: on the
/// stack, closed form in two dimensions.
pub(crate) fn inverse_shape(roles: &Roles, dimensions: usize, parameters: &[f64]) -> Option<(Matrix4<f64>, f64)> {
    let mut whole = Matrix4::identity();
    set_shape(roles, dimensions, parameters, |place, entry| whole[place] = entry)?;
    if dimensions > 2 {
        let factors = whole.cholesky()?;
        return Some((factors.inverse(), factors.determinant()));
    }
    let (xx, xy, yy) = (whole[(0, 0)], whole[(0, 1)], whole[(1, 1)]);
    let determinant = xx * yy - xy * xy;
    (whole[(0, 0)], whole[(1, 1)]) = (yy / determinant, xx / determinant);
    (whole[(0, 1)], whole[(1, 0)]) = (-xy / determinant, -xy / determinant);
    (xx > 0.0 && determinant > 0.0).then_some((whole, determinant))
}

/// Half the outline's width along each coordinate, `√(A⁻¹)_ii`; `None` when A is not positive definite.
pub(crate) fn half_widths(
    roles: &Roles,
    dimensions: usize,
    parameters: &[f64],
) -> Option<impl Iterator<Item = f64> + use<>> {
    let (inverse, _) = inverse_shape(roles, dimensions, parameters)?;
    Some((0..dimensions).map(move |axis| inverse[(axis, axis)].sqrt()))
}

/// The least eigenvalue of A, which belongs to the longest semi-axis, 1/√λ; `None` without the role `shape`.
pub(crate) fn least_bend(roles: &Roles, dimensions: usize, parameters: &[f64]) -> Option<f64> {
    if dimensions != 2 {
        return Some(shape(roles, dimensions, parameters)?.symmetric_eigenvalues().min());
    }
    let [xx, xy, yy] = roles.shape[..] else { return None };
    let [xx, xy, yy] = [xx, xy, yy].map(|entry| parameters[entry.index()]);
    Some(0.5 * (xx + yy) - (0.5 * (xx - yy)).hypot(xy))
}

/// Parameters with the start estimator `size`.
pub(crate) fn size_parameters(model: &Model) -> impl Iterator<Item = ParameterId> + Clone {
    let is_size =
        |id: &ParameterId| matches!(model.parameters()[id.index()].start, Start::Estimator(Estimator::Size(_)));
    (0..model.parameters().len() as u32).map(ParameterId).filter(is_size)
}

/// Absolute values of the size parameters, for models with one target.
pub(crate) fn sizes(model: &Model, parameters: &[f64]) -> Extents {
    let known = size_parameters(model).filter(|_| model.roles().len() == 1);
    known.map(|id| parameters[id.index()].abs()).collect()
}

/// Displacement and growth of targets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Moved {
    /// Displacement of the centre, in semi-axes of the outline.
    pub by: f64,
    /// Ratio of the outline's mean size, new over old.
    pub grown: f64,
}

impl Moved {
    /// The share of an outline's pixels that change, in a plane: an ellipse that moves by d semi-axes leaves 2 d/π of its area.
    pub fn changed(self) -> f64 {
        2.0 * self.by / std::f64::consts::PI + (self.grown * self.grown - 1.0).abs()
    }
}

/// The largest displacement and growth of any target, computed on the stack in each followed frame; `None` for a model
/// whose targets have neither an outline nor sizes.
pub(crate) fn moved(model: &Model, from: &[f64], to: &[f64]) -> Option<Moved> {
    let n = model.coordinates().len();
    let mut most = Moved { by: 0.0, grown: 0.0 };
    for roles in model.roles() {
        let apart = |axis: usize| roles.centre.get(axis).map_or(0.0, |id| to[id.index()] - from[id.index()]);
        let one = if roles.shape.is_empty() {
            let [before, now] = [from, to].map(|at| sizes(model, at));
            if before.is_empty() || before.iter().chain(&now).any(|size| *size <= 0.0) {
                return None;
            }
            // A single size applies to all coordinates.
            let by = (0..n).map(|axis| (apart(axis) / before[axis.min(before.len() - 1)]).powi(2)).sum::<f64>();
            let grown = now.iter().zip(&before).map(|(now, before)| now / before).product::<f64>();
            Moved { by: by.sqrt(), grown: grown.powf((before.len() as f64).recip()) }
        } else {
            let ((_, before), (_, after)) = (inverse_shape(roles, n, from)?, inverse_shape(roles, n, to)?);
            let mut a = Matrix4::zeros();
            set_shape(roles, n, from, |place, entry| a[place] = entry)?;
            let apart = Vector4::from_fn(|axis, _| apart(axis));
            Moved { by: apart.dot(&(a * apart)).max(0.0).sqrt(), grown: (before / after).powf(0.5 / n as f64) }
        };
        most = Moved { by: most.by.max(one.by), grown: most.grown.max(one.grown) };
    }
    (!model.roles().is_empty() && most.grown > 0.0).then_some(most)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn moves_are_in_semi_axes_and_growth_is_that_of_the_mean_size() {
        let spot = Model::from_toml(include_str!("../../models/spot.toml")).unwrap();
        let at = |x: f64, along: f64, across: f64| {
            vec![x, 50.0, along.powi(-2), 0.0, across.powi(-2), -0.5, -0.3, 20.0, 100.0]
        };
        let found = moved(&spot, &at(100.0, 20.0, 10.0), &at(105.0, 40.0, 20.0)).unwrap();
        assert!((found.by - 0.25).abs() < 1e-12 && (found.grown - 2.0).abs() < 1e-12, "{found:?}");
        let pixel = Model::from_toml(include_str!("../../models/gaussian-pixel.toml")).unwrap();
        let found = moved(&pixel, &[5.0, 5.0, 2.0, 8.0, 0.0, 1.0], &[6.0, 5.0, 4.0, 4.0, 0.0, 1.0]).unwrap();
        assert!((found.by - 0.5).abs() < 1e-12 && (found.grown - 1.0).abs() < 1e-12, "{found:?}");
    }
}
