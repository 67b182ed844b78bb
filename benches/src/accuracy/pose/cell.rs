//! One cell of the table: all methods on many frames of one condition.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use isophote_jit::{Slices, Window};
use isophote_symbolic::{Model, Precision};
use isophote_tracker::geometry::{Rigid, bounds};
use isophote_tracker::{Compiled, Estimate, Frame, Pose, Target, TrackState, Tracker, TrackerOptions};
use nalgebra::{Matrix6, Quaternion, UnitQuaternion, Vector3};

use super::bound::bound;
use super::methods::Ellipses;
use super::scene::{Random, brightness, camera, frame, lens, random_pose, target};
use super::thesis;

/// A condition.
#[derive(Clone, Copy)]
pub struct Cell {
    pub name: &'static str,
    pub distance_mm: f64,
    pub tilt_degrees: (f64, f64),
    pub saturated: f64,
}

/// The conditions of the notes.
pub const CELLS: [Cell; 5] = [
    Cell { name: "1 m, 10–50°, S0", distance_mm: 1000.0, tilt_degrees: (10.0, 50.0), saturated: 0.0 },
    Cell { name: "1 m, 10–50°, S30", distance_mm: 1000.0, tilt_degrees: (10.0, 50.0), saturated: 0.3 },
    Cell { name: "1 m, 0–5°, S30", distance_mm: 1000.0, tilt_degrees: (0.0, 5.0), saturated: 0.3 },
    Cell { name: "0.5 m, 10–50°, S30", distance_mm: 500.0, tilt_degrees: (10.0, 50.0), saturated: 0.3 },
    Cell { name: "2.5 m, 10–50°, S30", distance_mm: 2500.0, tilt_degrees: (10.0, 50.0), saturated: 0.3 },
];

/// The methods, in the order of the table.
pub const METHODS: [&str; 8] = [
    "thesis 4.1.4 (signs given)",
    "three conics + Kabsch",
    "P3P on fitted centres",
    "P3P, centres corrected",
    "joint, 15 → 6",
    "direct, cold start",
    "direct, raised by 40 mm",
    "one spot, direct",
];

/// Errors of a method in a cell.
#[derive(Clone, Debug, Default)]
pub struct Errors {
    squares: [f64; 3],
    pub answers: usize,
    pub frames: usize,
    /// More than 10° off; for a single spot: nearer to the mirrored tilt than to the true one.
    pub wrong: usize,
    nees: f64,
    nees_of: usize,
    nees_covered: usize,
    pub times_us: Vec<f64>,
}

impl Errors {
    fn add(&mut self, truth: &Rigid, found: Option<(Rigid, Option<Matrix6<f64>>)>, single: bool) {
        self.frames += 1;
        let Some((found, covariance)) = found else { return };
        self.answers += 1;
        let off = truth.to(&found);
        let normals = [truth.rotation.column(2).into_owned(), found.rotation.column(2).into_owned()];
        let angle = if single { normals[0].angle(&normals[1]) } else { truth.angle_to(&found) };
        let sight = truth.translation.normalize();
        let mirrored = sight * (2.0 * normals[0].dot(&sight)) - normals[0];
        let wrong = if single { mirrored.angle(&normals[1]) < angle } else { angle.to_degrees() > 10.0 };
        if wrong {
            self.wrong += 1;
            return;
        }
        self.squares[0] += 0.5 * (off[0] * off[0] + off[1] * off[1]);
        self.squares[1] += off[2] * off[2];
        self.squares[2] += angle.to_degrees().powi(2);
        if let Some(inverse) = covariance.and_then(|c| c.try_inverse()).filter(|_| !single) {
            let nees = off.dot(&(inverse * off));
            self.nees += nees;
            self.nees_of += 1;
            self.nees_covered += usize::from(nees < 12.59);
        }
    }

    fn rms(&self, k: usize) -> f64 {
        (self.squares[k] / (self.answers - self.wrong).max(1) as f64).sqrt()
    }

    /// xy, z in mm, rotation in degrees.
    pub fn text(&self) -> String {
        if self.frames == 0 {
            return "–".into();
        }
        let lost = self.frames - self.answers;
        let mut text = format!("{:.3} / {:.3} / {:.3}", self.rms(0), self.rms(1), self.rms(2));
        if self.wrong > 0 {
            text += &format!(", {:.1} % wrong", 100.0 * self.wrong as f64 / self.frames as f64);
        }
        if lost > 0 {
            text += &format!(", {lost} of {} lost", self.frames);
        }
        text
    }

    /// Mean NEES (6 if consistent) and the share inside the 95 % ellipsoid.
    pub fn consistency(&self) -> Option<(f64, f64)> {
        let of = self.nees_of as f64;
        (self.nees_of > 0).then(|| (self.nees / of, 100.0 * self.nees_covered as f64 / of))
    }

    /// rms of z in mm and of the rotation in degrees.
    pub fn z_and_rotation(&self) -> (f64, f64) {
        (self.rms(1), self.rms(2))
    }
}

/// Results of a cell.
pub struct Found {
    pub cell: Cell,
    pub methods: [Errors; 8],
    /// rms of the bounds of the poses: xy, z, rotation; of the flat and of the raised target.
    pub bounds: [[f64; 3]; 2],
    pub frames: usize,
}

/// Compiled documents.
pub struct Documents {
    ellipses: Arc<Compiled>,
    flat: Arc<Compiled>,
    raised: Arc<Compiled>,
    single: Arc<Compiled>,
}

impl Documents {
    /// The shipped ones with the notes' profile, and three ellipses.
    pub fn new() -> Documents {
        let compiled = |text: &str| {
            let model = Model::from_toml(text).unwrap_or_else(|faults| panic!("{faults:?}"));
            Arc::new(Compiled::new(Arc::new(model), Precision::F32).unwrap())
        };
        Documents {
            ellipses: compiled(include_str!("three-ellipses.toml")),
            flat: compiled(&crate::text("three-spots-pose")),
            raised: compiled(&crate::text("raised-spot-pose")),
            single: compiled(&crate::text("spot-pose")),
        }
    }
}

impl Default for Documents {
    fn default() -> Documents {
        Documents::new()
    }
}

fn options(target: &Target) -> TrackerOptions {
    TrackerOptions { camera: camera(), target: Some(target.clone()), ..TrackerOptions::default() }
}

/// A tracker with the notes' profile.
pub(super) fn direct(compiled: &Arc<Compiled>, target: &Target) -> Tracker {
    direct_from(compiled, target, BTreeMap::new())
}

/// The same with starting values.
pub(super) fn direct_from(compiled: &Arc<Compiled>, target: &Target, start: BTreeMap<String, f64>) -> Tracker {
    let mut options = TrackerOptions { start, ..options(target) };
    options.constants = [("k1".to_string(), -1.5), ("k2".to_string(), 0.0)].into();
    Tracker::new(compiled.clone(), options).unwrap()
}

pub(super) fn rigid(pose: &Pose) -> (Rigid, Option<Matrix6<f64>>) {
    let [x, y, z, w] = pose.orientation_xyzw;
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)).to_rotation_matrix().into_inner();
    let covariance = pose.covariance.as_ref().map(|c| Matrix6::from_row_slice(c));
    (Rigid { rotation, translation: Vector3::from(pose.position_mm) }, covariance)
}

fn answer(estimate: &Estimate) -> Option<(Rigid, Option<Matrix6<f64>>)> {
    estimate.pose.as_ref().filter(|_| estimate.state == TrackState::Tracking).map(rigid)
}

/// Runs a cell; methods that need ellipses see every `every`-th frame only.
pub fn run(documents: &Documents, cell: Cell, frames: usize, every: usize, seed: u64) -> Found {
    let (flat, raised) = (target(0.0), target(40.0));
    let single = Target {
        spots: vec![isophote_tracker::TargetSpot { name: "spot".into(), position_mm: [0.0; 3], radius_mm: 30.0 }],
        ..Target::default()
    };
    let light = brightness(cell.saturated);
    let mut found = Found { cell, methods: Default::default(), bounds: [[0.0; 3]; 2], frames };
    let (mut done, mut number, mut bounds_of) = (0, 0_u64, 0);
    while done < frames {
        number += 1;
        let mut random = Random::of(seed.wrapping_add(number));
        let truth = random_pose(&mut random, cell.distance_mm, cell.tilt_degrees);
        // Redraw a pose whose spots are not all in the picture.
        let Some(picture) = frame(&truth, &flat.spots, light, &mut random) else { continue };
        let Some(picture_raised) = frame(&truth, &raised.spots, light, &mut random) else { continue };
        let Some(picture_single) = frame(&truth, &single.spots, light, &mut random) else { continue };
        for (method, compiled, target, picture, is_single) in [
            (5, &documents.flat, &flat, &picture, false),
            (6, &documents.raised, &raised, &picture_raised, false),
            (7, &documents.single, &single, &picture_single, true),
        ] {
            let mut tracker = direct(compiled, target);
            let estimate = tracker.track(picture);
            let errors = &mut found.methods[method];
            errors.add(&truth, answer(&estimate), is_single);
            // The next frame of a target at rest gives the time of tracking.
            if let (5 | 7, Some(next)) = (method, frame(&truth, &target.spots, light, &mut random)) {
                let start = Instant::now();
                tracker.track(&next);
                errors.times_us.push(start.elapsed().as_secs_f64() * 1e6);
            }
        }
        if done % every == 0 {
            by_ellipses(documents, &flat, &truth, &picture, light, &mut found);
            let both = [bound(&truth, &flat, light), bound(&truth, &raised, light)];
            if let [Some(one), Some(other)] = both {
                for (sums, c) in found.bounds.iter_mut().zip([one, other]) {
                    sums[0] += 0.5 * (c[(0, 0)] + c[(1, 1)]);
                    sums[1] += c[(2, 2)];
                    sums[2] += c.fixed_view::<3, 3>(3, 3).trace().to_degrees().to_degrees();
                }
                bounds_of += 1;
            }
        }
        done += 1;
    }
    found.bounds.iter_mut().flatten().for_each(|sum| *sum = (*sum / f64::from(bounds_of.max(1))).sqrt());
    found
}

/// The methods that start from ellipses, which are fitted from near the truth.
fn by_ellipses(documents: &Documents, target: &Target, truth: &Rigid, picture: &Frame, light: f64, found: &mut Found) {
    let model = documents.ellipses.model();
    let mut options = options(target);
    let (mut low, mut high) = ([f64::INFINITY; 2], [0.0_f64; 2]);
    for (spot, roles) in target.spots.iter().zip(model.roles()) {
        let Some([x, y, w, h]) = bounds(&lens(), truth, spot) else { return };
        let names = roles.centre.iter().chain(&roles.shape).chain(&roles.brightness);
        let values = [x + 0.5, y - 0.5, w.powi(-2), 0.0, h.powi(-2), light];
        for (id, value) in names.zip(values) {
            options.start.insert(model.parameters()[id.index()].name.clone(), value);
        }
        for (k, (at, half)) in [(x, w), (y, h)].into_iter().enumerate() {
            low[k] = low[k].min(at - 1.7 * half);
            high[k] = high[k].max(at + 1.7 * half);
        }
    }
    let first = low.map(|v| v.max(0.0) as usize);
    let size = [0, 1].map(|k| high[k] as usize + 1 - first[k]);
    options.window = Some(Window { x: first[0], y: first[1], width: size[0], height: size[1], slices: Slices::ALL });
    let mut tracker = Tracker::new(documents.ellipses.clone(), options).unwrap();
    let estimate = tracker.track(picture);
    let camera = camera();
    let constants: Vec<f64> = model.constants().iter().map(|c| camera.constant(&c.name).unwrap_or(c.value)).collect();
    let good = estimate.state == TrackState::Tracking;
    let ellipses = Ellipses { model, parameters: &estimate.parameters, constants: &constants, target };
    let alone = |pose: Option<Rigid>| pose.map(|pose| (pose, None));
    let answers = match good {
        false => [None, None, None, None, None],
        true => [
            alone(Some(thesis::pose(&ellipses.all(), truth))),
            alone(ellipses.conics()),
            alone(ellipses.p3p(false)),
            alone(ellipses.p3p(true)),
            answer(&estimate),
        ],
    };
    for (method, answer) in answers.into_iter().enumerate() {
        found.methods[method].add(truth, answer, false);
    }
}
