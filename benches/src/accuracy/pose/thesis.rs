//! The pose by section 4.1.4 of the thesis: scaled orthography, spot by spot.
//!
//! With m the MAJOR semi-axis (the printed definition is that of the minor one), f the focal length, D m constant: `P
//! = (x − cx, y − cy, f) D m₀ / (m f)`, `cos θy = |OL| / m`, `cos θx = √((tan²θy + 1) / (tan²θy + m²/|OK|²))`, θz from
//! the image of the line from the red spot to the midpoint of the two others, and `R = Ry Rx Rz`. The thesis does not
//! give the signs of θx and θy: they are taken from the truth.

use isophote_tracker::geometry::{Rigid, outline_ellipse};
use nalgebra::{Matrix3, Rotation3, Vector3};

use super::scene::{RADIUS_MM, lens, target};

/// Position, |θx| and |θy| of one spot.
struct Spot {
    place: Vector3<f64>,
    theta_x: f64,
    theta_y: f64,
}

fn spot([x, y, a1, a2, a3]: [f64; 5]) -> Spot {
    let lens = lens();
    let least = 0.5 * (a1 + a3) - (0.25 * (a1 - a3).powi(2) + a2 * a2).sqrt();
    let m = least.sqrt().recip();
    let depth = lens.fx * RADIUS_MM / m;
    let place = Vector3::new((x - lens.cx) * depth / lens.fx, (y - lens.cy) * depth / lens.fy, depth);
    let (ol, ok) = (a1.sqrt().recip(), a3.sqrt().recip());
    let theta_y = (ol / m).min(1.0).acos();
    let tangent = theta_y.tan().powi(2);
    let theta_x = ((tangent + 1.0) / (tangent + m * m / (ok * ok))).sqrt().min(1.0).acos();
    Spot { place, theta_x, theta_y }
}

/// From the line from the red spot to the midpoint of the others, which is −y in the target.
fn theta_z(ellipses: &[[f64; 5]; 3]) -> f64 {
    let middle = [0, 1].map(|k| 0.5 * (ellipses[1][k] + ellipses[2][k]) - ellipses[0][k]);
    middle[1].atan2(middle[0]) + std::f64::consts::FRAC_PI_2
}

fn rotation(theta_x: f64, theta_y: f64, theta_z: f64) -> Matrix3<f64> {
    let turn = |axis, angle| Rotation3::from_axis_angle(&axis, angle);
    let turned = turn(Vector3::y_axis(), theta_y) * turn(Vector3::x_axis(), theta_x);
    (turned * turn(Vector3::z_axis(), theta_z)).into_inner()
}

/// The pose from three ellipses (x, y, a1, a2, a3).
pub fn pose(ellipses: &[[f64; 5]; 3], truth: &Rigid) -> Rigid {
    let spots = ellipses.map(spot);
    let mean = |pick: fn(&Spot) -> f64| spots.iter().map(pick).sum::<f64>() / spots.len() as f64;
    // R = Ry Rx Rz has the third column (sin θy cos θx, −sin θx, cos θy cos θx).
    let normal = truth.rotation.column(2);
    let theta_x = mean(|s| s.theta_x) * (-normal.y).signum();
    let theta_y = mean(|s| s.theta_y) * normal.x.signum();
    let translation = spots.iter().map(|s| s.place).sum::<Vector3<f64>>() / 3.0;
    Rigid { rotation: rotation(theta_x, theta_y, theta_z(ellipses)), translation }
}

/// Poses of the table: θx, θy, θz in degrees; x, y, z in mm.
const POSES: [([f64; 3], [f64; 3]); 7] = [
    ([0.0, 0.0, 0.0], [200.0, 100.0, 1000.0]),
    ([0.0, 15.0, 0.0], [0.0, 0.0, 1000.0]),
    ([0.0, 30.0, 0.0], [0.0, 0.0, 1000.0]),
    ([30.0, 30.0, 0.0], [0.0, 0.0, 1000.0]),
    ([45.0, 45.0, 0.0], [0.0, 0.0, 1000.0]),
    ([0.0, 30.0, 0.0], [300.0, 150.0, 1000.0]),
    ([20.0, 30.0, 20.0], [200.0, 100.0, 500.0]),
];

/// Errors of the formulas for exact outlines with given signs of the angles: the worst of the three spots.
pub fn table() -> String {
    let mut text = String::from(
        "| θx, θy, θz ° | x, y, z mm | depth, mm | sideways, mm | θx, ° | θy, ° | θz, ° |\n|---|---|---|---|---|---|---|",
    );
    for (angles, place) in POSES {
        let [x, y, z] = angles.map(f64::to_radians);
        let truth = Rigid { rotation: rotation(x, y, z), translation: Vector3::from(place) };
        let target = target(0.0);
        let ellipses: Vec<[f64; 5]> =
            target.spots.iter().map(|spot| outline_ellipse(&lens(), &truth, spot).unwrap()).collect();
        let ellipses = <[[f64; 5]; 3]>::try_from(ellipses).unwrap();
        let worst = |off: &dyn Fn(&Spot, Vector3<f64>) -> f64| {
            let one = |(ellipse, at): (&[f64; 5], &isophote_tracker::TargetSpot)| {
                off(&spot(*ellipse), truth.apply(Vector3::from(at.position_mm)))
            };
            let all = ellipses.iter().zip(&target.spots).map(one);
            all.max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or_default() + 0.0
        };
        text += &format!(
            "\n| {} | {} | {:.1} | {:.1} | {:.1} | {:.1} | {:.1} |",
            angles.map(|a| a.to_string()).join(", "),
            place.map(|c| c.to_string()).join(", "),
            worst(&|spot, at| spot.place.z - at.z),
            worst(&|spot, at| (spot.place - at).xy().norm()),
            worst(&|spot, _| (spot.theta_x - x).to_degrees()),
            worst(&|spot, _| (spot.theta_y - y).to_degrees()),
            (theta_z(&ellipses) - z).to_degrees() + 0.0
        );
    }
    text
}
