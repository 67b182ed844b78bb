//! Contours of targets, from the roles of their parameters. For overlays.

use isophote_symbolic::Model;

/// The outline dᵀAd = 1 of one target.
#[derive(Clone, Debug, PartialEq)]
pub struct Contour {
    /// The name of the roles, else their index.
    pub target: String,
    /// px.
    pub centre: [f64; 2],
    /// A, px⁻²; `None` when the model has no role `shape`.
    pub shape: Option<[[f64; 2]; 2]>,
}

/// The contours of all targets with a centre, for a model of two coordinates; empty for a volume. `parameters` as in an
/// estimate.
pub fn contours(model: &Model, parameters: &[f64]) -> Vec<Contour> {
    match model.coordinates().len() {
        2 => contours_in_slice(model, parameters, [0.0; 2]),
        _ => Vec::new(),
    }
}

/// The contours in one slice of a stack, at z and w: sections of ellipsoids; targets that the slice misses have none.
pub(crate) fn contours_in_slice(model: &Model, parameters: &[f64], slice: [f64; 2]) -> Vec<Contour> {
    let number = |roles: &[isophote_symbolic::ParameterId]| -> Option<Vec<f64>> {
        roles.iter().map(|parameter| parameters.get(parameter.index()).copied()).collect()
    };
    let dimensions = model.coordinates().len();
    let contour = |(index, roles): (usize, &isophote_symbolic::Roles)| {
        let all = number(&roles.centre)?;
        let (centre, deep) = (<[f64; 2]>::try_from(all.get(..2)?).ok()?, all.get(2..dimensions)?);
        let off: Vec<f64> = slice.iter().zip(deep).map(|(at, centre)| at - centre).collect();
        let target = roles.name.clone().unwrap_or_else(|| index.to_string());
        let triangle = number(&roles.shape)?;
        if triangle.len() != dimensions * (dimensions + 1) / 2 {
            return Some(Contour { target, centre, shape: None });
        }
        let (centre, shape) = cut(&triangle, centre, &off)?;
        Some(Contour { target, centre, shape: Some(shape) })
    };
    model.roles().iter().enumerate().filter_map(contour).collect()
}

/// The section of dᵀAd = 1 where the coordinates after the first two are `off` the centre: with A = (P Q; Qᵀ R) an ellipse
/// about −P⁻¹Q off, with matrix P / (1 − offᵀ(R − QᵀP⁻¹Q)off). `triangle` is the upper one of A, row by row. `None` beyond
/// the ellipsoid.
fn cut(triangle: &[f64], [x, y]: [f64; 2], off: &[f64]) -> Option<([f64; 2], [[f64; 2]; 2])> {
    let n = off.len() + 2;
    let entry = |i: usize, j: usize| triangle[i.min(j) * n - i.min(j) * (i.min(j) + 1) / 2 + i.max(j)];
    let (p11, p12, p22) = (entry(0, 0), entry(0, 1), entry(1, 1));
    let q: [f64; 2] = std::array::from_fn(|i| off.iter().enumerate().map(|(k, off)| entry(i, k + 2) * off).sum());
    let determinant = p11 * p22 - p12 * p12;
    let shift = [(p12 * q[1] - p22 * q[0]) / determinant, (p12 * q[0] - p11 * q[1]) / determinant];
    let shift = if off.is_empty() { [0.0; 2] } else { shift };
    let r = |(k, a): (usize, &f64)| off.iter().enumerate().map(|(l, b)| a * entry(k + 2, l + 2) * b).sum::<f64>();
    let level = 1.0 - off.iter().enumerate().map(r).sum::<f64>() - q[0] * shift[0] - q[1] * shift[1];
    let shape = [[p11, p12], [p12, p22]].map(|row| row.map(|value| value / level));
    (level > 0.0).then_some(([x + shift[0], y + shift[1]], shape))
}

impl Contour {
    /// `points` points on the outline, in order of the angle; empty when A is unknown or not positive definite.
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
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn slices_of_an_ellipsoid_lie_on_its_surface() {
        let model = Model::from_toml(include_str!("../../../models/blob-3d.toml")).unwrap();
        let value = |name: &str| match name {
            "bx" => 7.0,
            "by" => 5.0,
            "bz" => 4.5,
            "axx" => 0.04,
            "ayy" => 0.06,
            "azz" => 0.1,
            "axy" => 0.01,
            "axz" => 0.02,
            _ => -0.015,
        };
        let parameters: Vec<f64> = model.parameters().iter().map(|parameter| value(&parameter.name)).collect();
        for z in [3.0, 4.5, 6.0] {
            let outline = contours_in_slice(&model, &parameters, [z, 0.0])[0].outline(12);
            assert_eq!(outline.len(), 12);
            for [x, y] in outline {
                let d = [x - 7.0, y - 5.0, z - 4.5];
                let a = [[0.04, 0.01, 0.02], [0.01, 0.06, -0.015], [0.02, -0.015, 0.1]];
                let s: f64 = (0..3).flat_map(|i| (0..3).map(move |j| (i, j))).map(|(i, j)| d[i] * a[i][j] * d[j]).sum();
                assert!((s - 1.0).abs() < 1e-9, "z = {z}: {s}");
            }
        }
        assert!(contours_in_slice(&model, &parameters, [9.0, 0.0]).is_empty(), "beyond its end");
        assert!(contours(&model, &parameters).is_empty());
    }

    #[test]
    fn outline_points_satisfy_the_equation() {
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
