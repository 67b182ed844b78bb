//! Overlay pictures: a two-dimensional frame in gray, the fitted contours and centres in colour, as r, g, b bytes.
//!
//! A contour is s = dᵀ A d = 1, d = [x, y] − centre; a pixel's distance to it is |√s − 1| / |∇√s| to first order.

use isophote_jit::{PixelFormat, PlaneView, Slices, Window};
use isophote_tracker::{Contour, Frame};

const CONTOUR: [f64; 3] = [255.0, 150.0, 0.0];
const CENTRE: [f64; 3] = [0.0, 220.0, 255.0];
const LOST: [f64; 3] = [255.0, 0.0, 60.0];
/// Line width and arm length of a cross, in pixels of a picture of up to [`SIDE_PX`], scaled in proportion for larger
/// ones; small contours have shorter arms.
const LINE_PX: f64 = 1.6;
const ARM_PX: f64 = 7.0;
const ARM_LEAST_PX: f64 = 2.5;
/// Pictures are magnified (nearest neighbour) up to about this side, px.
const SIDE_PX: usize = 960;
/// Largest magnification.
const MAGNIFICATION_MAX: usize = 8;

/// A picture: r, g, b bytes, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct OverlayPicture {
    /// Pixels of a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// 3 · width · height.
    pub rgb: Vec<u8>,
}

/// Draws `part` of a frame, magnified. `white` is the pixel value shown as white. `None` marks a lost target with a
/// red frame.
pub fn draw(plane: &PlaneView, part: Window, white: f64, contours: Option<&[Contour]>) -> OverlayPicture {
    let scale = (SIDE_PX / part.width.max(part.height).max(1)).clamp(1, MAGNIFICATION_MAX);
    let (width, height) = (part.width * scale, part.height * scale);
    // Large pictures are viewed reduced to the screen, so the pen is broader.
    let pen = (width.max(height) as f64 / SIDE_PX as f64).max(1.0);
    let mut picture = OverlayPicture { width, height, rgb: Vec::with_capacity(3 * width * height) };
    for row in 0..height {
        // Position of this picture row in the frame; pixel centres are at whole numbers.
        let y = part.y as f64 + (row as f64 + 0.5) / scale as f64 - 0.5;
        for column in 0..width {
            let x = part.x as f64 + (column as f64 + 0.5) / scale as f64 - 0.5;
            let gray = plane.pixel(part.x + column / scale, part.y + row / scale) / white * 255.0;
            let mut colour = [if gray.is_finite() { gray.clamp(0.0, 255.0) } else { 0.0 }; 3];
            for contour in contours.unwrap_or_default() {
                blend(&mut colour, CONTOUR, coverage(distance(contour, x, y) * scale as f64, pen));
                blend(&mut colour, CENTRE, cross_coverage(contour, x, y, scale as f64, pen));
            }
            if contours.is_none() && (row < 3 || column < 3 || row + 3 >= height || column + 3 >= width) {
                colour = LOST;
            }
            picture.rgb.extend(colour.map(|c| c.round() as u8));
        }
    }
    picture
}

/// Distance to the contour, px; infinite where there is none (no shape, or not an ellipse).
fn distance(contour: &Contour, x: f64, y: f64) -> f64 {
    let Some([[a1, a2], [_, a3]]) = contour.shape else { return f64::INFINITY };
    let (dx, dy) = (x - contour.centre[0], y - contour.centre[1]);
    // ∇√s = A d / √s.
    let (gx, gy) = (a1 * dx + a2 * dy, a2 * dx + a3 * dy);
    let root = (dx * gx + dy * gy).sqrt();
    let distance = (root - 1.0).abs() * root / gx.hypot(gy);
    let is_ellipse = a1 > 0.0 && a1 * a3 > a2 * a2;
    if is_ellipse && distance.is_finite() { distance } else { f64::INFINITY }
}

/// How much of a picture pixel the centre's cross covers, 0…1.
fn cross_coverage(contour: &Contour, x: f64, y: f64, scale: f64, pen: f64) -> f64 {
    let (dx, dy) = ((x - contour.centre[0]).abs() * scale, (y - contour.centre[1]).abs() * scale);
    // The larger eigenvalue of A is at most its trace: a length certainly inside the contour.
    let inside = contour.shape.map_or(f64::INFINITY, |[[a1, _], [_, a3]]| scale / (a1 + a3).sqrt());
    let length = (0.5 * inside).clamp(ARM_LEAST_PX * pen, ARM_PX * pen);
    let arm = |along: f64, across: f64| coverage(across, pen) * (length + 0.5 - along).clamp(0.0, 1.0);
    let cover = arm(dx, dy).max(arm(dy, dx));
    if cover.is_nan() { 0.0 } else { cover }
}

/// How much of a pixel a line covers at `distance` pixels from its middle; `pen` multiplies the line width.
fn coverage(distance: f64, pen: f64) -> f64 {
    (LINE_PX * pen / 2.0 + 0.5 - distance).clamp(0.0, 1.0)
}

fn blend(colour: &mut [f64; 3], over: [f64; 3], share: f64) {
    for (c, o) in colour.iter_mut().zip(over) {
        *c += share * (o - *c);
    }
}

/// The pixel value shown as white: the maximum of a byte (and of the luma of bytes), else the frame's brightest pixel.
pub fn white(frame: &Frame) -> f64 {
    let plane = frame.plane_view(0);
    match plane.format() {
        PixelFormat::U8 => 255.0,
        PixelFormat::F32 if frame.largest == Some(255.0) => 255.0,
        _ => {
            let pixels = (0..plane.height()).flat_map(|y| (0..plane.width()).map(move |x| plane.pixel(x, y)));
            pixels.filter(|v| v.is_finite()).fold(f64::MIN_POSITIVE, f64::max)
        }
    }
}

/// `window` with a margin, inside a frame of `width` × `height`; the whole frame without a window.
pub fn part_to_draw(window: Option<Window>, width: usize, height: usize) -> Window {
    let whole = Window::whole(width, height);
    let Some(window) = window.and_then(|window| window.clipped(width, height)) else { return whole };
    let margin = (window.width.max(window.height) / 8).max(4);
    let (x, y) = (window.x.saturating_sub(margin), window.y.saturating_sub(margin));
    let (right, bottom) = (window.x + window.width + margin, window.y + window.height + margin);
    Window { x, y, width: right.min(width) - x, height: bottom.min(height) - y, slices: Slices::ONE }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn contour(centre: [f64; 2], shape: Option<[[f64; 2]; 2]>) -> Contour {
        Contour { target: "0".into(), centre, shape }
    }

    /// The distance to an ellipse of semi-axes 60 × 30 turned by 0.5 rad, on points moved along its normal.
    #[test]
    fn contour_distance_is_right_to_first_order() {
        let (m, n, angle) = (60.0f64, 30.0f64, 0.5f64);
        let (c, s) = (angle.cos(), angle.sin());
        let (p, q) = (m.powi(-2), n.powi(-2));
        let (a1, a2, a3) = (c * c * p + s * s * q, c * s * (p - q), s * s * p + c * c * q);
        let contour = contour([100.25, 80.75], Some([[a1, a2], [a2, a3]]));
        for i in 0..64 {
            let t = f64::from(i) * 0.1;
            let (u, v) = (m * t.cos(), n * t.sin());
            let (nu, nv) = (t.cos() / m, t.sin() / n);
            let length = nu.hypot(nv);
            for offset in [-0.8, 0.0, 0.8] {
                let (u, v) = (u + offset * nu / length, v + offset * nv / length);
                let (x, y) = (100.25 + c * u - s * v, 80.75 + s * u + c * v);
                let distance = distance(&contour, x, y);
                assert!((distance - f64::abs(offset)).abs() < 0.03, "{t} {offset}: {distance}");
            }
        }
    }

    #[test]
    fn non_ellipses_are_not_drawn() {
        let matrix = |a1, a2, a3| Some([[a1, a2], [a2, a3]]);
        for shape in [None, matrix(1.0, 2.0, 1.0), matrix(-1.0, 0.0, -1.0), matrix(f64::NAN, 0.0, 1.0)] {
            assert_eq!(distance(&contour([2.0, 2.0], shape), 3.0, 2.0), f64::INFINITY);
        }
    }

    #[test]
    fn centres_get_a_cross_and_lost_targets_a_red_frame() {
        let pixels = vec![100u8; 40 * 30];
        let plane = PlaneView::new(PixelFormat::U8, &pixels, 40, 30, 40, 1).unwrap();
        let part = part_to_draw(None, 40, 30);
        let contour = contour([10.0625, 20.0625], None);
        let picture = draw(&plane, part, 255.0, Some(&[contour]));
        assert_eq!((picture.width, picture.height), (320, 240));
        let at =
            |picture: &OverlayPicture, x: usize, y: usize| picture.rgb[3 * (y * picture.width + x)..][..3].to_vec();
        assert_eq!(at(&picture, 84, 164), CENTRE.map(|c| c as u8));
        assert_eq!(at(&picture, 200, 100), [100, 100, 100]);
        let lost = draw(&plane, part, 255.0, None);
        assert_eq!(at(&lost, 0, 0), LOST.map(|c| c as u8));
        assert_eq!(at(&lost, 160, 120), [100, 100, 100]);
    }

    #[test]
    fn large_pictures_get_a_broader_pen() {
        let pixels = vec![100u8; 3840 * 8];
        let plane = PlaneView::new(PixelFormat::U8, &pixels, 3840, 8, 3840, 1).unwrap();
        let picture = draw(&plane, part_to_draw(None, 3840, 8), 255.0, Some(&[contour([1920.0, 4.0], None)]));
        let at = |x: usize| picture.rgb[3 * (4 * 3840 + x)..][..3].to_vec();
        assert_eq!((at(1945), at(1952)), (CENTRE.map(|c| c as u8).to_vec(), vec![100; 3]));
    }

    #[test]
    fn the_part_has_a_margin_inside_the_frame() {
        let window = |x, y, width, height| Window { x, y, width, height, slices: Slices::ONE };
        assert_eq!(part_to_draw(Some(window(50, 60, 32, 16)), 640, 480), window(46, 56, 40, 24));
        assert_eq!(part_to_draw(Some(window(0, 470, 32, 64)), 640, 480), window(0, 466, 36, 14));
        assert_eq!(part_to_draw(Some(window(700, 0, 5, 5)), 640, 480), window(0, 0, 640, 480));
    }
}
