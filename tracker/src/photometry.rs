//! Photometry of a target in a plane: flux, width, axes and orientation, from the roles of its document.
//!
//! The light of a target is `b (V/V₀)^q p(√(dᵀAd))`: b its brightness, V = π/√det A the area of its outline, p its profile.
//! q is 0 where b is a height, −1 where it is a flux. With κ, the share of the outline that the light would fill at full height,
//! and h, the radius of half the maximum in semi-axes,
//! ```text
//! flux = b κ V (V/V₀)^q        FWHM = 2 h √(V/π)
//! ```
//! Standard deviations follow from the joint covariance by the delta method.

use std::sync::{Mutex, OnceLock, PoisonError};

use isophote_symbolic::{Estimator, Model, ParameterId, Start};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use smallvec::SmallVec;

use crate::outline::{made_up, size_parameters};
use crate::track::window::FARTHEST;

/// A budget: semi-axis of the synthetic target whose profile is sampled, px.
const SEMI_AXIS_PX: f64 = 8.0;
/// A budget: steps of its profile.
const STEPS: usize = 120;
/// A definition: light that differs from an elliptical profile by this share of its height is not elliptical.
const UNLIKE: f64 = 0.02;
/// A budget: step of finite differences, in standard deviations.
const STEP: f64 = 1e-3;

/// Flux, width, axes and orientation of a target; errors are standard deviations, absent without a covariance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Photometry {
    /// Light in the document's domain, summed over pixels: pixel values × px².
    pub flux: f64,
    /// Standard deviation of the flux.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub flux_err: Option<f64>,
    /// Width at half the maximum, px: the geometric mean of both axes.
    pub fwhm: f64,
    /// Standard deviation of the width, px.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub fwhm_err: Option<f64>,
    /// Longer semi-axis of the outline, px.
    pub semi_major: f64,
    /// Standard deviation of the longer semi-axis, px.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub semi_major_err: Option<f64>,
    /// Shorter semi-axis of the outline, px.
    pub semi_minor: f64,
    /// Standard deviation of the shorter semi-axis, px.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub semi_minor_err: Option<f64>,
    /// Angle from the x axis to the longer semi-axis, towards y, −90 to 90°.
    pub angle_deg: f64,
    /// Standard deviation of the angle, degrees; 90 / √3 and more where the outline may be a circle.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub angle_deg_err: Option<f64>,
}

/// The number of quantities.
const QUANTITIES: usize = 5;

/// The radial profile of a document's light.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Profile {
    /// κ.
    pub fullness: f64,
    /// h; `None` where the light does not fall to half its maximum.
    half_maximum: Option<f64>,
    /// q.
    exponent: f64,
}

impl Profile {
    /// The profile along x of a target with these parameters, at a synthetic size; `None` for documents without brightness or
    /// centre, and where there is no light.
    pub fn of(model: &Model, constants: &[f64], parameters: Option<&[f64]>) -> Option<Profile> {
        let light = Light::of(model, constants)?;
        let n = model.coordinates().len();
        let sized = |semi_axis: f64| {
            let mut made = made_up(model, semi_axis);
            for id in parameters.into_iter().flat_map(|_| profile_parameters(model)) {
                made[id.index()] = parameters.map_or(f64::NAN, |parameters| parameters[id.index()]);
            }
            made
        };
        let (small, large) = (sized(SEMI_AXIS_PX), sized(2.0 * SEMI_AXIS_PX));
        let width = FARTHEST / STEPS as f64;
        let radius = |step: usize| (step as f64 + 0.5) * width;
        let along = |parameters: &[f64], at_px: f64| {
            let offsets: Vec<f64> = (0..n).map(|axis| if axis == 0 { at_px } else { 0.0 }).collect();
            light.at(parameters, &offsets) / light.brightness(parameters)
        };
        let values: Vec<f64> = (0..STEPS).map(|step| along(&small, radius(step) * SEMI_AXIS_PX)).collect();
        let shell = |step: usize| n as f64 * radius(step).powi(n as i32 - 1) * width;
        let fullness: f64 = values.iter().enumerate().map(|(step, value)| value * shell(step)).sum();
        let highest = (0..STEPS).max_by(|a, b| values[*a].abs().total_cmp(&values[*b].abs()))?;
        let ratio = along(&large, 2.0 * radius(highest) * SEMI_AXIS_PX) / values[highest];
        let exponent = ratio.ln() / (n as f64 * std::f64::consts::LN_2);
        let half = 0.5 * values[highest].abs();
        let last = values.iter().rposition(|value| value.abs() >= half)?;
        let share = |next: f64| (values[last].abs() - half) / (values[last].abs() - next.abs());
        let half_maximum = values.get(last + 1).map(|next| radius(last) + share(*next) * width);
        (fullness.is_finite() && fullness != 0.0).then_some(Profile { fullness, half_maximum, exponent })
    }

    /// True when the light of an ellipse follows the profile: no other shape and no other dependence on size.
    pub fn is_elliptical(&self, model: &Model, constants: &[f64]) -> bool {
        let round = made_up(model, SEMI_AXIS_PX);
        let mut oblique = round.clone();
        set_ellipse(model, &mut oblique, [1.5 * SEMI_AXIS_PX, SEMI_AXIS_PX], 0.5);
        let (Some(light), Some(matrix)) = (Light::of(model, constants), matrix(model, &oblique)) else { return false };
        let scale = (area(matrix) / (std::f64::consts::PI * SEMI_AXIS_PX.powi(2))).powf(self.exponent);
        let radii = (0..8).map(|step| 0.2 + 0.2 * f64::from(step));
        let values: Vec<(f64, f64)> =
            radii.map(|radius| (radius, light.at(&round, &[radius * SEMI_AXIS_PX, 0.0]) * scale)).collect();
        let height = values.iter().map(|(_, value)| value.abs()).fold(0.0, f64::max);
        let is_alike = |angle: f64, (radius, value): (f64, f64)| {
            let (sin, cos) = angle.sin_cos();
            let [xx, xy, yy] = matrix;
            let reach = radius / (xx * cos * cos + 2.0 * xy * sin * cos + yy * sin * sin).sqrt();
            (light.at(&oblique, &[reach * cos, reach * sin]) - value).abs() <= UNLIKE * height
        };
        // A rim is sampled on one side or the other of it: one radius of each direction may differ.
        (0..6).all(|step| {
            let angle = f64::from(step) * std::f64::consts::FRAC_PI_6 * 2.0;
            values.iter().filter(|value| !is_alike(angle, **value)).count() <= 1
        })
    }

    /// Flux, FWHM, semi-axes and angle in radians.
    fn quantities(&self, model: &Model, parameters: &[f64]) -> Option<[f64; QUANTITIES]> {
        let [roles] = model.roles() else { return None };
        let [xx, xy, yy] = matrix(model, parameters)?;
        let area = area([xx, xy, yy]);
        let brightness = parameters[roles.brightness?.index()];
        let unit = std::f64::consts::PI * SEMI_AXIS_PX.powi(2);
        let flux = brightness * self.fullness * area * (area / unit).powf(self.exponent);
        let fwhm = 2.0 * self.half_maximum? * (area / std::f64::consts::PI).sqrt();
        let (mean, half) = (0.5 * (xx + yy), (0.5 * (xx - yy)).hypot(xy));
        let [major, minor] = [mean - half, mean + half].map(|eigenvalue| eigenvalue.sqrt().recip());
        let angle = 0.5 * (-2.0 * xy).atan2(yy - xx);
        let all = [flux, fwhm, major, minor, angle];
        all.iter().all(|value| value.is_finite()).then_some(all)
    }
}

impl Photometry {
    /// The photometry of a fit with this profile.
    fn of(
        model: &Model,
        constants: &[f64],
        parameters: &[f64],
        free: (&[ParameterId], Option<&DMatrix<f64>>),
        profile: Profile,
    ) -> Option<Photometry> {
        let values = profile.quantities(model, parameters)?;
        let errors = free.1.and_then(|covariance| {
            let mut moved = parameters.to_vec();
            let column = |(row, id): (usize, &ParameterId)| {
                let step = STEP * covariance[(row, row)].sqrt();
                moved[id.index()] += step;
                let is_of_profile = profile_parameters(model).any(|other| other == *id);
                let profile = if is_of_profile { Profile::of(model, constants, Some(&moved))? } else { profile };
                let ahead = profile.quantities(model, &moved)?;
                moved[id.index()] = parameters[id.index()];
                let mut slopes: [f64; QUANTITIES] = std::array::from_fn(|k| ahead[k] - values[k]);
                // An angle and its opposite are the same.
                slopes[QUANTITIES - 1] -=
                    std::f64::consts::PI * (slopes[QUANTITIES - 1] / std::f64::consts::PI).round();
                Some(slopes.map(|slope| if step > 0.0 { slope / step } else { 0.0 }))
            };
            let slopes: SmallVec<[[f64; QUANTITIES]; 12]> =
                free.0.iter().enumerate().map(column).collect::<Option<_>>()?;
            let pairs = || (0..slopes.len()).flat_map(|i| (0..slopes.len()).map(move |j| (i, j)));
            let variance =
                |k: usize| -> f64 { pairs().map(|(i, j)| slopes[i][k] * covariance[(i, j)] * slopes[j][k]).sum() };
            Some(std::array::from_fn::<f64, QUANTITIES, _>(|k| variance(k).max(0.0).sqrt()))
        });
        let [flux, fwhm, semi_major, semi_minor, angle] = values;
        let error = |k: usize| errors.map(|errors| errors[k]).filter(|error| error.is_finite());
        Some(Photometry {
            flux,
            flux_err: error(0),
            fwhm,
            fwhm_err: error(1),
            semi_major,
            semi_major_err: error(2),
            semi_minor,
            semi_minor_err: error(3),
            angle_deg: angle.to_degrees(),
            angle_deg_err: error(4).map(f64::to_degrees),
        })
    }
}

/// The profiles of a document with its constants, computed once for each set of their parameters.
#[derive(Debug, Default)]
pub(crate) struct Profiles {
    usual: OnceLock<Option<Profile>>,
    is_elliptical: OnceLock<bool>,
    last: Mutex<Option<KnownProfile>>,
}

/// The profile of some parameters.
#[derive(Debug)]
struct KnownProfile {
    /// Values of [`profile_parameters`].
    parameters: SmallVec<[f64; 4]>,
    profile: Option<Profile>,
}

impl Profiles {
    /// The profile with the document's own numbers.
    pub fn usual(&self, model: &Model, constants: &[f64]) -> Option<Profile> {
        *self.usual.get_or_init(|| Profile::of(model, constants, None))
    }

    /// The photometry of a fit; `None` for documents that are no single elliptical target with brightness in a plane.
    pub fn photometry(
        &self,
        model: &Model,
        constants: &[f64],
        parameters: &[f64],
        free: (&[ParameterId], Option<&DMatrix<f64>>),
    ) -> Option<Photometry> {
        let usual = self.usual(model, constants)?;
        if !self.is_elliptical.get_or_init(|| usual.is_elliptical(model, constants)) {
            return None;
        }
        let own: SmallVec<[f64; 4]> = profile_parameters(model).map(|id| parameters[id.index()]).collect();
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        if last.as_ref().is_none_or(|known| known.parameters != own) {
            *last = Some(KnownProfile { parameters: own, profile: Profile::of(model, constants, Some(parameters)) });
        }
        let profile = last.as_ref()?.profile?;
        drop(last);
        Photometry::of(model, constants, parameters, free, profile)
    }
}

/// The light of a document's only target: its prediction less that without brightness.
struct Light<'a> {
    model: &'a Model,
    constants: &'a [f64],
    centre: &'a [ParameterId],
    brightness: ParameterId,
}

impl<'a> Light<'a> {
    fn of(model: &'a Model, constants: &'a [f64]) -> Option<Light<'a>> {
        let [roles] = model.roles() else { return None };
        let is_suited = roles.centre.len() == model.coordinates().len() && !model.needs_a_frame();
        is_suited.then_some(Light { model, constants, centre: &roles.centre, brightness: roles.brightness? })
    }

    fn brightness(&self, parameters: &[f64]) -> f64 {
        parameters[self.brightness.index()]
    }

    /// The light at these offsets from the centre, px; 0 outside of the domain.
    fn at(&self, parameters: &[f64], offsets: &[f64]) -> f64 {
        let mut dark = parameters.to_vec();
        dark[self.brightness.index()] = 0.0;
        let position: Vec<f64> =
            self.centre.iter().zip(offsets).map(|(id, offset)| parameters[id.index()] + offset).collect();
        let seen = |parameters: &[f64]| match self.model.domain_holds(&position, parameters, self.constants) {
            true => self.model.predicted(&position, parameters, self.constants),
            false => 0.0,
        };
        seen(parameters) - seen(&dark)
    }
}

/// Parameters that are neither centre, outline, brightness nor background: those of the profile.
fn profile_parameters(model: &Model) -> impl Iterator<Item = ParameterId> {
    let roles = model.roles().first();
    let is_role = move |id: &ParameterId| {
        roles.is_some_and(|roles| {
            let parts = roles.centre.iter().chain(&roles.shape).chain(&roles.brightness).chain(&roles.background);
            parts.into_iter().any(|other| other == id)
        })
    };
    let is_outline = |id: &ParameterId| {
        matches!(model.parameters()[id.index()].start, Start::Estimator(Estimator::Size(_) | Estimator::Angle))
    };
    (0..model.parameters().len() as u32).map(ParameterId).filter(move |id| !is_role(id) && !is_outline(id))
}

/// A of the outline in a plane: xx, xy, yy; `None` where it is not positive definite or the document has no outline.
fn matrix(model: &Model, parameters: &[f64]) -> Option<[f64; 3]> {
    let [roles] = model.roles() else { return None };
    if model.coordinates().len() != 2 {
        return None;
    }
    let value = |id: ParameterId| parameters[id.index()];
    let [xx, xy, yy] = match roles.shape[..] {
        [xx, xy, yy] => [xx, xy, yy].map(value),
        _ => {
            let sizes: SmallVec<[f64; 4]> = size_parameters(model).map(value).collect();
            let [along, across] = match sizes[..] {
                [both] => Some([both, both]),
                [along, across] => Some([along, across]),
                _ => None,
            }?
            .map(|size| size.powi(-2));
            let (sin, cos) = angle_parameter(model).map_or(0.0, value).sin_cos();
            let xx = along * cos * cos + across * sin * sin;
            [xx, (along - across) * sin * cos, along + across - xx]
        }
    };
    (xx > 0.0 && xx * yy > xy * xy).then_some([xx, xy, yy])
}

fn angle_parameter(model: &Model) -> Option<ParameterId> {
    let is_angle = |id: &ParameterId| model.parameters()[id.index()].start == Start::Estimator(Estimator::Angle);
    (0..model.parameters().len() as u32).map(ParameterId).find(is_angle)
}

/// Sets the outline to an ellipse, where the document has one.
fn set_ellipse(model: &Model, parameters: &mut [f64], [along, across]: [f64; 2], angle: f64) {
    let (sin, cos) = angle.sin_cos();
    let [p, q] = [along, across].map(|axis: f64| axis.powi(-2));
    let entries = [p * cos * cos + q * sin * sin, (p - q) * sin * cos, p * sin * sin + q * cos * cos];
    let roles = model.roles().first();
    for (id, entry) in roles.iter().flat_map(|roles| &roles.shape).zip(entries) {
        parameters[id.index()] = entry;
    }
    for (id, axis) in size_parameters(model).zip([along, across]) {
        parameters[id.index()] = axis;
    }
    if let Some(id) = angle_parameter(model) {
        parameters[id.index()] = angle;
    }
}

/// The area of an outline, px².
fn area([xx, xy, yy]: [f64; 3]) -> f64 {
    std::f64::consts::PI / (xx * yy - xy * xy).sqrt()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use nalgebra::DVector;

    use super::*;

    fn read(text: &str) -> (Model, Vec<f64>) {
        let model = Model::from_toml(text).unwrap_or_else(|d| panic!("{}", d[0].render("test")));
        let constants = model.constants().iter().map(|constant| constant.value).collect();
        (model, constants)
    }

    const GAUSSIAN: &str = include_str!("../../models/gaussian.toml");

    #[test]
    fn fullness_follows_from_the_profile() {
        let fullness = |text: &str| {
            let (model, constants) = read(text);
            Profile::of(&model, &constants, None).map(|profile| profile.fullness)
        };
        // ∫ 1 − s/2 − 3s²/10 − s³/5 ds from 0 to 1; exp(−2s) from 0 to 4.
        let cubic = fullness(include_str!("../../models/spot.toml")).unwrap();
        let gaussian = fullness(GAUSSIAN).unwrap();
        assert!((cubic - 0.6).abs() < 0.01 && (gaussian - 0.5).abs() < 0.01, "{cubic} {gaussian}");
        assert_eq!(fullness(include_str!("../../models/three-spots.toml")), None);
    }

    /// Closed forms of a Gaussian: flux π/2 · v1 a b, FWHM √(2 ln 2) √(ab), with semi-axes at 1/e².
    #[test]
    fn a_gaussian_has_the_flux_and_width_of_its_closed_form() {
        let (model, constants) = read(GAUSSIAN);
        let mut parameters = vec![50.0, 40.0, 0.0, 0.0, 0.0, 10.0, 200.0];
        set_ellipse(&model, &mut parameters, [6.0, 3.0], -0.4);
        let free: Vec<ParameterId> = (0..7).map(ParameterId).collect();
        let deviations = [0.1, 0.1, 1e-4, 1e-4, 2e-4, 0.5, 2.0];
        let covariance = DMatrix::from_diagonal(&DVector::from_iterator(7, deviations.iter().map(|d: &f64| d * d)));
        let found =
            Profiles::default().photometry(&model, &constants, &parameters, (&free, Some(&covariance))).unwrap();
        let flux = 0.5 * std::f64::consts::PI * 200.0 * 18.0;
        assert!((found.flux / flux - 1.0).abs() < 0.005, "{found:?}");
        assert!((found.fwhm / (18.0 * 2.0 * std::f64::consts::LN_2).sqrt() - 1.0).abs() < 0.005, "{found:?}");
        assert!((found.semi_major - 6.0).abs() < 1e-9 && (found.semi_minor - 3.0).abs() < 1e-9, "{found:?}");
        assert!((found.angle_deg + 0.4_f64.to_degrees()).abs() < 1e-9, "{found:?}");
        // ln flux = ln v1 − ½ ln det A: 1 % of the brightness, and the share of the outline.
        let [xx, xy, yy] = matrix(&model, &parameters).unwrap();
        let slopes = [yy, -2.0 * xy, xx].map(|entry| entry / (2.0 * (xx * yy - xy * xy)));
        let outline: f64 = slopes.iter().zip(&deviations[2..5]).map(|(slope, d)| (slope * d).powi(2)).sum();
        let expected = found.flux * (outline + 1e-4).sqrt();
        assert!((found.flux_err.unwrap() / expected - 1.0).abs() < 0.01, "{found:?} {expected}");
    }

    /// A brightness that is the flux itself does not grow with the outline.
    #[test]
    fn a_brightness_may_be_a_flux() {
        let text = GAUSSIAN.replace("v0 + v1 * exp(-2 * s)", "v0 + v1 * sqrt(a1*a3 - a2^2) * exp(-2 * s)");
        let (model, constants) = read(&text);
        let mut parameters = vec![50.0, 40.0, 0.0, 0.0, 0.0, 10.0, 200.0];
        set_ellipse(&model, &mut parameters, [4.0, 2.5], 0.2);
        let found = Profiles::default().photometry(&model, &constants, &parameters, (&[], None)).unwrap();
        assert!((found.flux / (100.0 * std::f64::consts::PI) - 1.0).abs() < 0.005, "{found:?}");
        assert_eq!(found.flux_err, None);
    }

    #[test]
    fn light_that_is_not_elliptical_has_no_photometry() {
        let text = GAUSSIAN.replace("exp(-2 * s)", "exp(-2 * s) * (1 + 0.2 * (x - bx) / (1 + s))");
        let (model, constants) = read(&text);
        let parameters = vec![50.0, 40.0, 0.05, 0.0, 0.05, 10.0, 200.0];
        assert_eq!(Profiles::default().photometry(&model, &constants, &parameters, (&[], None)), None);
    }
}
