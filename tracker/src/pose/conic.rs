//! Conics of round spots: from an ellipse or a circle in space to its conic, and from an ellipse back to the circles.
//!
//! A conic C is the set `pᵀ C p = 0` of points p = (x, y, 1), in normalised coordinates, where the camera is a pinhole
//! of focal length 1.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use super::rigid::Rigid;

/// An ellipse `(p − centre)ᵀ shape (p − centre) = 1`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ellipse {
    /// Its centre.
    pub centre: Vector2<f64>,
    /// Positive definite.
    pub shape: Matrix2<f64>,
}

/// A circle in space: its centre and the normal of its plane, pointing away from the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Circle {
    /// Its centre.
    pub centre: Vector3<f64>,
    /// Of its plane.
    pub normal: Vector3<f64>,
}

impl Ellipse {
    /// Its conic.
    pub fn conic(&self) -> Matrix3<f64> {
        let linear = -(self.shape * self.centre);
        let constant = -(linear.dot(&self.centre)) - 1.0;
        let a = &self.shape;
        Matrix3::new(a.m11, a.m12, linear.x, a.m21, a.m22, linear.y, linear.x, linear.y, constant)
    }

    /// The ellipse of a conic; `None` when it is none.
    pub fn of_conic(conic: &Matrix3<f64>) -> Option<Ellipse> {
        let a = conic.fixed_view::<2, 2>(0, 0).into_owned();
        let linear = Vector2::new(conic.m13, conic.m23);
        let centre = -(a.try_inverse()? * linear);
        let scale = -(linear.dot(&centre) + conic.m33);
        let shape = a / scale;
        (shape.m11 > 0.0 && shape.determinant() > 0.0).then_some(Ellipse { centre, shape })
    }

    /// The ellipse mapped by the lens' local derivatives to the centre `at`: exact for a linear map.
    pub fn mapped(&self, slopes: &Matrix2<f64>, at: Vector2<f64>) -> Option<Ellipse> {
        let back = slopes.try_inverse()?;
        Some(Ellipse { centre: at, shape: back.transpose() * self.shape * back })
    }
}

/// The conic of the circle of `radius` around `centre` (target's frame) in the plane of the target's x and y.
pub(crate) fn conic_of_circle(pose: &Rigid, centre: Vector3<f64>, radius: f64) -> Option<Matrix3<f64>> {
    let (u, v) = (pose.rotation.column(0), pose.rotation.column(1));
    let plane = Matrix3::from_columns(&[u.into(), v.into(), pose.apply(centre)]);
    let back = plane.try_inverse()?;
    let r2 = radius * radius;
    Some(back.transpose() * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -r2)) * back)
}

/// Both circles of `radius` that project to the ellipse.
///
/// With Q the conic scaled to determinant −1, eigenvalues λ3 < 0 < λ1 ≤ λ2 and vectors u: the normal is
/// `n = √((λ2 − λ1)/(λ2 − λ3)) u2 ± √((λ1 − λ3)/(λ2 − λ3)) u3`, the plane's distance `d = λ1^(3/2) R`, and the centre lies
/// along `Q⁻¹ n`, the pole of the plane's vanishing line. Source: Kanatani and Liu 1993; Forsyth et al. 1991.
pub fn circles_of_ellipse(ellipse: &Ellipse, radius: f64) -> Option<[Circle; 2]> {
    let conic = ellipse.conic();
    let determinant = conic.determinant();
    if !(determinant.is_finite() && determinant < 0.0) {
        return None;
    }
    let q = conic / (-determinant).cbrt();
    let eigen = q.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    let [l3, l1, l2] = order.map(|i| eigen.eigenvalues[i]);
    let [u3, _, u2] = order.map(|i| eigen.eigenvectors.column(i).into_owned());
    if !(l3 < 0.0 && l1 > 0.0) {
        return None;
    }
    let inverse = q.try_inverse()?;
    let along = ((l2 - l1).max(0.0) / (l2 - l3)).sqrt();
    let across = ((l1 - l3) / (l2 - l3)).sqrt();
    let distance = l1.powf(1.5) * radius;
    let circle = |sign: f64| {
        let normal = u2 * along + u3 * (sign * across);
        let direction = inverse * normal;
        let direction = if direction.z < 0.0 { -direction } else { direction };
        let normal = if normal.dot(&direction) < 0.0 { -normal } else { normal };
        Circle { centre: direction * (distance / normal.dot(&direction)), normal }
    };
    Some([circle(1.0), circle(-1.0)])
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use nalgebra::Rotation3;

    /// Tilts up to 75°, all over the image, 300 mm to 3 m.
    #[test]
    fn one_of_the_two_circles_is_the_true_one() {
        let mut worst = (0.0_f64, 0.0_f64);
        let mut seen = 0;
        for distance in [300.0, 1000.0, 3000.0] {
            for (x, y) in [(0.0, 0.0), (0.4, 0.1), (-0.3, 0.35), (0.05, -0.4)] {
                for tilt in [0.0_f64, 2.0, 20.0, 45.0, 75.0] {
                    for towards in [0.0_f64, 1.0, 2.5, 4.0, 5.5] {
                        let turn = Vector3::new(towards.cos(), towards.sin(), 0.0) * tilt.to_radians();
                        let rotation = Rotation3::new(turn).into_inner();
                        let pose = Rigid { rotation, translation: Vector3::new(x, y, 1.0) * distance };
                        let normal = rotation.column(2).into_owned();
                        if normal.dot(&pose.translation) <= 0.1 * distance {
                            continue;
                        }
                        let centre = Vector3::new(7.0, -3.0, 0.0);
                        let conic = conic_of_circle(&pose, centre, 30.0).unwrap();
                        let ellipse = Ellipse::of_conic(&conic).unwrap();
                        let circles = circles_of_ellipse(&ellipse, 30.0).unwrap();
                        let off = |c: &Circle| {
                            ((c.centre - pose.apply(centre)).norm(), c.normal.cross(&normal).norm().asin().to_degrees())
                        };
                        let near = circles.iter().map(off).min_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
                        worst = (worst.0.max(near.0), worst.1.max(near.1));
                        seen += 1;
                    }
                }
            }
        }
        // Digits go with the distance: the ellipse of a spot 3 m away is a hundredth of the focal length wide.
        assert!(seen > 250 && worst.0 < 1e-4 && worst.1 < 1e-3, "{seen} poses, {} mm, {}°", worst.0, worst.1);
    }

    #[test]
    fn an_ellipse_converts_to_its_conic_and_back() {
        let ellipse = Ellipse { centre: Vector2::new(0.2, -0.1), shape: Matrix2::new(900.0, 120.0, 120.0, 1500.0) };
        let conic = ellipse.conic();
        let back = Ellipse::of_conic(&(conic * -3.0)).unwrap();
        assert!((back.centre - ellipse.centre).norm() < 1e-12 && (back.shape - ellipse.shape).norm() < 1e-8);
        let hyperbola = Ellipse { shape: Matrix2::new(900.0, 0.0, 0.0, -900.0), ..ellipse };
        assert!(Ellipse::of_conic(&hyperbola.conic()).is_none());
    }
}
