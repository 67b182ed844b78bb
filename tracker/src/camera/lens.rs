//! Lens projection from directions to pixels and back, by OpenCV's models.
//!
//! A direction `(X, Y, Z)` in the camera's frame (x to the right, y down, z forward) has normalised coordinates
//! `(x, y) = (X, Y) / Z`. The lens moves them to `(x', y')`, and `u = fx x' + cx`, `v = fy y' + cy`.
//! With r² = x² + y²:
//! ```text
//! plumb_bob, rational:  x' = x D + 2 p1 x y + p2 (r² + 2 x²),   D = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)
//!                       y' = y D + p1 (r² + 2 y²) + 2 p2 x y
//! fisheye:              (x', y') = (x, y) θ' / r,   θ = atan r,   θ' = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)
//! ```
//! Source: the camera models of OpenCV's modules calib3d and fisheye; Brown 1966; Kannala and Brandt 2006.

use isophote_frame::{NUMBER_MAX, plain};
use nalgebra::{DMatrix, Vector2};

use super::{Distortion, Intrinsics};
use crate::least_squares::{NormalEquations, least_squares};

/// Why intrinsics are invalid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum IntrinsicsError {
    /// Wrong number of coefficients.
    #[error("the lens model `{model}` has {wanted} coefficients, not {found}")]
    Coefficients {
        /// Name of the model.
        model: &'static str,
        /// The expected number, in words.
        wanted: &'static str,
        /// The given number.
        found: usize,
    },
    /// Invalid covariance.
    #[error(
        "the covariance of the intrinsics {fault}; it has 4 rows (fx, fy, cx, cy) or {all} (with the coefficients), as many numbers in each, and is symmetric without negative variances"
    )]
    Covariance {
        /// The fault.
        fault: &'static str,
        /// Rows when the coefficients are included.
        all: usize,
    },
    /// A number out of range.
    #[error("`{name}` = {} of the intrinsics {wanted}", plain(*value))]
    Number {
        /// The key.
        name: &'static str,
        /// As given.
        value: f64,
        /// The valid range.
        wanted: &'static str,
    },
}

/// Largest focal length and coordinate of the principal point, px.
const PIXELS_MAX: f64 = 1e9;
/// Largest coefficient. Narrow lenses have large ones, which multiply high powers of small angles.
const COEFFICIENT_MAX: f64 = 1e12;
/// Number of figures without coefficients: fx, fy, cx, cy.
const FIGURES: usize = 4;
/// Tolerance for the rounding of a covariance in a document.
const ROUNDING: f64 = 1e-6;
/// The inverse has converged when the next step would improve normalised coordinates by less than this.
const NEAR: f64 = 1e-13;
/// Largest error of an accepted inverse, in normalised coordinates.
const NEAR_ENOUGH: f64 = 1e-9;

/// Coefficients by name; missing ones are 0.
#[derive(Clone, Copy, Debug, Default)]
struct Brown {
    k: [f64; 6],
    p: [f64; 2],
}

/// A mapped point and its Jacobian.
type Mapped = ([f64; 2], [[f64; 2]; 2]);

impl Distortion {
    /// The name in documents.
    pub fn name(self) -> &'static str {
        match self {
            Distortion::None => "none",
            Distortion::PlumbBob => "plumb_bob",
            Distortion::Rational => "rational",
            Distortion::Fisheye => "fisheye",
        }
    }
}

impl Intrinsics {
    /// Checks ranges and the number of coefficients.
    ///
    /// # Errors
    /// For the first invalid figure.
    pub fn check(&self) -> Result<(), IntrinsicsError> {
        for (name, value) in [("fx", self.fx), ("fy", self.fy)] {
            if !(f64::MIN_POSITIVE..=PIXELS_MAX).contains(&value) {
                let wanted = "must be a positive number of pixels, 1e9 at most";
                return Err(IntrinsicsError::Number { name, value, wanted });
            }
        }
        for (name, value) in [("cx", self.cx), ("cy", self.cy)] {
            if !(-PIXELS_MAX..=PIXELS_MAX).contains(&value) {
                return Err(IntrinsicsError::Number { name, value, wanted: "must be from -1e9 to 1e9" });
            }
        }
        if let Some(&value) = self.coefficients.iter().find(|c| !(-COEFFICIENT_MAX..=COEFFICIENT_MAX).contains(*c)) {
            let wanted = "must be finite numbers, from -1e12 to 1e12";
            return Err(IntrinsicsError::Number { name: "coefficients", value, wanted });
        }
        let found = self.coefficients.len();
        let (wanted, fits) = match self.model {
            Distortion::None => ("no", found == 0),
            Distortion::PlumbBob => ("4 or 5 (k1 k2 p1 p2 k3)", found == 4 || found == 5),
            Distortion::Rational => ("8 (k1 k2 p1 p2 k3 k4 k5 k6)", found == 8),
            Distortion::Fisheye => ("4 (k1 k2 k3 k4)", found == 4),
        };
        if !fits {
            return Err(IntrinsicsError::Coefficients { model: self.model.name(), wanted, found });
        }
        self.check_covariance()
    }

    fn check_covariance(&self) -> Result<(), IntrinsicsError> {
        let Some(rows) = &self.covariance else { return Ok(()) };
        let all = FIGURES + self.coefficients.len();
        let wrong = |fault| Err(IntrinsicsError::Covariance { fault, all });
        let count = rows.len();
        if (count != FIGURES && count != all) || rows.iter().any(|row| row.len() != count) {
            return wrong("has other rows or columns");
        }
        if rows.iter().flatten().any(|entry| !(-NUMBER_MAX..=NUMBER_MAX).contains(entry)) {
            return wrong("has numbers beyond 1e30, or none");
        }
        let matrix = DMatrix::from_fn(count, count, |i, j| rows[i][j]);
        let largest = matrix.amax();
        if (&matrix - matrix.transpose()).amax() > ROUNDING * largest {
            return wrong("is not symmetric");
        }
        // Scaled to a unit diagonal: variances are in px² and in units of coefficients.
        let scale = matrix.diagonal().map(|entry| if entry > 0.0 { entry.sqrt().recip() } else { 1.0 });
        let least = DMatrix::from_fn(count, count, |i, j| scale[i] * matrix[(i, j)] * scale[j]).symmetric_eigenvalues();
        if least.min() < -ROUNDING { wrong("has a negative variance in some direction") } else { Ok(()) }
    }

    /// A copy with one figure changed: fx, fy, cx, cy, then the coefficients.
    pub(crate) fn nudged(&self, figure: usize, by: f64) -> Intrinsics {
        let mut lens = self.clone();
        let Intrinsics { fx, fy, cx, cy, coefficients, .. } = &mut lens;
        if let Some(value) = [fx, fy, cx, cy].into_iter().chain(coefficients).nth(figure) {
            *value += by;
        }
        lens
    }

    /// A coefficient by its name in the formulas above; 0 when the list is too short for it, `None` when the model has
    /// no such name.
    pub fn coefficient(&self, name: &str) -> Option<f64> {
        const BROWN: [&str; 8] = ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"];
        const FISHEYE: [&str; 4] = ["k1", "k2", "k3", "k4"];
        let names: &[&str] = if self.model == Distortion::Fisheye { &FISHEYE } else { &BROWN };
        let index = names.iter().position(|known| *known == name)?;
        Some(self.coefficients.get(index).copied().unwrap_or(0.0))
    }

    /// The pixel of a direction; `None` behind the camera, and where the distortion folds back.
    pub fn project(&self, direction: [f64; 3]) -> Option<[f64; 2]> {
        let [x, y, z] = direction;
        if z.is_nan() || z <= 0.0 {
            return None;
        }
        Some(self.pixel([x / z, y / z])?.0)
    }

    /// The unit direction of a pixel; `None` where there is none.
    pub fn ray(&self, pixel: [f64; 2]) -> Option<[f64; 3]> {
        let [x, y] = self.normalised(pixel)?;
        let length = (x * x + y * y + 1.0).sqrt();
        Some([x / length, y / length, 1.0 / length])
    }

    /// The pixel of normalised coordinates, and its derivatives (rows u, v; columns x, y).
    pub(crate) fn pixel(&self, at: [f64; 2]) -> Option<Mapped> {
        let (moved, [[xx, xy], [yx, yy]]) = self.distorted(at);
        let upright = xx * yy - xy * yx > 0.0 && xx + yy > 0.0;
        let pixel = [self.fx * moved[0] + self.cx, self.fy * moved[1] + self.cy];
        (upright && pixel.iter().all(|c| c.is_finite()))
            .then_some((pixel, [[self.fx * xx, self.fx * xy], [self.fy * yx, self.fy * yy]]))
    }

    /// Normalised coordinates of a pixel: the distortion inverted by least squares.
    pub(crate) fn normalised(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        let wanted = [(pixel[0] - self.cx) / self.fx, (pixel[1] - self.cy) / self.fy];
        if self.model == Distortion::None {
            return wanted.iter().all(|c| c.is_finite()).then_some(wanted);
        }
        let equations = |at: &Vector2<f64>| {
            let (moved, slopes) = self.distorted((*at).into());
            Some(NormalEquations::of([0, 1].map(|axis| (wanted[axis] - moved[axis], slopes[axis].into(), 1.0))))
        };
        let start = Vector2::from(self.first_guess(wanted)?);
        let found = least_squares(start, NEAR * NEAR, equations, |at, by| at + by)?;
        let at = found.point.into();
        (found.equations.cost <= NEAR_ENOUGH * NEAR_ENOUGH && self.pixel(at).is_some()).then_some(at)
    }

    /// Start of the inverse: the coordinates themselves; for a fisheye those of the equidistant lens.
    fn first_guess(&self, wanted: [f64; 2]) -> Option<[f64; 2]> {
        if self.model != Distortion::Fisheye {
            return Some(wanted);
        }
        let angle = wanted[0].hypot(wanted[1]);
        // Normalised coordinates end at 90°.
        let theta = angle.min(1.4);
        let stretch = if angle > 1e-9 { theta.tan() / angle } else { 1.0 };
        angle.is_finite().then(|| wanted.map(|c| c * stretch))
    }

    /// (x, y) → (x', y') and its derivatives.
    fn distorted(&self, [x, y]: [f64; 2]) -> Mapped {
        let r2 = x * x + y * y;
        // The factor D of (x, y), and its derivative by r².
        let (factor, slope, [p1, p2]) = match self.model {
            Distortion::None => (1.0, 0.0, [0.0; 2]),
            Distortion::Fisheye => {
                let (factor, slope) = self.fisheye(r2);
                (factor, slope, [0.0; 2])
            }
            Distortion::PlumbBob | Distortion::Rational => {
                let Brown { k, p } = self.brown();
                let above = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[2]));
                let below = 1.0 + r2 * (k[3] + r2 * (k[4] + r2 * k[5]));
                let above_slope = k[0] + r2 * (2.0 * k[1] + r2 * 3.0 * k[2]);
                let below_slope = k[3] + r2 * (2.0 * k[4] + r2 * 3.0 * k[5]);
                (above / below, (above_slope - above / below * below_slope) / below, p)
            }
        };
        let moved = [
            x * factor + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * factor + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ];
        let across = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
        let xx = factor + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x;
        let yy = factor + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x;
        (moved, [[xx, across], [across, yy]])
    }

    fn brown(&self) -> Brown {
        let at = |i: usize| self.coefficients.get(i).copied().unwrap_or(0.0);
        Brown { k: [at(0), at(1), at(4), at(5), at(6), at(7)], p: [at(2), at(3)] }
    }

    /// θ'/r and its derivative by r².
    fn fisheye(&self, r2: f64) -> (f64, f64) {
        let k = |i: usize| self.coefficients.get(i).copied().unwrap_or(0.0);
        // Below this, the next term of the series is beyond f64 precision.
        if r2 < 1e-12 {
            return (1.0, k(0) - 1.0 / 3.0);
        }
        let r = r2.sqrt();
        let theta = r.atan();
        let t2 = theta * theta;
        let bent = theta * (1.0 + t2 * (k(0) + t2 * (k(1) + t2 * (k(2) + t2 * k(3)))));
        let bent_slope = 1.0 + t2 * (3.0 * k(0) + t2 * (5.0 * k(1) + t2 * (7.0 * k(2) + t2 * 9.0 * k(3))));
        let factor = bent / r;
        (factor, (bent_slope / (1.0 + r2) - factor) / (2.0 * r2))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn lens(model: Distortion, coefficients: &[f64]) -> Intrinsics {
        let coefficients = coefficients.to_vec();
        Intrinsics {
            width: 640,
            height: 480,
            fx: 600.0,
            fy: 590.0,
            cx: 319.5,
            cy: 241.0,
            model,
            coefficients,
            covariance: None,
        }
    }

    fn lenses() -> [Intrinsics; 5] {
        [
            lens(Distortion::None, &[]),
            lens(Distortion::PlumbBob, &[-0.28, 0.07, 0.0011, -0.0007, 0.002]),
            lens(Distortion::PlumbBob, &[0.1, 0.02, -0.002, 0.001]),
            lens(Distortion::Rational, &[0.3, 0.05, 0.001, -0.0005, 0.002, 0.6, 0.1, 0.01]),
            lens(Distortion::Fisheye, &[0.03, -0.01, 0.004, -0.001]),
        ]
    }

    /// Worked out by hand from OpenCV's formulas, to twelve digits.
    #[test]
    fn projections_match_opencv() {
        let pixel =
            lens(Distortion::PlumbBob, &[-0.28, 0.07, 0.0011, -0.0007, 0.002]).project([0.4, -0.6, 2.0]).unwrap();
        // x = 0.2, y = -0.3, r² = 0.13: D = 1 - 0.0364 + 0.001183 + 0.000004394
        let factor = 1.0 - 0.28 * 0.13 + 0.07 * 0.0169 + 0.002 * 0.002197;
        let x = 0.2 * factor + 2.0 * 0.0011 * -0.06 - 0.0007 * (0.13 + 0.08);
        let y = -0.3 * factor + 0.0011 * (0.13 + 0.18) + 2.0 * -0.0007 * -0.06;
        assert!((pixel[0] - (600.0 * x + 319.5)).abs() < 1e-10 && (pixel[1] - (590.0 * y + 241.0)).abs() < 1e-10);
        let pixel = lens(Distortion::Fisheye, &[0.03, -0.01, 0.004, -0.001]).project([1.0, 0.0, 1.0]).unwrap();
        let theta = std::f64::consts::FRAC_PI_4;
        let bent = theta + 0.03 * theta.powi(3) - 0.01 * theta.powi(5) + 0.004 * theta.powi(7) - 0.001 * theta.powi(9);
        assert!((pixel[0] - (600.0 * bent + 319.5)).abs() < 1e-10 && (pixel[1] - 241.0).abs() < 1e-10);
    }

    #[test]
    fn a_ray_is_projected_to_its_pixel() {
        for lens in lenses() {
            for y in (0..480).step_by(60) {
                for x in (0..640).step_by(40) {
                    let pixel = [f64::from(x), f64::from(y)];
                    let back = lens.project(lens.ray(pixel).unwrap()).unwrap();
                    let apart = (back[0] - pixel[0]).hypot(back[1] - pixel[1]);
                    assert!(apart < 1e-8, "{:?} at {pixel:?}: {apart} px", lens.model);
                }
            }
        }
    }

    #[test]
    fn derivatives_are_those_of_the_projection() {
        for lens in lenses() {
            for at in [[0.0, 0.0], [1e-7, -2e-7], [0.2, -0.3], [-0.45, 0.35]] {
                let (_, slopes) = lens.pixel(at).unwrap();
                let h = 1e-6;
                for axis in 0..2 {
                    let moved = |by: f64| {
                        let mut at = at;
                        at[axis] += by;
                        lens.pixel(at).unwrap().0
                    };
                    for (row, slopes) in slopes.iter().enumerate() {
                        let numeric = (moved(h)[row] - moved(-h)[row]) / (2.0 * h);
                        assert!((numeric - slopes[axis]).abs() < 1e-4, "{:?} {at:?}", lens.model);
                    }
                }
            }
        }
    }

    #[test]
    fn invalid_intrinsics_are_rejected() {
        for good in lenses() {
            assert_eq!(good.check(), Ok(()));
        }
        let error_message = |lens: Intrinsics| lens.check().unwrap_err().to_string();
        assert_eq!(
            error_message(lens(Distortion::PlumbBob, &[0.1, 0.2])),
            "the lens model `plumb_bob` has 4 or 5 (k1 k2 p1 p2 k3) coefficients, not 2"
        );
        assert_eq!(error_message(lens(Distortion::None, &[0.1])), "the lens model `none` has no coefficients, not 1");
        assert!(error_message(lens(Distortion::Rational, &[0.0; 5])).contains("8 (k1"));
        assert!(error_message(lens(Distortion::Fisheye, &[0.0; 5])).contains("4 (k1 k2 k3 k4)"));
        assert!(error_message(Intrinsics { fx: 0.0, ..lens(Distortion::None, &[]) }).contains("`fx` = 0"));
        assert!(error_message(lens(Distortion::Fisheye, &[0.0, f64::NAN, 0.0, 0.0])).contains("finite"));
        let sure = |rows: &[&[f64]]| Intrinsics {
            covariance: Some(rows.iter().map(|row| row.to_vec()).collect()),
            ..lens(Distortion::PlumbBob, &[0.0; 5])
        };
        let square = [&[9.0, 0.0, 0.0, 0.0][..], &[0.0, 9.0, 0.0, 0.0], &[0.0, 0.0, 1.0, 0.0], &[0.0, 0.0, 0.0, 1.0]];
        assert_eq!(sure(&square).check(), Ok(()));
        assert!(
            error_message(sure(&square[..3]))
                .contains("has other rows or columns; it has 4 rows (fx, fy, cx, cy) or 9")
        );
        assert!(
            error_message(sure(&[&[9.0, 1.0, 0.0, 0.0], square[1], square[2], square[3]])).contains("not symmetric")
        );
        let crossed = [&[1.0, 3.0, 0.0, 0.0][..], &[3.0, 1.0, 0.0, 0.0], square[2], square[3]];
        assert!(error_message(sure(&crossed)).contains("negative variance"));
        // Behind the camera, and beyond the fold of the distortion.
        assert_eq!(lens(Distortion::None, &[]).project([0.0, 0.0, -1.0]), None);
        assert_eq!(lens(Distortion::PlumbBob, &[-0.3, 0.0, 0.0, 0.0]).project([2.0, 0.0, 1.0]), None);
        assert_eq!(lens(Distortion::PlumbBob, &[-0.3, 0.0, 0.0, 0.0]).ray([5000.0, 240.0]), None);
    }
}
