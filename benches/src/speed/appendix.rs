//! The thesis' appendix A.1 as a contender, and a reference for its sums.

use super::contenders::{C, folder};
use super::foreign::Compiled;

/// Compiled with its pixels in columns, as in the thesis, or in rows.
pub fn compiled(rows: bool) -> Result<Compiled, String> {
    let file = if rows { "appendix_a1_rows.c" } else { "appendix_a1.c" };
    let mut command = C.to_vec();
    command.push("-march=native");
    if rows {
        command.push("-DROWS");
    }
    Compiled::new(&folder(), file, include_str!("appendix_a1.c"), &command)
}

/// The picture in column-major order.
pub fn columns(pixels: &[f32], width: usize) -> Vec<f32> {
    (0..width).flat_map(|x| pixels.iter().skip(x).step_by(width).copied()).collect()
}

/// The pixels that its loops use: whole columns from the row's first to its last.
fn taken(p: &[f64; 7], width: usize, height: usize) -> Vec<(usize, usize)> {
    let [a1, a2, a3, bx, by, ..] = *p;
    let mut taken = Vec::new();
    for row in 0..height {
        let y = row as f64 - by;
        let discriminant = a2 * a2 * y * y - a1 * (a3 * y * y - 1.0);
        if discriminant >= 0.0 {
            let ends = [-1.0, 1.0].map(|sign| (-a2 * y + sign * discriminant.sqrt()) / a1 + bx + 1.0);
            let (start, end) = (ends[0].floor().max(0.0) as usize, (ends[1].ceil() as usize).min(width));
            taken.extend((start..end).map(|x| (x, row)));
        }
    }
    taken
}

/// Gradient and Hessian of Σ r²/f over a1, a2, a3 by central differences in f64, and the number of pixels.
pub fn referee(pixels: &[f32], width: usize, height: usize, p: &[f64; 7]) -> ([f64; 9], u64) {
    let taken = taken(p, width, height);
    let value = |shift: [f64; 3]| -> f64 {
        let (a1, a2, a3) = (p[0] + shift[0], p[1] + shift[1], p[2] + shift[2]);
        let term = |(x, y): &(usize, usize)| {
            let (dx, dy) = (*x as f64 - p[3], *y as f64 - p[4]);
            let s = a1 * dx * dx + 2.0 * a2 * dx * dy + a3 * dy * dy;
            let (over_f, pixel) = ((1.0 + s) * (1.0 + s * s / 2.0), f64::from(pixels[y * width + x]));
            let t = (pixel - p[5]) * over_f - p[6];
            if pixel < 255.0 { t * t / over_f } else { 0.0 }
        };
        taken.iter().map(term).sum()
    };
    let step = [p[0] * 1e-3, (p[0] * p[2]).sqrt() * 1e-3, p[2] * 1e-3];
    let at = |i: usize, a: f64, j: usize, b: f64| {
        let mut shift = [0.0; 3];
        shift[i] += a * step[i];
        shift[j] += b * step[j];
        value(shift)
    };
    let mut found = [0.0; 9];
    for i in 0..3 {
        found[i] = (at(i, 1.0, i, 0.0) - at(i, -1.0, i, 0.0)) / (2.0 * step[i]);
    }
    for (place, (i, j)) in [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].into_iter().enumerate() {
        let corners = at(i, 1.0, j, 1.0) - at(i, 1.0, j, -1.0) - at(i, -1.0, j, 1.0) + at(i, -1.0, j, -1.0);
        found[3 + place] = corners / (4.0 * step[i] * step[j]);
    }
    (found, taken.len() as u64)
}
