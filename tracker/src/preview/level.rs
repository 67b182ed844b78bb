//! The inside of a target's contour: its domain, else where it exceeds half its height over the background, bright or dark.

use isophote_jit::Window;
use isophote_symbolic::Model;

use super::contour::{Pixel, Polyline, trace};
use crate::outline::has_domain;
use crate::sight::grey::place_of;

/// Bisections between two pixels: to a thirty-second of a pixel.
const HALVINGS: usize = 5;

/// The contour of a target in one slice, px of the frame. `intensity` is the prediction of the window's pixels.
pub(super) fn contours(
    model: &Model,
    parameters: &[f64],
    constants: &[f64],
    window: Window,
    intensity: &[f32],
) -> Vec<Polyline> {
    let has_domain = has_domain(model);
    let mut lines = match has_domain {
        true => edge_of_domain(model, parameters, constants, window, intensity),
        false => half_maximum(model, parameters, window.width, intensity),
    };
    for point in lines.iter_mut().flatten() {
        *point = [point[0] + window.x as f64, point[1] + window.y as f64];
    }
    lines
}

fn edge_of_domain(
    model: &Model,
    parameters: &[f64],
    constants: &[f64],
    window: Window,
    intensity: &[f32],
) -> Vec<Polyline> {
    let inside: Vec<bool> = intensity.iter().map(|value| !value.is_nan()).collect();
    let (first, coordinates) = (window.first(), model.coordinates().len());
    let holds = |point: [f64; 2]| {
        let place = [first[0] as f64 + point[0], first[1] as f64 + point[1], first[2] as f64, first[3] as f64];
        model.domain_holds(&place[..coordinates], parameters, constants)
    };
    let between = |inner: Pixel, outer: Pixel| {
        let at = |share: f64| std::array::from_fn(|axis| along(inner[axis], outer[axis], share));
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if holds(at(middle)) { low = middle } else { high = middle }
        }
        at(0.5 * (low + high))
    };
    trace(&inside, window.width, &between)
}

fn along(from: usize, to: usize, share: f64) -> f64 {
    from as f64 + (to as f64 - from as f64) * share
}

fn half_maximum(model: &Model, parameters: &[f64], width: usize, intensity: &[f32]) -> Vec<Polyline> {
    let Some((ground, peak)) = height(model, parameters, intensity) else { return Vec::new() };
    let share = |value: f32| (f64::from(value) - ground) / (peak - ground);
    let inside: Vec<bool> = intensity.iter().map(|value| share(*value) >= 0.5).collect();
    let between = |inner: Pixel, outer: Pixel| {
        let at = |pixel: Pixel| share(intensity[pixel[1] * width + pixel[0]]);
        let (high, low) = (at(inner), at(outer));
        let way = ((high - 0.5) / (high - low)).clamp(0.0, 1.0);
        std::array::from_fn(|axis| along(inner[axis], outer[axis], way))
    };
    trace(&inside, width, &between)
}

/// The background, and the value farthest from it. Without the role the background is the median of the prediction.
fn height(model: &Model, parameters: &[f64], intensity: &[f32]) -> Option<(f64, f64)> {
    let role = model.roles().first().and_then(|roles| roles.background);
    let ground = match role {
        Some(role) => parameters[role.index()],
        None => {
            let mut sorted = intensity.to_vec();
            let middle = sorted.len() / 2;
            f64::from(*sorted.select_nth_unstable_by(middle, f32::total_cmp).1)
        }
    };
    let peak = farthest(intensity, ground).map(|(_, value)| value)?;
    (peak != ground && peak.is_finite() && ground.is_finite()).then_some((ground, peak))
}

/// The value farthest from another one, and its index.
fn farthest(intensity: &[f32], ground: f64) -> Option<(usize, f64)> {
    let known = intensity.iter().enumerate().filter(|(_, value)| value.is_finite());
    let numbers = known.map(|(i, value)| (i, f64::from(*value)));
    numbers.max_by(|a, b| (a.1 - ground).abs().total_cmp(&(b.1 - ground).abs()))
}

/// The pixel of a window, x, y of the frame, whose prediction is farthest from the background: the position of a target
/// without a centre.
pub(super) fn peak(model: &Model, parameters: &[f64], window: Window, intensity: &[f32]) -> Option<[f64; 2]> {
    let role = model.roles().first().and_then(|roles| roles.background);
    let ground = role.map_or(0.0, |role| parameters[role.index()]);
    let [x, y, ..] = place_of(farthest(intensity, ground)?.0, window.size());
    Some([x + window.x as f64, y + window.y as f64])
}
