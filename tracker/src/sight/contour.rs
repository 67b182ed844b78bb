//! Contours: where a target is in the picture, by the roles of its parameters. For overlays.

use isophote_symbolic::Model;

/// The outline dᵀAd = 1 of one target.
#[derive(Clone, Debug, PartialEq)]
pub struct Contour {
    /// The name of the roles, else their number.
    pub target: String,
    /// px.
    pub centre: [f64; 2],
    /// A, px⁻²; `None` when the model has no role `shape`.
    pub shape: Option<[[f64; 2]; 2]>,
}

/// The contours of all targets of a model of two coordinates that have a centre; a volume has no outline to draw. `parameters` as in an estimate.
pub fn contours(model: &Model, parameters: &[f64]) -> Vec<Contour> {
    let number = |roles: &[isophote_symbolic::ParameterId]| -> Option<Vec<f64>> {
        roles.iter().map(|parameter| parameters.get(parameter.index()).copied()).collect()
    };
    if model.coordinates().len() != 2 {
        return Vec::new();
    }
    let contour = |(index, roles): (usize, &isophote_symbolic::Roles)| {
        let [x, y] = number(&roles.centre)?[..] else { return None };
        let shape = match number(&roles.shape)?[..] {
            [a1, a2, a3] => Some([[a1, a2], [a2, a3]]),
            _ => None,
        };
        let target = roles.name.clone().unwrap_or_else(|| index.to_string());
        Some(Contour { target, centre: [x, y], shape })
    };
    model.roles().iter().enumerate().filter_map(contour).collect()
}

impl Contour {
    /// `points` places on the outline, in order of the angle; empty when A is not known or not positive definite.
    ///
    /// With A = L Lᵀ (Cholesky), d = L⁻ᵀ (cos t, sin t) lies on dᵀAd = 1.
    pub fn outline(&self, points: usize) -> Vec<[f64; 2]> {
        let Some([[a1, a2], [_, a3]]) = self.shape else { return Vec::new() };
        let rest = a3 - a2 * a2 / a1;
        if !(a1 > 0.0 && rest > 0.0) {
            return Vec::new();
        }
        let (l11, l21, l22) = (a1.sqrt(), a2 / a1.sqrt(), rest.sqrt());
        let place = |k: usize| {
            let (sin, cos) = (std::f64::consts::TAU * k as f64 / points as f64).sin_cos();
            let dy = sin / l22;
            [self.centre[0] + (cos - l21 * dy) / l11, self.centre[1] + dy]
        };
        (0..points).map(place).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_on_the_outline_fulfil_its_equation() {
        let contour =
            Contour { target: "0".into(), centre: [3.0, -2.0], shape: Some([[0.02, -0.011], [-0.011, 0.05]]) };
        let outline = contour.outline(17);
        assert_eq!(outline.len(), 17);
        for [x, y] in outline {
            let (dx, dy) = (x - 3.0, y + 2.0);
            assert!((0.02 * dx * dx - 0.022 * dx * dy + 0.05 * dy * dy - 1.0).abs() < 1e-12);
        }
        assert!(Contour { shape: Some([[0.02, 0.05], [0.05, 0.05]]), ..contour.clone() }.outline(17).is_empty());
        assert!(Contour { shape: None, ..contour }.outline(17).is_empty());
    }
}
