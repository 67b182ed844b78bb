//! What a fit's end point is sure of: the covariance, and what is known beforehand.
//!
//! What comes in: F's derivatives at the end, and where they are known, the factors of its Hessian. What goes out: the inverse of
//! Fisher's information. It never knows a pass.

use isophote_symbolic::{Model, ParameterId, Precision};
use nalgebra::{DMatrix, DVector};

use crate::scaled::Definite;
use crate::solve::stage;
use crate::solve::trust::{Quadratic, Spectrum};

/// What is known of a pose's other parameters before anything is seen, as standard deviations: a brightness is not so many
/// times that of the brightest spot, and what is between bounds is. A spot of which nothing is seen would leave the pose without
/// covariance otherwise. `None` for models of no pose.
pub(super) fn beforehand(model: &Model, order: &[ParameterId], parameters: &[f64]) -> Option<DVector<f64>> {
    const BRIGHTER: f64 = 100.0;
    let pose: Vec<ParameterId> =
        model.roles().iter().flat_map(|roles| roles.position.iter().chain(&roles.orientation)).copied().collect();
    if pose.is_empty() {
        return None;
    }
    let lights: Vec<ParameterId> = model.roles().iter().filter_map(|roles| roles.brightness).collect();
    let brightest = lights.iter().map(|id| parameters[id.index()].abs()).fold(1.0, f64::max);
    let known = |id: &ParameterId| match (model.parameters()[id.index()].min, model.parameters()[id.index()].max) {
        _ if pose.contains(id) => f64::INFINITY,
        _ if lights.contains(id) => BRIGHTER * brightest,
        (Some(min), Some(max)) => max - min,
        _ => f64::INFINITY,
    };
    Some(DVector::from_iterator(order.len(), order.iter().map(known)))
}

/// Takes that knowledge in. F is in units of ½ of a residual of `variance`.
pub(super) fn inform(quadratic: &mut Quadratic, known: &DVector<f64>, variance: f64) {
    for (row, deviation) in known.iter().enumerate() {
        quadratic.hessian[(row, row)] += 2.0 * variance / (deviation * deviation);
    }
}

/// `2 H⁻¹` times that variance of a residual, with H = 2 JᵀWJ: F has no factor ½. `None` when singular, unless the model has an
/// added background: then a direction that cannot be told from 0 counts as if it just could, which depends on the precision.
pub(super) fn inverse_fisher(
    model: &Model,
    quadratic: &Quadratic,
    factors: Option<Definite>,
    precision: Precision,
    variance: f64,
) -> Option<DMatrix<f64>> {
    let resolution = stage::eigen_resolution(precision);
    // Names of documents have no dots.
    let has_added = || model.parameters().iter().any(|parameter| parameter.name.contains('.'));
    let scale = match factors.or_else(|| Definite::of(&quadratic.hessian)) {
        Some(definite) if definite.is_clear(resolution) => return Some(definite.inverse() * (2.0 * variance)),
        Some(definite) => definite.scale(),
        None if has_added() => quadratic.hessian.diagonal().map(f64::sqrt),
        None => return None,
    };
    let spectrum = Spectrum::new(quadratic, &scale, resolution)?;
    let inverse = spectrum.inverse().or_else(|| spectrum.inverse_as_told().filter(|_| has_added()))?;
    Some(inverse * (2.0 * variance))
}

/// Whether a singular H says where the target is: the directions that it leaves open move nothing of that.
pub(super) fn is_placed(quadratic: &Quadratic, places: &[usize], precision: Precision) -> bool {
    let scale = quadratic.hessian.diagonal().map(|entry| if entry > 0.0 { entry.sqrt() } else { 1.0 });
    let spectrum = Spectrum::new(quadratic, &scale, stage::eigen_resolution(precision));
    let variances = spectrum.and_then(|spectrum| spectrum.inverse_diagonal());
    variances.is_some_and(|variances| places.iter().all(|place| variances[*place].is_finite()))
}
