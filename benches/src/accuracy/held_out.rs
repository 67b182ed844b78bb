//! Conditions that nothing was tuned to: three profiles on two cameras in turn, and separate seeds.
//!
//! Each error is divided by the bound of its own frame, so that profiles and cameras share one number.

use std::time::Instant;

use isophote_tracker::{Camera, Frame, Preparing, TrackerOptions};

use super::bound::variances_of;
use super::condition::{Companion, Condition, Glare, Known, condition, lamp, nothing};
use super::document::Document;
use super::run::{Documents, each};
use super::scene::{Beside, Scene};
use super::sensor::{FULL, Random, SENSORS, Sensor};
use super::summary::median;
use super::trial::{ASTRAY_PX, Trial};

/// k₁ and k₂: zero slope at the rim, the shipped one, and a flat top.
pub const PROFILES: [[f64; 2]; 3] = [[-1.5, 0.0], [-0.5, -0.3], [0.0, -0.3]];
/// Samples along a side of a pixel: the better camera resolves a flat top's rim to a hundredth of its slope.
const SAMPLES: usize = 24;
/// Combinations of profiles and cameras.
pub const KINDS: usize = PROFILES.len() * SENSORS.len();
/// Frames of a sequence.
const LENGTH: usize = 45;
/// First frames of a sequence, in which the noise is learned; they are not counted.
const LEARNING: usize = 30;
/// An estimate counts as doubted below this confidence, above `MISFIT` in χ²/ν, or if a substitute was fitted.
const DOUBT: f64 = 0.5;
const MISFIT: f64 = 1.35;

/// A row of the table.
#[derive(Clone, Copy)]
pub struct HeldOut {
    /// Contents of the frames; profile and camera vary.
    pub condition: Condition,
    /// A shipped document.
    pub document: &'static str,
    /// Starting values beside the profile.
    pub known: fn(&Scene) -> Known,
    /// The camera document's noise variance over the true one.
    pub stated: f64,
    /// Goal of RMSE/CRLB, tracking.
    pub goal: f64,
    /// Single frames or a sequence.
    pub mode: FitMode,
}

/// Kind of a row's estimates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FitMode {
    /// Single frames, cold or with a prior.
    Single,
    /// The last frames of a tracked target.
    Followed,
}

const fn row(condition: Condition, document: &'static str, goal: f64) -> HeldOut {
    HeldOut { condition, document, known: nothing, stated: 1.0, goal, mode: FitMode::Single }
}

/// All rows, in the order of the table.
pub fn rows() -> Vec<HeldOut> {
    let plain = condition("S0");
    let lit = condition("S10");
    let lobe = Glare::Lorentz { height: 120.0, centre: [8.0, 12.0], width: 35.0 };
    let glare = Condition { name: "Lorentz lobe of 120 DN", saturated: 0.3, glare: lobe, ..plain };
    let small = Condition { semi_axes_px: [3.0, 2.2], peak: 140.0, ..condition("small_S0") };
    let beside = |name, of: Condition, size| Condition {
        name,
        companion: Some(Companion { share: 0.2, distance_px: 6.0, size }),
        ..of
    };
    let hidden = [
        ("5 % hidden", 0.05),
        ("9 % hidden", 0.09),
        ("13 % hidden", 0.13),
        ("17 % hidden", 0.17),
        ("21 % hidden", 0.21),
        ("25 % hidden", 0.25),
        ("29 % hidden", 0.29),
        ("33 % hidden", 0.33),
        ("37 % hidden", 0.37),
        ("40 % hidden", 0.40),
    ];
    let mut rows = vec![
        row(Condition { name: "plain", ..plain }, "spot-plane", 1.06),
        row(Condition { name: "0.05 % hot", hot: 5e-4, ..plain }, "spot-plane", 1.05),
        row(Condition { name: "0.5 % hot", hot: 5e-3, ..plain }, "spot-plane", 1.05),
        row(Condition { name: "0.05 % hot, S30", hot: 5e-4, saturated: 0.3, ..plain }, "spot-plane", 1.05),
        row(Condition { name: "0.5 % hot, S30", hot: 5e-3, saturated: 0.3, ..plain }, "spot-plane", 1.05),
        row(glare, "spot-plane", 1.3),
        HeldOut { known: lamp, ..row(glare, "spot-lobe", 1.3) },
        row(Condition { name: "disc before 20 %", behind_disc: 0.2, ..lit }, "spot-plane", 1.1),
        row(Condition { name: "half plane before 25 %", occluded: 0.25, ..lit }, "spot-plane", 1.1),
        row(Condition { name: "40 % blinded", blinded: 0.4, ..lit }, "spot-plane", 2.5),
        row(beside("companion at 6 px of 20 × 14", plain, 1.0), "spot-plane", f64::INFINITY),
        row(beside("companion at 6 px of 4.5 × 3.3", condition("small_S0"), 1.0), "spot-plane", f64::INFINITY),
        row(Condition { name: "3.0 × 2.2 px", ..small }, "spot-plane", 1.08),
        row(Condition { name: "3.0 × 2.2 px", ..small }, "spot", 1.08),
    ];
    rows.extend(hidden.map(|(name, occluded)| row(Condition { name, occluded, ..lit }, "spot-plane", 1.15)));
    let disc = Condition { name: "disc before 20 %, followed", behind_disc: 0.2, ..lit };
    let half = Condition { name: "half plane before 25 %, followed", occluded: 0.25, ..lit };
    let glare = Condition { name: "Lorentz lobe of 120 DN, followed", ..glare };
    let followed = [row(disc, "spot-plane", 1.1), row(half, "spot-plane", 1.1), row(glare, "spot-plane", 1.3)];
    rows.extend(followed.map(|row| HeldOut { mode: FitMode::Followed, ..row }));
    for (name, stated) in [("noise stated 30 % too large", 1.3), ("noise stated 30 % too small", 0.7)] {
        rows.push(HeldOut { stated, mode: FitMode::Followed, ..row(Condition { name, ..plain }, "spot-plane", 1.06) });
    }
    rows
}

/// One answer, relative to its frame's bound.
#[derive(Clone, Copy, Debug, Default)]
struct Answered {
    /// Squared error of the centre over the bound's variance; `None` without a valid answer.
    square: Option<f64>,
    /// `None` without a covariance.
    nees: Option<f64>,
    silent: bool,
    /// Whether the estimate is flagged as doubtful.
    doubted: bool,
    time_us: f64,
}

/// Answers of a row.
#[derive(Clone, Debug, Default)]
struct Sum {
    answers: Vec<Answered>,
}

impl Sum {
    fn mean(&self, of: impl Fn(&Answered) -> Option<f64>) -> f64 {
        let all: Vec<f64> = self.answers.iter().filter_map(of).collect();
        all.iter().sum::<f64>() / all.len() as f64
    }

    fn ratio(&self) -> f64 {
        self.mean(|answer| answer.square).sqrt()
    }

    fn share(&self, of: impl Fn(&Answered) -> bool) -> f64 {
        100.0 * self.answers.iter().filter(|answer| of(answer)).count() as f64 / self.answers.len().max(1) as f64
    }

    fn median_ms(&self) -> f64 {
        median(self.answers.iter().map(|answer| answer.time_us / 1e3))
    }

    /// RMSE/CRLB with its standard error, NEES, failures.
    fn text(&self) -> String {
        let nees = self.mean(|answer| answer.square.and(answer.nees));
        let squares: Vec<f64> = self.answers.iter().filter_map(|answer| answer.square).collect();
        let n = squares.len().max(1) as f64;
        let mean = squares.iter().sum::<f64>() / n;
        let deviation = (squares.iter().map(|square| (square - mean).powi(2)).sum::<f64>() / n).sqrt();
        let error = deviation / n.sqrt() / (2.0 * mean.sqrt());
        let failed = self.share(|answer| answer.square.is_none());
        let silent = self.share(|answer| answer.silent);
        match squares.is_empty() {
            true => format!("–; –; {failed:.1}, {silent:.1}"),
            false => format!("{:.2} ± {error:.2}; {nees:.2}; {failed:.1}, {silent:.1}", self.ratio()),
        }
    }
}

/// The head of the table.
pub const HEAD: &str = "| condition | document | to reach | tracking: RMSE/CRLB; NEES; failed, silent, % | cold | without alternatives | doubted, % | each profile on 8 bits, 16 bits, tracking | ms |\n|---|---|---|---|---|---|---|---|---|";

/// A row's line, over that many frames.
pub fn line(row: &HeldOut, documents: &mut Documents, frames: usize, seed: usize) -> String {
    let document = documents.get(row.document);
    let all: Vec<[Vec<Answered>; 3]> = match row.mode {
        FitMode::Single => each(frames, |number| single(row, document, (number, seed)).map(|answered| vec![answered])),
        FitMode::Followed => each(frames.div_ceil(LENGTH - LEARNING), |number| sequence(row, document, (number, seed))),
    };
    let sum = |start: usize, keep: &dyn Fn(usize) -> bool| Sum {
        answers: all.iter().enumerate().filter(|(n, _)| keep(*n)).flat_map(|(_, three)| three[start].clone()).collect(),
    };
    let whole = |start| sum(start, &|_| true);
    let format_number =
        |value: f64, digits: usize| if value.is_finite() { format!("{value:.digits$}") } else { "–".into() };
    let kinds: Vec<String> =
        (0..KINDS).map(|kind| format_number(sum(1, &|number| number % KINDS == kind).ratio(), 2)).collect();
    let (cold, tracking, plain) = (whole(0), whole(1), whole(2));
    format!(
        "| {} | `{}` | {} | {} | {} | {} | {:.1} | {} | {}, {} |",
        row.condition.name,
        row.document,
        if row.goal.is_finite() { format_number(row.goal, 2) } else { "never worse, said".into() },
        tracking.text(),
        cold.text(),
        plain.text(),
        tracking.share(|answer| answer.doubted),
        kinds.join(" "),
        format_number(tracking.median_ms(), 1),
        format_number(cold.median_ms(), 1)
    )
}

fn kind(number: usize) -> ([f64; 2], Sensor) {
    (PROFILES[number % PROFILES.len()], SENSORS[number / PROFILES.len() % SENSORS.len()])
}

/// A scene with its camera, and the bound: the mean variance of a coordinate of the centre, px².
fn drawn(row: &HeldOut, (number, seed): (usize, usize)) -> (Scene, Sensor, f64, Random) {
    let (profile, sensor) = kind(number);
    let mut random = Random::of(&format!("{} {seed}", row.condition.name), number);
    let scene = Scene::draw(Condition { profile, samples: SAMPLES, ..row.condition }, &mut random);
    let beside = match (row.condition.glare, row.document) {
        (Glare::None, _) => Beside::Even,
        (_, "spot-lobe") => Beside::Lobe,
        _ => Beside::Plane,
    };
    let variances = variances_of(&scene, beside, &|light| sensor.variance(light));
    (scene, sensor, (variances[0] + variances[1]) / 2.0, random)
}

fn exposed(scene: &Scene, sensor: Sensor, random: &mut Random) -> Frame {
    let mut values = sensor.values(&scene.seen().0, random);
    for value in &mut values {
        if random.uniform(0.0, 1.0) < scene.condition.hot {
            *value = sensor.levels as u16;
        }
    }
    sensor.frame(&values, scene.condition.side_px)
}

/// Starting values: the profile, and levels in the camera's own units.
fn perturbed_prior(scene: &Scene, sensor: Sensor, known: Known) -> Known {
    let [k1, k2] = scene.condition.profile;
    let own = |(name, value): (&'static str, f64)| {
        let is_light = ["v0", "v1", "lh", "gx", "gy"].contains(&name);
        (name, if is_light { value * sensor.scale() } else { value })
    };
    [("k1", k1), ("k2", k2)].into_iter().chain(known.into_iter().map(own)).collect()
}

fn camera(sensor: Sensor, stated: f64) -> Camera {
    let known = sensor.camera();
    Camera {
        electrons_per_dn: known.electrons_per_dn.map(|electrons| electrons / stated),
        read_noise_e: known.read_noise_e.map(|noise| noise / stated.sqrt()),
        ..known
    }
}

/// One frame from a cold start, from the last frame's answer, and from that without alternatives.
fn single(row: &HeldOut, document: &Document, number: (usize, usize)) -> [Answered; 3] {
    let (scene, sensor, bound, mut random) = drawn(row, number);
    let frame = exposed(&scene, sensor, &mut random);
    let known = (row.known)(&scene);
    let prior = [scene.prior(&mut random), known.clone()].concat();
    let starts = [(known, Preparing::AtOnce), (prior.clone(), Preparing::AtOnce), (prior, Preparing::Beside)];
    starts.map(|(start, preparing)| {
        let options = TrackerOptions { camera: camera(sensor, row.stated), preparing, ..TrackerOptions::default() };
        let mut tracker = document.tracker_with(&perturbed_prior(&scene, sensor, start), options);
        let begin = Instant::now();
        let estimate = tracker.track(&frame);
        let time_us = begin.elapsed().as_secs_f64() * 1e6;
        judged(&scene, (sensor, bound), document, &estimate, time_us)
    })
}

/// The last frames of a sequence of a target at rest; no cold start.
fn sequence(row: &HeldOut, document: &Document, number: (usize, usize)) -> [Vec<Answered>; 3] {
    let (scene, sensor, bound, mut random) = drawn(row, number);
    let options = TrackerOptions { camera: camera(sensor, row.stated), ..TrackerOptions::default() };
    let start = perturbed_prior(&scene, sensor, scene.prior(&mut random));
    let mut tracker = document.tracker_with(&start, options);
    let mut answered = Vec::new();
    for frame in 0..LENGTH {
        let image = exposed(&scene, sensor, &mut random);
        let begin = Instant::now();
        let estimate = tracker.track(&image);
        let time_us = begin.elapsed().as_secs_f64() * 1e6;
        if frame >= LEARNING {
            answered.push(judged(&scene, (sensor, bound), document, &estimate, time_us));
        }
    }
    [Vec::new(), answered, Vec::new()]
}

fn judged(
    scene: &Scene,
    (sensor, bound): (Sensor, f64),
    document: &Document,
    estimate: &isophote_tracker::Estimate,
    time_us: f64,
) -> Answered {
    let Some(mut answer) = document.answer(estimate) else {
        return Answered { silent: true, time_us, ..Answered::default() };
    };
    answer.brightness *= FULL / sensor.levels;
    let trial = Trial::of(&answer, scene);
    let [x, y] = trial.error;
    let doubted = estimate.substitute.is_some()
        || estimate.confidence.is_some_and(|confidence| confidence < DOUBT)
        || trial.reduced.is_some_and(|reduced| reduced > MISFIT);
    Answered {
        square: (x.hypot(y) < ASTRAY_PX).then_some((x * x + y * y) / (2.0 * bound)),
        nees: trial.nees,
        silent: false,
        doubted,
        time_us,
    }
}
