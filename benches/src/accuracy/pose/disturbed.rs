//! Poses under disturbances while tracked, and cold starts far away: the rate of wrong poses with the state
//! `tracking`.

use std::sync::Arc;

use isophote_symbolic::{Model, Precision};
use isophote_tracker::geometry::{Rigid, bounds};
use isophote_tracker::{Compiled, Target, TargetSpot, Tracker};
use nalgebra::{Rotation3, Vector3, Vector6};

use super::bound::bound_of;
use super::cell::direct;
use super::light::Light;
use super::scene::{HEIGHT, RADIUS_MM, Random, WIDTH, brightness, lens, means, random_pose, read_out, target};
use super::tally::{PoseTally, WRONG_MM};

/// A disturbance of a sequence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Disturbance {
    /// The tracker starts with the mirrored tilt.
    Mirrored,
    /// The target turns by 10° per frame.
    Turning,
    /// Light of this height, DN, beside the first spot.
    Glare(f64),
    /// This many quarters of the first spot are covered.
    Quarters(u32),
    /// This many whole spots are covered.
    Spots(usize),
    /// None: each frame is a cold start.
    Cold { saturated: f64 },
    /// Cold starts with this many quarters of the first spot covered.
    ColdQuarters(u32),
    /// Cold starts with this many whole spots covered.
    ColdSpots(usize),
    /// Cold starts with light of this height, DN, beside the first spot.
    ColdGlare(f64),
}

/// A row of the table.
#[derive(Clone, Copy, Debug)]
pub struct Condition {
    pub name: &'static str,
    pub spots: usize,
    pub disturbance: Disturbance,
    pub distance_mm: (f64, f64),
}

const fn row(name: &'static str, spots: usize, disturbance: Disturbance) -> Condition {
    Condition { name, spots, disturbance, distance_mm: (900.0, 1100.0) }
}

const fn far(name: &'static str, spots: usize, saturated: f64, distance_mm: (f64, f64)) -> Condition {
    Condition { name, spots, disturbance: Disturbance::Cold { saturated }, distance_mm }
}

impl Condition {
    /// Whether each frame is a cold start.
    pub fn is_cold(&self) -> bool {
        use Disturbance::{Cold, ColdGlare, ColdQuarters, ColdSpots};
        matches!(self.disturbance, Cold { .. } | ColdQuarters(_) | ColdSpots(_) | ColdGlare(_))
    }
}

/// All rows.
pub const CONDITIONS: [Condition; 19] = [
    row("three spots, begun with the mirrored tilt", 3, Disturbance::Mirrored),
    row("one spot, begun with the mirrored tilt", 1, Disturbance::Mirrored),
    row("three spots, turning by 10° a frame", 3, Disturbance::Turning),
    row("one spot, turning by 10° a frame", 1, Disturbance::Turning),
    row("three spots, glare of 140 DN", 3, Disturbance::Glare(140.0)),
    row("three spots, glare of 600 DN", 3, Disturbance::Glare(600.0)),
    row("one spot, glare of 140 DN", 1, Disturbance::Glare(140.0)),
    row("three spots, a quarter of one covered", 3, Disturbance::Quarters(1)),
    row("three spots, half of one covered", 3, Disturbance::Quarters(2)),
    row("one spot, a quarter covered", 1, Disturbance::Quarters(1)),
    row("one spot, half covered", 1, Disturbance::Quarters(2)),
    row("three spots, one covered", 3, Disturbance::Spots(1)),
    row("three spots, two covered", 3, Disturbance::Spots(2)),
    row("three spots, cold, half of one covered", 3, Disturbance::ColdQuarters(2)),
    row("three spots, cold, one covered", 3, Disturbance::ColdSpots(1)),
    row("three spots, cold, glare of 600 DN", 3, Disturbance::ColdGlare(600.0)),
    far("three spots, cold at 1.5–3 m, S0", 3, 0.0, (1500.0, 3000.0)),
    far("three spots, cold at 1.5–3 m, S60", 3, 0.6, (1500.0, 3000.0)),
    far("one spot, cold at 0.5–1 m, S0", 1, 0.0, (500.0, 1000.0)),
];

/// Frames before, during and after a disturbance.
const PHASES: [usize; 3] = [6, 6, 6];
/// Frames of a turning target.
const TURNING: usize = 30;
/// The compiled shipped documents.
pub struct DisturbedDocuments {
    three: Arc<Compiled>,
    one: Arc<Compiled>,
}

impl DisturbedDocuments {
    /// Without kernels, which are compiled on demand.
    pub fn new() -> DisturbedDocuments {
        let compiled = |name: &str| {
            let model = Model::from_toml(&crate::text(name)).unwrap_or_else(|faults| panic!("{faults:?}"));
            Arc::new(Compiled::new(Arc::new(model), Precision::F32).unwrap())
        };
        DisturbedDocuments { three: compiled("three-spots-pose"), one: compiled("spot-pose") }
    }
}

impl Default for DisturbedDocuments {
    fn default() -> DisturbedDocuments {
        DisturbedDocuments::new()
    }
}

/// Covered pixels and added light.
struct Occlusion {
    covered: Vec<bool>,
    added: Vec<f64>,
}

impl Occlusion {
    fn of(disturbance: Disturbance, pose: &Rigid, spots: &[TargetSpot], side: f64) -> Option<Occlusion> {
        let mut occlusion = Occlusion { covered: vec![false; WIDTH * HEIGHT], added: vec![0.0; WIDTH * HEIGHT] };
        let [x, y, w, h] = bounds(&lens(), pose, &spots[0])?;
        let pixels = (0..WIDTH * HEIGHT).map(|i| (i, (i % WIDTH) as f64 - x, (i / WIDTH) as f64 - y));
        match disturbance {
            Disturbance::Quarters(quarters) | Disturbance::ColdQuarters(quarters) => {
                for (i, dx, dy) in pixels.filter(|(_, dx, dy)| dx.abs() < 2.0 * w && dy.abs() < 2.0 * h) {
                    let turn = (dy.atan2(dx) - side).rem_euclid(std::f64::consts::TAU);
                    occlusion.covered[i] = turn < f64::from(quarters) * std::f64::consts::FRAC_PI_2;
                }
            }
            Disturbance::Spots(count) | Disturbance::ColdSpots(count) => {
                for spot in &spots[..count] {
                    let [x, y, w, h] = bounds(&lens(), pose, spot)?;
                    for i in 0..WIDTH * HEIGHT {
                        let (dx, dy) = ((i % WIDTH) as f64 - x, (i / WIDTH) as f64 - y);
                        occlusion.covered[i] |= dx.abs() < 1.2 * w + 2.0 && dy.abs() < 1.2 * h + 2.0;
                    }
                }
            }
            Disturbance::Glare(height) | Disturbance::ColdGlare(height) => {
                let (gx, gy) = (1.2 * w * side.cos(), 1.2 * h * side.sin());
                for (i, dx, dy) in pixels {
                    let square = (dx - gx).powi(2) + (dy - gy).powi(2);
                    occlusion.added[i] = height * (-0.5 * square / 15.0_f64.powi(2)).exp();
                }
            }
            _ => {}
        }
        Some(occlusion)
    }

    fn over(&self, means: &mut [f64]) {
        for (i, mean) in means.iter_mut().enumerate() {
            *mean = if self.covered[i] { super::scene::BACKGROUND } else { *mean + self.added[i] };
        }
    }

    fn is_left(&self, i: usize) -> bool {
        !self.covered[i] && self.added[i] < 0.05
    }
}

/// Runs that many sequences of a condition, or frames for cold starts.
pub fn run(documents: &DisturbedDocuments, condition: Condition, sequences: usize, seed: u64) -> PoseTally {
    let mut target = target(0.0);
    if condition.spots == 1 {
        target = Target {
            spots: vec![TargetSpot { name: "spot".into(), position_mm: [0.0; 3], radius_mm: RADIUS_MM }],
            ..Target::default()
        };
    }
    let compiled = if condition.spots == 1 { &documents.one } else { &documents.three };
    let (mut tally, mut done, mut number) = (PoseTally::default(), 0, 0_u64);
    while done < sequences {
        number += 1;
        let mut random = Random::of(seed.wrapping_add(number));
        let frames = match condition.disturbance {
            _ if condition.is_cold() => cold(compiled, &target, condition, &mut random, &mut tally),
            _ => sequence(compiled, &target, condition, &mut random, &mut tally),
        };
        done += usize::from(frames.is_some());
    }
    tally
}

fn cold(
    compiled: &Arc<Compiled>,
    target: &Target,
    condition: Condition,
    random: &mut Random,
    tally: &mut PoseTally,
) -> Option<()> {
    let distance = random.between(condition.distance_mm.0, condition.distance_mm.1);
    let saturated = if let Disturbance::Cold { saturated } = condition.disturbance { saturated } else { 0.0 };
    let (truth, light) = (random_pose(random, distance, (10.0, 50.0)), brightness(saturated));
    let mut means = means(&truth, &target.spots, light)?;
    let occlusion = Occlusion::of(condition.disturbance, &truth, &target.spots, random.between(0.0, 6.0))?;
    occlusion.over(&mut means);
    let estimate = direct(compiled, target).track(&read_out(&means, random));
    if std::env::var_os("DBG").is_some() && estimate.state == isophote_tracker::TrackState::Tracking {
        let f = super::cell::rigid(estimate.pose.as_ref().unwrap()).0;
        let place = |p: &Rigid| target.spots.iter().map(|s| bounds(&lens(), p, s)).collect::<Vec<_>>();
        eprintln!(
            "true {truth:?} {:?}\nfound {f:?} {:?}\n{:?} {:?} {:?} {:?}",
            place(&truth),
            place(&f),
            estimate.parameters,
            estimate.substitute,
            estimate.pose.as_ref().map(|p| (&p.left_out, &p.alternatives)),
            estimate.reduced_chi_square
        );
        let mut out = format!("P5 {WIDTH} {HEIGHT} 255\n").into_bytes();
        out.extend(means.iter().map(|m| m.clamp(0.0, 255.0) as u8));
        std::fs::write(format!("/tmp/pose_{}.pgm", tally.tracking), out).unwrap();
    }
    let bound = bound_of(&truth, target, &Light::grey(light, target.spots.len()), &|i| occlusion.is_left(i));
    tally.add(&truth, &estimate, bound, condition.spots == 1, WRONG_MM);
    Some(())
}

fn sequence(
    compiled: &Arc<Compiled>,
    target: &Target,
    condition: Condition,
    random: &mut Random,
    tally: &mut PoseTally,
) -> Option<()> {
    let (single, light) = (condition.spots == 1, brightness(0.0));
    let distance = random.between(condition.distance_mm.0, condition.distance_mm.1);
    let first = random_pose(random, distance, (10.0, 50.0));
    let drift = Vector6::from_fn(|k, _| random.between(-1.0, 1.0) * if k < 3 { 1.0 } else { 0.004 });
    let (axis, spun) = (random.between(0.0, std::f64::consts::TAU), random.between(-3.0, 3.0));
    let side = random.between(0.0, std::f64::consts::TAU);
    let at = |frame: usize| match condition.disturbance {
        Disturbance::Turning => {
            // Back and forth, up to 45° to either side.
            let step = (frame % 18) as f64;
            let degrees = if step < 9.0 { -45.0 + 10.0 * step } else { 45.0 - 10.0 * (step - 9.0) };
            let tilt = Rotation3::new(Vector3::new(axis.cos(), axis.sin(), 0.0) * degrees.to_radians());
            let rotation = (tilt * Rotation3::from_axis_angle(&Vector3::z_axis(), spun)).into_inner();
            Rigid { rotation, ..first }.moved(&(drift.component_mul(&ONLY_SHIFT) * frame as f64))
        }
        _ => first.moved(&(drift * frame as f64)),
    };
    let count = if condition.disturbance == Disturbance::Turning { TURNING } else { PHASES.iter().sum() };
    let mut pictures = Vec::new();
    for frame in 0..count {
        let (truth, is_on) = (at(frame), (PHASES[0]..PHASES[0] + PHASES[1]).contains(&frame));
        let mut means = means(&truth, &target.spots, light)?;
        let occlusion = is_on.then(|| Occlusion::of(condition.disturbance, &truth, &target.spots, side)).flatten();
        occlusion.iter().for_each(|occlusion| occlusion.over(&mut means));
        let mut picture = read_out(&means, random);
        picture.sequence = frame as u64;
        pictures.push((truth, picture, occlusion));
    }
    let mut tracker = match condition.disturbance {
        Disturbance::Mirrored => begun(compiled, target, &mirrored(&first), light),
        _ => direct(compiled, target),
    };
    let is_whole = matches!(condition.disturbance, Disturbance::Mirrored | Disturbance::Turning);
    let (mut rest, mut late) = (PoseTally::default(), 0);
    for (frame, (truth, picture, occlusion)) in pictures.iter().enumerate() {
        let estimate = tracker.track(picture);
        let counted = if is_whole || occlusion.is_some() { &mut *tally } else { &mut rest };
        let is_left = |i: usize| occlusion.as_ref().is_none_or(|occlusion| occlusion.is_left(i));
        let grey = Light::grey(light, target.spots.len());
        let bound = (is_whole || occlusion.is_some()).then(|| bound_of(truth, target, &grey, &is_left)).flatten();
        let right = counted.add(truth, &estimate, bound, single, WRONG_MM);
        if is_whole || frame >= PHASES[0] + PHASES[1] {
            late = if right { 0 } else { late + 1 };
            tally.late = tally.late.max(late);
        }
    }
    Some(())
}

const ONLY_SHIFT: Vector6<f64> = Vector6::new(1.0, 1.0, 1.0, 0.0, 0.0, 0.0);

/// The other pose with the same picture under parallel projection: reflected along the line of sight.
fn mirrored(pose: &Rigid) -> Rigid {
    let sight = pose.translation.normalize();
    let mut rotation = pose.rotation - sight * (sight.transpose() * pose.rotation) * 2.0;
    rotation.column_mut(2).neg_mut();
    Rigid { rotation, ..*pose }
}

/// A tracker started at `pose`.
fn begun(compiled: &Arc<Compiled>, target: &Target, pose: &Rigid, light: f64) -> Tracker {
    let m = pose.rodrigues();
    let mut start: std::collections::BTreeMap<String, f64> = [("m1", m.x), ("m2", m.y)]
        .into_iter()
        .chain(["tx", "ty", "tz"].into_iter().zip(pose.translation.iter().copied()))
        .map(|(name, value)| (name.to_string(), value))
        .collect();
    let lights: &[&str] = if target.spots.len() == 1 { &["v1"] } else { &["vr", "vg", "vb"] };
    start.extend(lights.iter().map(|name| ((*name).to_string(), light)));
    if target.spots.len() > 1 {
        start.insert("m3".into(), m.z);
    }
    super::cell::direct_from(compiled, target, start)
}
