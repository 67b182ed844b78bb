//! P3P: all poses of three points that are seen in three directions.
//!
//! With distances s1, s2, s3 along the unit rays and sides a = |P2P3|, b = |P1P3|, c = |P1P2|, the law of cosines is
//! `s2² + s3² − 2 s2 s3 cos α = a²` and so on. With u = s2/s1 and v = s3/s1 that is a quartic in v. Source: Grunert 1841, as
//! in Haralick, Lee, Ottenberg and Nölle 1994. Each root is polished on the three equations themselves.

use nalgebra::{DMatrix, Vector3};

use super::rigid::{Rigid, kabsch};
use crate::least_squares::{NormalEquations, least_squares};

/// Derived: a root is polished until the next step would change the equations by less than some tens of ε, as shares of the
/// sides' squares.
const POLISHED: f64 = 1e-14;
/// A root is real when its imaginary part is at most this share: double roots come apart by √ε.
const REAL: f64 = 1e-4;
/// The three equations hold to this share of the sides' squares.
const FULFILLED: f64 = 1e-9;
/// Two solutions are one when their distances differ by less than this share.
const SAME: f64 = 1e-7;

/// All poses that put `points` (target's frame) on `rays` (unit, camera's frame), in front of the camera. At most four.
pub fn p3p(points: &[Vector3<f64>; 3], rays: &[Vector3<f64>; 3]) -> Vec<Rigid> {
    let mut found: Vec<Vector3<f64>> = Vec::new();
    for distances in distances(points, rays) {
        if !found.iter().any(|other| (other - distances).norm() < SAME * distances.norm()) {
            found.push(distances);
        }
    }
    let pose = |s: &Vector3<f64>| kabsch(points, &[rays[0] * s[0], rays[1] * s[1], rays[2] * s[2]]);
    found.iter().filter_map(pose).collect()
}

fn distances(points: &[Vector3<f64>; 3], rays: &[Vector3<f64>; 3]) -> Vec<Vector3<f64>> {
    let square = |i: usize, j: usize| (points[i] - points[j]).norm_squared();
    let sides = Vector3::new(square(1, 2), square(0, 2), square(0, 1)); // a², b², c²
    let cosines = Vector3::new(rays[1].dot(&rays[2]), rays[0].dot(&rays[2]), rays[0].dot(&rays[1]));
    let (a2, b2, c2) = (sides[0], sides[1], sides[2]);
    let (alpha, beta, gamma) = (cosines[0], cosines[1], cosines[2]);
    let q = (a2 - c2) / b2;
    let (plus, aa, cc) = ((a2 + c2) / b2, a2 / b2, c2 / b2);
    let quartic = [
        (1.0 + q).powi(2) - 4.0 * aa * gamma * gamma,
        4.0 * (-q * (1.0 + q) * beta + 2.0 * aa * gamma * gamma * beta - (1.0 - plus) * alpha * gamma),
        2.0 * (q * q - 1.0 + 2.0 * q * q * beta * beta + 2.0 * (1.0 - cc) * alpha * alpha
            - 4.0 * plus * alpha * beta * gamma
            + 2.0 * (1.0 - aa) * gamma * gamma),
        4.0 * (q * (1.0 - q) * beta - (1.0 - plus) * alpha * gamma + 2.0 * cc * alpha * alpha * beta),
        (q - 1.0).powi(2) - 4.0 * cc * alpha * alpha,
    ];
    let mut all = Vec::new();
    for v in positive_roots(&quartic) {
        let first = (b2 / (1.0 + v * v - 2.0 * v * beta)).sqrt();
        // s1² (1 + u² − 2 u cos γ) = c² has two roots; the equation of side a says which.
        let rest = gamma * gamma - 1.0 + c2 / (first * first);
        let root = rest.max(0.0).sqrt();
        for u in [gamma + root, gamma - root] {
            let guess = Vector3::new(first, u * first, v * first);
            all.extend(polished(guess, &sides, &cosines));
        }
    }
    all
}

/// Least squares on the law of cosines; `None` when it does not hold, or behind the camera.
fn polished(guess: Vector3<f64>, sides: &Vector3<f64>, cosines: &Vector3<f64>) -> Option<Vector3<f64>> {
    let largest = sides.max();
    let equations = |s: &Vector3<f64>| {
        Some(NormalEquations::of([(0, 1, 2), (1, 0, 2), (2, 0, 1)].map(|(k, i, j)| {
            let mut row = Vector3::zeros();
            row[i] = 2.0 * (s[i] - s[j] * cosines[k]) / largest;
            row[j] = 2.0 * (s[j] - s[i] * cosines[k]) / largest;
            let side = s[i] * s[i] + s[j] * s[j] - 2.0 * s[i] * s[j] * cosines[k];
            ((sides[k] - side) / largest, row, 1.0)
        })))
    };
    let found = least_squares(guess, POLISHED * POLISHED, equations, |s, by| s + by)?;
    let is_fulfilled = found.equations.cost <= FULFILLED * FULFILLED;
    (is_fulfilled && found.point.iter().all(|distance| *distance > 0.0)).then_some(found.point)
}

/// Positive real roots of a polynomial, constant coefficient first, as eigenvalues of the companion matrix.
fn positive_roots(coefficients: &[f64]) -> Vec<f64> {
    let largest = coefficients.iter().fold(0.0_f64, |largest, c| largest.max(c.abs()));
    let Some(degree) = coefficients.iter().rposition(|c| c.abs() > 1e-14 * largest) else { return Vec::new() };
    if degree == 0 || !largest.is_finite() {
        return Vec::new();
    }
    let mut companion = DMatrix::zeros(degree, degree);
    for i in 0..degree {
        companion[(i, degree - 1)] = -coefficients[i] / coefficients[degree];
        if i > 0 {
            companion[(i, i - 1)] = 1.0;
        }
    }
    let roots = companion.complex_eigenvalues();
    let real =
        |root: &nalgebra::Complex<f64>| (root.im.abs() <= REAL * root.norm() && root.re > 0.0).then_some(root.re);
    roots.iter().filter_map(real).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use nalgebra::Rotation3;

    fn of(numbers: [[f64; 3]; 3]) -> [Vector3<f64>; 3] {
        numbers.map(Vector3::from)
    }

    #[test]
    fn the_pose_is_among_the_solutions_and_each_sees_the_points() {
        let targets = [
            of([[0.0, 80.0, 0.0], [-70.0, -40.0, 0.0], [70.0, -40.0, 0.0]]),
            of([[0.0, 0.0, -40.0], [-70.0, 10.0, 0.0], [50.0, -60.0, 5.0]]),
            of([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [0.0, 100.0, 0.0]]),
        ];
        let mut most = 0;
        for points in targets {
            for seed in 0..400 {
                // Low-discrepancy angles and positions.
                let at = |k: f64| (f64::from(seed) * k).fract() - 0.5;
                let turn = Vector3::new(at(0.618_034), at(0.754_878), 2.0 * at(0.569_840)) * 2.0;
                let translation =
                    Vector3::new(300.0 * at(0.324_718), 300.0 * at(0.819_173), 700.0 + 600.0 * at(0.671_044));
                let pose = Rigid { rotation: Rotation3::new(turn).into_inner(), translation };
                let rays = points.map(|point| pose.apply(point).normalize());
                let found = p3p(&points, &rays);
                most = most.max(found.len());
                assert!(found.len() <= 4);
                let nearest = found.iter().map(|f| (f.translation - translation).norm() + 100.0 * f.angle_to(&pose));
                let nearest = nearest.fold(f64::INFINITY, f64::min);
                assert!(nearest < 1e-3, "seed {seed}: {nearest}");
                for solution in found {
                    for (point, ray) in points.iter().zip(&rays) {
                        assert!((solution.apply(*point).normalize() - ray).norm() < 1e-7);
                    }
                }
            }
        }
        assert!(most >= 3, "no case had more than {most} solutions");
    }

    #[test]
    fn no_solution_is_invented() {
        let points = of([[0.0, 80.0, 0.0], [-70.0, -40.0, 0.0], [70.0, -40.0, 0.0]]);
        // Three equal rays see no triangle.
        assert!(p3p(&points, &[Vector3::z(); 3]).is_empty());
        assert!(p3p(&[Vector3::zeros(); 3], &[Vector3::x(), Vector3::y(), Vector3::z()]).is_empty());
    }
}
