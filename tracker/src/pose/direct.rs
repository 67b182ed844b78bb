//! Models whose parameters are the pose itself (roles `position` and `orientation`).
//!
//! Such a document has the lens and the target as constants: `fx`, `fy`, `cx`, `cy`, `lens_k1` …, and for each table of
//! roles, `red` say, `red_x`, `red_y`, `red_z` (0 when missing) and `red_radius`. The rotation is given by modified Rodrigues
//! parameters m = axis · tan(angle / 4): rational formulas, no singularity but at 360°; m and −m/m² are one rotation.

use isophote_jit::Window;
use isophote_symbolic::{Model, ParameterId, Roles};
use nalgebra::{DMatrix, Matrix6, Vector3, Vector6};

use super::Pose;
use super::measured::row_major;
use super::rigid::{Rigid, upright};
use super::seen::{Five, outline};
use super::target::{Target, TargetSpot};
use crate::camera::{Distortion, Intrinsics};

/// The lens, the target and the parameters of the pose, from a document's constants and roles.
#[derive(Clone, Debug)]
pub(crate) struct Geometry {
    pub lens: Intrinsics,
    pub target: Target,
    position: [ParameterId; 3],
    orientation: Vec<ParameterId>,
}

/// Step of numerical derivatives.
const NUDGE: f64 = 1e-6;
/// Beyond this length of m the equivalent triple is used, which is shorter than 1/1.2.
const FOLD: f64 = 1.2;
/// Margin of a spot's window beyond the domain, as a share of the spot.
const MARGIN: f64 = 0.05;
/// Margin of a spot's window beyond the domain, px.
const MARGIN_PX: f64 = 2.0;
/// Candidate contours at which a domain may end.
const REACHES: [f64; 6] = [1.4, 1.7, 2.3, 3.0, 4.5, 9.0];
/// Sample points along each contour.
const BEARINGS: usize = 8;

/// Indices of all brightness parameters.
pub(crate) fn lights(model: &Model) -> impl Iterator<Item = usize> {
    model.roles().iter().filter_map(|roles| roles.brightness.map(ParameterId::index))
}

/// The largest brightness.
pub(crate) fn brightest(model: &Model, parameters: &[f64]) -> f64 {
    lights(model).map(|light| parameters[light].abs()).fold(0.0, f64::max)
}

impl Geometry {
    /// `None` when the model's parameters are no pose, or the constants of the camera or target are missing or invalid.
    pub fn of(model: &Model, constants: &[f64]) -> Option<Geometry> {
        let roles = model.roles().iter().find(|roles| !roles.position.is_empty() && !roles.orientation.is_empty())?;
        let value = |name: &str| model.constant(name).map(|id| constants[id.index()]);
        let distortion = |name: &str| value(&format!("lens_{name}")).unwrap_or(0.0);
        let coefficients = ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"].map(distortion).to_vec();
        let (model_of_lens, coefficients) = match coefficients.iter().all(|c| *c == 0.0) {
            true => (Distortion::None, Vec::new()),
            false => (Distortion::Rational, coefficients),
        };
        let lens = Intrinsics {
            width: 0,
            height: 0,
            fx: value("fx")?,
            fy: value("fy")?,
            cx: value("cx")?,
            cy: value("cy")?,
            model: model_of_lens,
            coefficients,
            covariance: None,
        };
        let spot = |name: &String| {
            let at = |axis: &str| value(&format!("{name}_{axis}"));
            let position_mm = [at("x")?, at("y")?, at("z").unwrap_or(0.0)];
            Some(TargetSpot { name: name.clone(), position_mm, radius_mm: at("radius")? })
        };
        let spots = model.roles().iter().filter_map(|roles| spot(roles.name.as_ref()?)).collect();
        let target = Target { name: String::new(), spots, mixing: None };
        lens.check().ok()?;
        target.check().ok()?;
        let position = <[ParameterId; 3]>::try_from(&roles.position[..]).ok()?;
        Some(Geometry { lens, target, position, orientation: roles.orientation.clone() })
    }

    /// The pose of the parameters.
    pub fn pose(&self, parameters: &[f64]) -> Rigid {
        let at = |id: &ParameterId| parameters[id.index()];
        let m = Vector3::from_fn(|i, _| self.orientation.get(i).map_or(0.0, at));
        Rigid::of_rodrigues(m, Vector3::from_fn(|i, _| at(&self.position[i])))
    }

    /// Writes a pose into parameters. With two orientation parameters only the spin is lost: it is about the normal of
    /// the one spot, whose centre stays.
    pub fn put(&self, pose: &Rigid, parameters: &mut [f64]) {
        let pose = if self.orientation.len() == 2 { self.unspun(pose) } else { *pose };
        let m = pose.rodrigues();
        self.orientation.iter().enumerate().for_each(|(i, id)| parameters[id.index()] = m[i]);
        self.position.iter().enumerate().for_each(|(i, id)| parameters[id.index()] = pose.translation[i]);
    }

    /// Projected contour s = 1 of each spot; `None` for one that is not in front of the camera.
    pub fn outlines(&self, parameters: &[f64]) -> Vec<Option<Five>> {
        let pose = self.pose(parameters);
        self.target.spots.iter().map(|spot| outline(&self.lens, &pose, spot)).collect()
    }

    /// Indices of the window's pixels within a contour of a spot, each with the nearest spot's index.
    pub fn nearest(&self, parameters: &[f64], window: Window, rim: f64) -> Vec<(usize, usize)> {
        let outlines = self.outlines(parameters);
        let mut found = Vec::new();
        for pixel in 0..window.pixels() {
            let at = [(window.x + pixel % window.width) as f64, (window.y + pixel / window.width) as f64];
            let s = |e: &Five| {
                let (dx, dy) = (at[0] - e[0], at[1] - e[1]);
                e[2] * dx * dx + 2.0 * e[3] * dx * dy + e[4] * dy * dy
            };
            let nearest = outlines.iter().enumerate().filter_map(|(spot, e)| Some((spot, s(e.as_ref()?))));
            let nearest = nearest.min_by(|a, b| a.1.total_cmp(&b.1));
            found.extend(nearest.filter(|(_, s)| *s <= rim).map(|(spot, _)| (pixel, spot)));
        }
        found
    }

    /// The model's roles of a spot.
    pub fn roles<'a>(&self, model: &'a Model, spot: usize) -> Option<&'a Roles> {
        let name = &self.target.spots[spot].name;
        model.roles().iter().find(|roles| roles.name.as_ref() == Some(name))
    }

    /// The rotation from one pose to another, about camera axes, rad.
    pub fn turn(&self, from: &[f64], to: &[f64]) -> Vector3<f64> {
        self.pose(from).to(&self.pose(to)).fixed_rows::<3>(3).into_owned()
    }

    /// Parameters with the same position, rotated.
    pub fn turned(&self, parameters: &[f64], by: &Vector3<f64>) -> Vec<f64> {
        let mut turned = parameters.to_vec();
        self.put(&self.pose(parameters).moved(&Vector6::new(0.0, 0.0, 0.0, by.x, by.y, by.z)), &mut turned);
        turned
    }

    /// True when the rotation has three degrees of freedom.
    pub fn has_spin(&self) -> bool {
        self.orientation.len() > 2
    }

    /// The spin-free rotation with the same normal.
    fn unspun(&self, pose: &Rigid) -> Rigid {
        let rotation = upright(&pose.rotation.column(2).into_owned());
        let centre = self.target.spots.first().map_or(Vector3::zeros(), TargetSpot::centre);
        Rigid { rotation, translation: pose.apply(centre) - rotation * centre }
    }

    /// Replaces a long triple by the shorter equivalent one.
    pub fn fold(&self, parameters: &mut [f64]) {
        let square: f64 = self.orientation.iter().map(|id| parameters[id.index()].powi(2)).sum();
        if square > FOLD * FOLD {
            self.orientation.iter().for_each(|id| parameters[id.index()] /= -square);
        }
    }

    /// Windows that cover the domain: one around each spot, merged when they touch. The whole `window` when a spot
    /// cannot be projected, or the domain reaches far beyond the spots.
    pub fn windows(&self, model: &Model, parameters: &[f64], constants: &[f64], window: Window) -> Vec<Window> {
        let outlines: Option<Vec<Five>> = self.outlines(parameters).into_iter().collect();
        let Some(outlines) = outlines else { return vec![window] };
        let Some(reach) = reach(model, parameters, constants, &outlines) else { return vec![window] };
        let mut boxes: Vec<[f64; 4]> = Vec::new();
        for ellipse in outlines {
            let determinant = ellipse[2] * ellipse[4] - ellipse[3] * ellipse[3];
            let half = |a: f64| (reach * a / determinant).sqrt() * (1.0 + MARGIN) + MARGIN_PX;
            let (w, h) = (half(ellipse[4]), half(ellipse[2]));
            let mut own = [ellipse[0] - w, ellipse[1] - h, ellipse[0] + w, ellipse[1] + h];
            // A merged box may touch another one.
            while let Some(i) = boxes.iter().position(|other| touch(other, &own)) {
                let other = boxes.swap_remove(i);
                own = [own[0].min(other[0]), own[1].min(other[1]), own[2].max(other[2]), own[3].max(other[3])];
            }
            boxes.push(own);
        }
        let windows: Vec<Window> = boxes.iter().filter_map(|b| part(window, *b)).collect();
        if windows.is_empty() { vec![window] } else { windows }
    }

    /// The pose of a fit with its covariance in camera axes.
    pub fn published(&self, parameters: &[f64], order: &[ParameterId], covariance: Option<&DMatrix<f64>>) -> Pose {
        let pose = self.pose(parameters);
        let covariance = covariance.map(|c| row_major(&self.in_camera_axes(&pose, parameters, order, c)));
        Pose {
            position_mm: pose.translation.into(),
            orientation_xyzw: pose.quaternion(),
            covariance,
            degrees_of_freedom: if self.orientation.len() == 2 { 5 } else { 6 },
            chi_square: None,
            left_out: Vec::new(),
            alternatives: Vec::new(),
        }
    }

    /// `J C Jᵀ` with J the derivatives of (δt, δω) by position and orientation parameters.
    fn in_camera_axes(
        &self,
        pose: &Rigid,
        parameters: &[f64],
        order: &[ParameterId],
        covariance: &DMatrix<f64>,
    ) -> Matrix6<f64> {
        let mut slopes = DMatrix::zeros(6, order.len());
        for id in self.position.iter().chain(&self.orientation) {
            let Some(column) = order.iter().position(|free| free == id) else { continue };
            let nudged = |by: f64| {
                let mut moved = parameters.to_vec();
                moved[id.index()] += by;
                self.pose(&moved)
            };
            let change = nudged(-NUDGE).to(&nudged(NUDGE)) / (2.0 * NUDGE);
            slopes.column_mut(column).copy_from(&change);
        }
        let mut all = (&slopes * covariance * slopes.transpose()).fixed_view::<6, 6>(0, 0).into_owned();
        if self.orientation.len() == 2 {
            let normal = pose.rotation.column(2).into_owned();
            let arm = self.target.spots.first().map_or(Vector3::zeros(), |spot| pose.rotation * spot.centre());
            let shift = -normal.cross(&arm);
            let spin = Vector6::new(shift.x, shift.y, shift.z, normal.x, normal.y, normal.z);
            all += spin * spin.transpose() * (std::f64::consts::PI.powi(2) / 3.0);
        }
        0.5 * (all + all.transpose())
    }
}

/// True when boxes share pixels, or would after rounding outwards.
fn touch(a: &[f64; 4], b: &[f64; 4]) -> bool {
    (0..2).all(|k| a[k] <= b[k + 2] + 2.0 && b[k] <= a[k + 2] + 2.0)
}

/// The least candidate s beyond which the domain is empty, sampled around each spot; `None` when it reaches far.
fn reach(model: &Model, parameters: &[f64], constants: &[f64], outlines: &[Five]) -> Option<f64> {
    let place = |ellipse: &Five, s: f64, k: usize| {
        let (sin, cos) = (std::f64::consts::TAU * k as f64 / BEARINGS as f64).sin_cos();
        let own = ellipse[2] * cos * cos + 2.0 * ellipse[3] * cos * sin + ellipse[4] * sin * sin;
        let radius = (s / own).sqrt();
        [ellipse[0] + radius * cos, ellipse[1] + radius * sin]
    };
    let mut is_inside = model.insides(parameters, constants);
    let mut ends_at = |s: f64| {
        let mut around = outlines.iter().flat_map(|ellipse| (0..BEARINGS).map(move |k| (ellipse, k)));
        !around.any(|(ellipse, k)| is_inside(&place(ellipse, s, k)))
    };
    REACHES.into_iter().find(|s| ends_at(*s))
}

/// The pixels of `window` inside of a box.
fn part(window: Window, [x0, y0, x1, y1]: [f64; 4]) -> Option<Window> {
    let span = |first: usize, count: usize, low: f64, high: f64| {
        let (first_edge, end) = (first as f64, (first + count) as f64 - 1.0);
        let (low, high) = (low.floor().max(first_edge), high.ceil().min(end));
        (low <= high).then(|| (low as usize, (high - low) as usize + 1))
    };
    let (x, width) = span(window.x, window.width, x0, x1)?;
    let (y, height) = span(window.y, window.height, y0, y1)?;
    Some(Window { x, y, width, height, ..window })
}

#[cfg(test)]
#[path = "direct_tests.rs"]
mod tests;
