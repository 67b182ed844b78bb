//! The covariance at a fit's end point, the inverse of the Fisher information, and prior information about a pose.

use isophote_symbolic::{Model, ParameterId, Precision};
use nalgebra::{DMatrix, DVector};

use crate::scaled::Definite;
use crate::solve::stage;
use crate::solve::trust::{Quadratic, Spectrum};

/// Prior standard deviations of a pose's other parameters: a brightness is at most about 100 times that of the brightest
/// spot, a bounded parameter lies within its bounds. Without them an unseen spot would leave the pose without covariance.
/// `None` for models of no pose.
pub(super) fn prior_deviations(model: &Model, order: &[ParameterId], parameters: &[f64]) -> Option<DVector<f64>> {
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

/// Adds the prior to the Hessian. F is in units of ½ of a residual of `variance`.
pub(super) fn add_prior_information(quadratic: &mut Quadratic, known: &DVector<f64>, variance: f64) {
    for (row, deviation) in known.iter().enumerate() {
        quadratic.hessian[(row, row)] += 2.0 * variance / (deviation * deviation);
    }
}

/// `2 H⁻¹` times the variance of a residual, with H = 2 JᵀWJ: F has no factor ½. `None` when singular, unless the model has
/// an added background: then eigenvalues below the resolution, which depends on the precision, are raised to it.
pub(super) fn inverse_fisher(
    model: &Model,
    quadratic: &Quadratic,
    factors: Option<Definite>,
    precision: Precision,
    variance: f64,
) -> Option<DMatrix<f64>> {
    let resolution = stage::eigen_resolution(precision);
    // Parameter names in documents have no dots.
    let has_added = || model.parameters().iter().any(|parameter| parameter.name.contains('.'));
    let scale = match factors.or_else(|| Definite::of(&quadratic.hessian)) {
        Some(definite) if definite.is_clear(resolution) => return Some(definite.inverse() * (2.0 * variance)),
        Some(definite) => definite.scale(),
        None if has_added() => quadratic.hessian.diagonal().map(f64::sqrt),
        None => return None,
    };
    let spectrum = Spectrum::new(quadratic, &scale, resolution)?;
    let inverse = spectrum.inverse().or_else(|| spectrum.clamped_inverse().filter(|_| has_added()))?;
    Some(inverse * (2.0 * variance))
}

/// Whether a singular H determines the target's position: the undetermined directions do not move it.
pub(super) fn determines_position(quadratic: &Quadratic, position_rows: &[usize], precision: Precision) -> bool {
    let scale = quadratic.hessian.diagonal().map(|entry| if entry > 0.0 { entry.sqrt() } else { 1.0 });
    let spectrum = Spectrum::new(quadratic, &scale, stage::eigen_resolution(precision));
    let variances = spectrum.and_then(|spectrum| spectrum.inverse_diagonal());
    variances.is_some_and(|variances| position_rows.iter().all(|row| variances[*row].is_finite()))
}
