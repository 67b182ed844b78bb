//! The moving box: four dots and a big circle on a plane, 60 frames of a camera that clips at 253.
//!
//! The dots define coordinates of the plane in which the big circle is at rest. Its apparent motion is error: the rms,
//! and the frame-to-frame noise. The centre of a circle's image is not the image of its centre: the ellipse is mapped
//! to the plane by its conic, and its centre taken there. This requires that the dots form a parallelogram.

use std::fmt::Write;

use isophote_jit::Window;
use isophote_tracker::Frame;
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3};

use super::fitted::{Fitted, axes, compiled, fit};
use super::frames::pictures;

/// Positions of the dots and the circle in the first frame, px, and half the sides of their windows.
const FIRST: [([f64; 2], usize); 5] =
    [([86.0, 179.0], 18), ([216.0, 167.0], 18), ([243.0, 248.0], 18), ([93.0, 266.0], 18), ([160.0, 213.0], 46)];
/// The dots in plane coordinates.
const CORNERS: [[f64; 2]; 4] = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
/// The camera's limit.
const LIMIT: f64 = 253.0;
/// The lens' centre, px, and the unit length of its distortion.
const MIDDLE: [f64; 2] = [191.5, 143.5];
const FOCAL_PX: f64 = 580.0;

/// An ellipse: centre and A.
#[derive(Clone, Copy, Debug)]
struct Ellipse {
    centre: Vector2<f64>,
    shape: Matrix2<f64>,
}

/// Definition of a circle's position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Centres {
    /// The centre of its image.
    OfEllipses,
    /// The image of its centre.
    OfCircles,
}

/// Results of the sequence.
struct Consistency {
    /// Frames in which all five were found.
    frames: usize,
    /// rms per coordinate, px.
    rms_px: f64,
    /// Frame-to-frame noise per coordinate, px.
    noise_px: f64,
    /// Distortion that minimises the rms; 0 if not fitted.
    k1: f64,
}

/// Fits all five in every frame with a document, accepting every fit; also counts those tracked with default options.
fn follow(document: &str, frames: &[(String, Frame)]) -> (Vec<Option<[Ellipse; 5]>>, usize) {
    let document = compiled(&crate::text(document));
    let mut places: [([f64; 2], Fitted); 5] = FIRST.map(|(place, _)| (place, Fitted::new()));
    let mut tracked = 0;
    let one = |frame: &Frame| {
        let mut all = Vec::new();
        for (i, (place, start)) in places.iter_mut().enumerate() {
            let half = FIRST[i].1;
            let first = |at: f64, side: usize| (at.round().max(half as f64) as usize - half).min(side - 2 * half);
            let [width, height] = [(2 * half).min(frame.width()), (2 * half).min(frame.rows())];
            let (x, y) = (first(place[0], frame.width()), first(place[1], frame.rows()));
            let window = Window { x, y, width, height, ..Window::whole(1, 1) };
            let mut fit = |start: &Fitted| {
                let seen = fit(&document, frame, Some(window), LIMIT, start)?;
                let seen = Some(seen).filter(|seen| axes(&seen.fitted)[0] < half as f64)?;
                tracked += usize::from(seen.is_tracked);
                Some(seen.fitted)
            };
            let fitted = fit(start).or_else(|| fit(&Fitted::new()));
            if let Some(fitted) = fitted {
                *place = [fitted["bx"], fitted["by"]];
                all.push(Ellipse {
                    centre: Vector2::new(fitted["bx"], fitted["by"]),
                    shape: Matrix2::new(fitted["a1"], fitted["a2"], fitted["a2"], fitted["a3"]),
                });
                *start = fitted;
            }
        }
        <[Ellipse; 5]>::try_from(all).ok()
    };
    let found = frames.iter().map(|(_, frame)| frame).map(one).collect();
    (found, tracked)
}

impl Ellipse {
    /// Removes the lens' distortion, to first order about the centre.
    fn undistorted(&self, k1: f64) -> Ellipse {
        let middle = Vector2::from(MIDDLE);
        let d = (self.centre - middle) / FOCAL_PX;
        let factor = 1.0 + k1 * d.norm_squared();
        let jacobian = Matrix2::identity() * factor + d * d.transpose() * (2.0 * k1);
        let inverse = jacobian.try_inverse().unwrap();
        Ellipse { centre: middle + (self.centre - middle) * factor, shape: inverse.transpose() * self.shape * inverse }
    }

    /// (x, y, 1) C (x, y, 1)ᵀ = 0 on the outline.
    fn conic(&self) -> Matrix3<f64> {
        let (a, b) = (self.shape, self.shape * self.centre);
        Matrix3::new(a.m11, a.m12, -b.x, a.m12, a.m22, -b.y, -b.x, -b.y, self.centre.dot(&b) - 1.0)
    }

    /// The circle's centre in the plane that `to_image` maps to the image: the pole of the line at infinity.
    fn centre_in(&self, to_image: &Matrix3<f64>) -> Vector2<f64> {
        let conic = to_image.transpose() * self.conic() * to_image;
        let a = Matrix2::new(conic.m11, conic.m12, conic.m21, conic.m22);
        -(a.try_inverse().unwrap() * Vector2::new(conic.m13, conic.m23))
    }
}

/// The homography from the plane to the image that maps `CORNERS` to four points.
fn homography(to: [Vector2<f64>; 4]) -> Matrix3<f64> {
    let (mut m, mut right) = (SMatrix::<f64, 8, 8>::zeros(), SVector::<f64, 8>::zeros());
    for (i, ([u, v], image)) in CORNERS.into_iter().zip(to).enumerate() {
        for (axis, value) in [image.x, image.y].into_iter().enumerate() {
            let row = 2 * i + axis;
            for (column, entry) in [u, v, 1.0].into_iter().enumerate() {
                m[(row, 3 * axis + column)] = entry;
            }
            (m[(row, 6)], m[(row, 7)], right[row]) = (-value * u, -value * v, value);
        }
    }
    let h = m.lu().solve(&right).unwrap();
    Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0)
}

fn mapped(h: &Matrix3<f64>, place: Vector2<f64>) -> Vector2<f64> {
    let p = h * Vector3::new(place.x, place.y, 1.0);
    Vector2::new(p.x / p.z, p.y / p.z)
}

/// The homography of one frame, with dots as circles: the images of their centres are not the centres of their
/// ellipses.
fn plane(dots: &[Ellipse]) -> Matrix3<f64> {
    let mut centres: [Vector2<f64>; 4] = std::array::from_fn(|i| dots[i].centre);
    for _ in 0..4 {
        let h = homography(centres);
        centres = std::array::from_fn(|i| mapped(&h, dots[i].centre_in(&h)));
    }
    homography(centres)
}

/// Errors of the big circle in px of the image, frame by frame.
fn errors(found: &[Option<[Ellipse; 5]>], centres: Centres, k1: f64) -> Vec<Option<Vector2<f64>>> {
    let planes: Vec<Option<(Matrix3<f64>, Vector2<f64>)>> = found
        .iter()
        .map(|all| {
            let all = all.as_ref()?.map(|ellipse| ellipse.undistorted(k1));
            Some(match centres {
                Centres::OfEllipses => {
                    let h = homography(std::array::from_fn(|i| all[i].centre));
                    (h, mapped(&h.try_inverse()?, all[4].centre))
                }
                Centres::OfCircles => {
                    let h = plane(&all[..4]);
                    (h, all[4].centre_in(&h))
                }
            })
        })
        .collect();
    let count = planes.iter().flatten().count() as f64;
    let mean = planes.iter().flatten().map(|(_, place)| *place).sum::<Vector2<f64>>() / count;
    planes.iter().map(|one| one.map(|(h, place)| mapped(&h, place) - mapped(&h, mean))).collect()
}

fn rms(errors: impl Iterator<Item = Vector2<f64>>) -> f64 {
    let (sum, count) = errors.fold((0.0, 0.0), |(sum, count), e| (sum + e.norm_squared() / 2.0, count + 1.0));
    (sum / count).sqrt()
}

/// Evaluates the sequence, fitting the lens' distortion by minimising the rms if `distorted`.
fn consistency(found: &[Option<[Ellipse; 5]>], centres: Centres, distorted: bool) -> Consistency {
    let cost = |k1: f64| rms(errors(found, centres, k1).into_iter().flatten());
    let mut k1 = 0.0;
    if distorted {
        let mut step = 0.4;
        while step > 1e-4 {
            let best = [k1 - step, k1, k1 + step].into_iter().min_by(|a, b| cost(*a).total_cmp(&cost(*b))).unwrap();
            if best == k1 { step /= 2.0 } else { k1 = best }
        }
    }
    let all = errors(found, centres, k1);
    let steps = all.windows(2).filter_map(|pair| Some((pair[1]? - pair[0]?) / 2f64.sqrt()));
    Consistency { frames: all.iter().flatten().count(), rms_px: cost(k1), noise_px: rms(steps), k1 }
}

/// The table of the sequence.
pub fn table() -> String {
    let frames = pictures("visp-mire2");
    let (found, tracked) = follow("bright-disc", &frames);
    assert!(found.iter().any(Option::is_some), "not one frame in which all five were found");
    let mut text = format!(
        "`tracking` by default options: {tracked} of {}.\n\n\
         | a circle's place | lens distortion | frames | planar residual, rms, px | frame to frame, px | k₁ |\n|---|---|---|---|---|---|\n",
        FIRST.len() * frames.len()
    );
    for (centres, place) in [(Centres::OfEllipses, "centre of its image"), (Centres::OfCircles, "image of its centre")]
    {
        for (distorted, lens) in [(false, "none"), (true, "one term, fitted")] {
            let c = consistency(&found, centres, distorted);
            writeln!(text, "| {place} | {lens} | {} | {:.4} | {:.4} | {:.3} |", c.frames, c.rms_px, c.noise_px, c.k1)
                .unwrap();
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A disc seen through a homography: the pole gives its centre, the centre of its image does not.
    #[test]
    fn images_of_circle_centres_are_found() {
        let h = homography([[80.0, 90.0], [230.0, 70.0], [260.0, 240.0], [60.0, 200.0]].map(Vector2::from));
        let centre = Vector2::new(0.1, -0.2);
        let circle = Ellipse { centre, shape: Matrix2::identity() / 0.16 };
        let inverse = h.try_inverse().unwrap();
        let image = inverse.transpose() * circle.conic() * inverse;
        let a = Matrix2::new(image.m11, image.m12, image.m21, image.m22);
        let middle = -(a.try_inverse().unwrap() * Vector2::new(image.m13, image.m23));
        let level = Vector3::new(middle.x, middle.y, 1.0).dot(&(image * Vector3::new(middle.x, middle.y, 1.0)));
        let seen = Ellipse { centre: middle, shape: a / -level };
        assert!((seen.centre_in(&h) - centre).norm() < 1e-9);
        assert!((mapped(&inverse, middle) - centre).norm() > 1e-3, "no bias to be seen");
        for corner in CORNERS.map(Vector2::from) {
            assert!((mapped(&inverse, mapped(&h, corner)) - corner).norm() < 1e-9);
        }
    }
}
