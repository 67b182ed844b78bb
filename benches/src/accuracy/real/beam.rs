//! Photographs of laser beams: the effect of clipping on size and brightness, and the radius by distance.

use std::fmt::Write;
use std::sync::Arc;

use isophote_jit::Window;
use isophote_tracker::{Compiled, Frame};
use nalgebra::{Matrix3, Vector3};

use super::fitted::{Fitted, Seen, axes, compiled, fit};
use super::frames::{exposed, pictures};
use crate::accuracy::summary::median;

/// Shares of the beam's area (inside 1/e²) at the limit.
const SHARES: [f64; 4] = [0.05, 0.1, 0.25, 0.4];
/// Documents fitted to the clipped beams.
const DOCUMENTS: [&str; 2] = ["gaussian", "laser-beam"];

/// A window twice as wide as the beam, to save time.
fn around(fitted: &Fitted, frame: &Frame) -> Window {
    let half = (2.0 * axes(fitted)[0]).ceil();
    let span = |at: f64, side: usize| {
        let first = (at - half).max(0.0) as usize;
        (first, ((at + half) as usize).min(side - 1) - first + 1)
    };
    let ((x, width), (y, height)) = (span(fitted["bx"], frame.width()), span(fitted["by"], frame.rows()));
    Window { x, y, width, height, ..Window::whole(1, 1) }
}

fn profile(fitted: &Fitted, s: f64) -> f64 {
    (-2.0 * s.powf(fitted.get("n").copied().unwrap_or(1.0))).exp()
}

/// A cold fit of an 8-bit frame.
fn fresh(document: &Arc<Compiled>, frame: &Frame, window: Option<Window>) -> Option<Seen> {
    fit(document, frame, window, 255.0, &Fitted::new())
}

/// Differences of a clipped beam's fit from that of the photograph.
struct Drift {
    size: f64,
    brightness: f64,
    centre_px: f64,
    is_tracked: bool,
}

/// The table of clipped beams, by document: medians and the worst over the unclipped photographs.
pub fn clipped() -> String {
    let mut text = String::from(
        "| of the beam's area at 255 | document | beams | `tracking` | size error: median, worst, % | brightness error: median, worst, % | centre: median, px |\n\
         |---|---|---|---|---|---|---|\n",
    );
    let photographs = pictures("laser");
    let gaussian = compiled(&crate::text("gaussian"));
    for name in DOCUMENTS {
        let document = compiled(&crate::text(name));
        let whole: Vec<_> = photographs
            .iter()
            .filter(|(_, frame)| {
                (0..frame.width() * frame.rows())
                    .all(|i| frame.plane_view(0).pixel(i % frame.width(), i / frame.width()) < 255.0)
            })
            .filter_map(|(_, frame)| {
                let window = around(&fresh(&gaussian, frame, None)?.fitted, frame);
                Some((frame, window, fresh(&document, frame, Some(window))?.fitted))
            })
            .collect();
        for share in SHARES {
            let drifts: Vec<Drift> = whole
                .iter()
                .filter_map(|(frame, window, whole)| {
                    let gain = 255.0 / (whole["v0"] + whole["v1"] * profile(whole, share));
                    let Seen { fitted, is_tracked } = fresh(&document, &exposed(frame, gain), Some(*window))?;
                    let size = (axes(&fitted)[0] * axes(&fitted)[1] / (axes(whole)[0] * axes(whole)[1])).sqrt() - 1.0;
                    let centre_px = (fitted["bx"] - whole["bx"]).hypot(fitted["by"] - whole["by"]);
                    let brightness = fitted["v1"] / (gain * whole["v1"]) - 1.0;
                    Some(Drift { size, brightness, centre_px, is_tracked })
                })
                .collect();
            let both = |pick: fn(&Drift) -> f64| {
                let worst = drifts.iter().map(|drift| pick(drift).abs()).fold(0.0, f64::max);
                format!("{:.1}, {:.1}", 100.0 * median(drifts.iter().map(|d| pick(d).abs())), 100.0 * worst)
            };
            writeln!(
                text,
                "| {:.0} % | {name} | {} of {} | {} | {} | {} | {:.2} |",
                100.0 * share,
                drifts.len(),
                whole.len(),
                drifts.iter().filter(|drift| drift.is_tracked).count(),
                both(|drift| drift.size),
                both(|drift| drift.brightness),
                median(drifts.iter().map(|drift| drift.centre_px))
            )
            .unwrap();
        }
    }
    text
}

/// w² = w₀² + θ² (z − z₀)² is a parabola in z: its coefficients by least squares, and the largest relative misfit of
/// w.
fn hyperbola(points: &[(f64, f64)]) -> Option<(Vector3<f64>, f64)> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (z, w) in points {
        let row = Vector3::new(1.0, z / 100.0, (z / 100.0).powi(2));
        // Equal relative weight for each radius.
        let weight = w.powi(-4);
        normal += row * row.transpose() * weight;
        right += row * (w * w * weight);
    }
    let c = normal.cholesky()?.solve(&right);
    let at = |z: f64| (c[0] + c[1] * z / 100.0 + c[2] * (z / 100.0).powi(2)).sqrt();
    Some((c, points.iter().map(|(z, w)| (w / at(*z) - 1.0).abs()).fold(0.0, f64::max)))
}

/// The table of the two series with distances in their file names.
pub fn caustic() -> String {
    let mut text = String::from(
        "| series | axis | `tracking` | radius by distance in mm, px | waist, px | at, mm | largest misfit of a hyperbola, % |\n|---|---|---|---|---|---|---|\n",
    );
    let (document, gaussian) = (compiled(&crate::text("laser-beam")), compiled(&crate::text("gaussian")));
    for series in ["k", "t"] {
        let head = format!("{series}-");
        let mut tracked = 0;
        let radii: Vec<(f64, [f64; 2])> = pictures("laser")
            .iter()
            .filter_map(|(name, frame)| {
                let z: f64 = name.strip_prefix(&head)?.strip_suffix("mm")?.parse().ok()?;
                let window = around(&fresh(&gaussian, frame, None)?.fitted, frame);
                let Seen { fitted, is_tracked } = fresh(&document, frame, Some(window))?;
                tracked += usize::from(is_tracked);
                // Radii along x and y, from the extent of the outline: they are comparable between images.
                let [a1, a2, a3] = [fitted["a1"], fitted["a2"], fitted["a3"]];
                let determinant = a1 * a3 - a2 * a2;
                Some((z, [(a3 / determinant).sqrt(), (a1 / determinant).sqrt()]))
            })
            .collect();
        for (axis, name) in ["x", "y"].into_iter().enumerate() {
            let points: Vec<(f64, f64)> = radii.iter().map(|(z, w)| (*z, w[axis])).collect();
            let Some((c, misfit)) = hyperbola(&points) else { continue };
            let z0 = -c[1] / (2.0 * c[2]);
            let list: Vec<String> = points.iter().map(|(z, w)| format!("{z}: {w:.1}")).collect();
            writeln!(
                text,
                "| {series} | {name} | {tracked} of {} | {} | {:.1} | {:.0} | {:.1} |",
                points.len(),
                list.join(", "),
                (c[0] - c[2] * z0 * z0).sqrt(),
                100.0 * z0,
                100.0 * misfit
            )
            .unwrap();
        }
    }
    text
}
