//! The pose by section 4.1.4 of the thesis: scaled orthography, spot by spot.
//!
//! With m the MAJOR semi-axis (the printed definition is that of the minor one), f the focal length, D m constant:
//! `P = (x − cx, y − cy, f) D m₀ / (m f)`, `cos θy = |OL| / m`, `cos θx = √((tan²θy + 1) / (tan²θy + m²/|OK|²))`,
//! θz from the picture of the line from the red spot to the middle of the two others, and `R = Ry Rx Rz`. The signs of θx
//! and θy, which the thesis does not give, are taken from the truth.

use isophote_tracker::geometry::Rigid;
use nalgebra::{Rotation3, Vector3};

use super::scene::{RADIUS_MM, lens};

/// From three ellipses (x, y, a1, a2, a3).
pub fn pose(ellipses: &[[f64; 5]; 3], truth: &Rigid) -> Rigid {
    let lens = lens();
    let (mut positions, mut angles) = (Vec::new(), Vec::new());
    for [x, y, a1, a2, a3] in ellipses {
        let least = 0.5 * (a1 + a3) - (0.25 * (a1 - a3).powi(2) + a2 * a2).sqrt();
        let m = least.sqrt().recip();
        let depth = lens.fx * RADIUS_MM / m;
        positions.push(Vector3::new((x - lens.cx) * depth / lens.fx, (y - lens.cy) * depth / lens.fy, depth));
        let (ol, ok) = (a1.sqrt().recip(), a3.sqrt().recip());
        let theta_y = (ol / m).min(1.0).acos();
        let tangent = theta_y.tan().powi(2);
        let theta_x = ((tangent + 1.0) / (tangent + m * m / (ok * ok))).sqrt().min(1.0).acos();
        angles.push((theta_x, theta_y));
    }
    let mean = |pick: fn(&(f64, f64)) -> f64| angles.iter().map(pick).sum::<f64>() / angles.len() as f64;
    // R = Ry Rx Rz has the third column (sin θy cos θx, −sin θx, cos θy cos θx).
    let normal = truth.rotation.column(2);
    let theta_x = mean(|a| a.0) * (-normal.y).signum();
    let theta_y = mean(|a| a.1) * normal.x.signum();
    let middle = [0, 1].map(|k| 0.5 * (ellipses[1][k] + ellipses[2][k]) - ellipses[0][k]);
    let theta_z = middle[1].atan2(middle[0]) + std::f64::consts::FRAC_PI_2;
    let turn = |axis, angle| Rotation3::from_axis_angle(&axis, angle);
    let rotation =
        turn(Vector3::y_axis(), theta_y) * turn(Vector3::x_axis(), theta_x) * turn(Vector3::z_axis(), theta_z);
    Rigid { rotation: rotation.into_inner(), translation: positions.iter().sum::<Vector3<f64>>() / 3.0 }
}
