//! A target that moves beside a smaller decoy is never confused with it, through model swaps, frame gaps, fading and
//! covers. `ISOPHOTE_EVENTS` sets the least number of swaps and of gaps, `ISOPHOTE_SEED` the random seed, and `ISOPHOTE_SCENE` the
//! scene.
#![allow(clippy::unwrap_used, clippy::print_stdout)] // a long run prints its summary
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use isophote_frame::{Frame, Plane};
use isophote_jit::PixelFormat;
use isophote_symbolic::{Model, Precision};

use crate::picture::Noise;
use crate::{Compiled, Estimate, TrackState, Tracker, TrackerOptions};

const DOCUMENTS: [&str; 5] = [
    include_str!("../../../tests/documents/plain-spot.toml"),
    include_str!("../../../models/spot.toml"),
    include_str!("../../../models/spot-plane.toml"),
    include_str!("../../../models/gaussian.toml"),
    include_str!("../../../models/rational-spot.toml"),
];
const SIZE: [usize; 2] = [240, 180];
const GROUND: f64 = 20.0;
const HEIGHT: f64 = 120.0;
/// Semi-axes of the target, px.
const SEMI_AXES: [f64; 2] = [17.0, 12.0];
/// Decoys, falloffs and noise.
const SCENES: [Scene; 5] = [
    Scene { decoy: 0.5, decoy_height: HEIGHT, falloff: [-0.5, -0.3, -0.2], noise: 1.5 },
    Scene { decoy: 0.35, decoy_height: 200.0, falloff: [-1.0, 0.0, 0.0], noise: 1.5 },
    Scene { decoy: 0.65, decoy_height: 80.0, falloff: [-0.5, -0.3, -0.2], noise: 3.0 },
    Scene { decoy: 0.5, decoy_height: 60.0, falloff: [-2.0, 1.0, 0.0], noise: 3.0 },
    Scene { decoy: 0.4, decoy_height: 160.0, falloff: [0.0, -0.5, -0.5], noise: 1.0 },
];
/// An estimate is of another object if its error exceeds both limits: px, and its standard deviations.
const OFF_PX: f64 = 5.0;
const OFF_DEVIATIONS: f64 = 6.0;

/// Constants of a world.
#[derive(Clone, Copy)]
struct Scene {
    /// The decoy's semi-axes over the target's, and its height.
    decoy: f64,
    decoy_height: f64,
    /// Factors of s, s² and s³.
    falloff: [f64; 3],
    /// The standard deviation of a pixel.
    noise: f64,
}

/// An object in front of the target.
#[derive(Clone, Copy)]
enum Cover {
    /// Covers one side of a line: its normal's angle.
    HalfPlane(f64),
    /// Angle of the direction that it comes from, and radius, px.
    Disc(f64, f64),
}

/// The state of the scene.
struct World {
    scene: Scene,
    noise: Noise,
    scatter: Vec<f64>,
    number: u64,
    /// The target's path along each axis: middle, amplitude, angle per frame and phase.
    path: [[f64; 4]; 2],
    decoy: [f64; 2],
    height: f64,
    /// The cover, the share of the target's width behind it, and its value.
    cover: Option<(Cover, f64, f64)>,
}

impl World {
    fn new(seed: u64, scene: Scene) -> World {
        let mut noise = Noise(seed);
        let scatter = (0..1 << 15).map(|_| scene.noise * noise.normal()).collect();
        let (path, decoy) = ([[0.0; 4]; 2], [0.0; 2]);
        let mut world = World { scene, noise, scatter, number: 0, path, decoy, height: HEIGHT, cover: None };
        world.elsewhere();
        world
    }

    fn between(&mut self, least: f64, most: f64) -> f64 {
        least + (most - least) * self.noise.uniform()
    }

    fn count(&mut self, least: u64, most: u64) -> u64 {
        least + (self.noise.uniform() * (most - least + 1) as f64) as u64
    }

    /// Moves the target, and the decoy, which stays in the upper part of the picture.
    fn elsewhere(&mut self) {
        let [x, y] = [self.between(50.0, 95.0), self.between(15.0, 40.0)];
        let turns = [self.between(0.01, 0.08), self.between(0.01, 0.08)];
        let phases = [self.between(0.0, TAU), self.between(0.0, TAU)];
        self.path = [[120.0, x, turns[0], phases[0]], [118.0, y, turns[1], phases[1]]];
        self.decoy = [self.between(20.0, 220.0), self.between(15.0, 35.0)];
    }

    fn centre(&self) -> [f64; 2] {
        self.path.map(|[middle, swing, turn, phase]| middle + swing * (turn * self.number as f64 + phase).sin())
    }

    /// True when all of the target is visible.
    fn is_whole(&self) -> bool {
        self.height == HEIGHT && self.cover.is_none()
    }

    /// True when nothing of the target is visible.
    fn is_gone(&self) -> bool {
        self.height == 0.0 || self.cover.is_some_and(|(_, share, _)| share >= 1.0)
    }

    fn frame(&self) -> Frame {
        let [bx, by] = self.centre();
        let reach = SEMI_AXES[0] + 2.0;
        let covered = |x: f64, y: f64| match self.cover {
            Some((Cover::HalfPlane(angle), share, value)) => {
                let depth = (x - bx) * angle.cos() + (y - by) * angle.sin();
                (depth < reach * (2.0 * share - 1.0)).then_some(value)
            }
            Some((Cover::Disc(angle, radius), share, value)) => {
                let away = (radius + reach) - share * 2.0 * reach;
                let off = (x - bx + away * angle.cos()).hypot(y - by + away * angle.sin());
                (off < radius).then_some(value)
            }
            None => None,
        };
        let Scene { decoy, decoy_height, falloff: [a, b, c], .. } = self.scene;
        let spot = |x: f64, y: f64, centre: [f64; 2], scale: f64, height: f64| {
            let (u, w) = ((x - centre[0]) / (scale * SEMI_AXES[0]), (y - centre[1]) / (scale * SEMI_AXES[1]));
            let s = u * u + w * w;
            if s < 1.0 { height * (1.0 + s * (a + s * (b + c * s))) } else { 0.0 }
        };
        let first = (self.number as usize).wrapping_mul(7919);
        let boxed = |x: f64, y: f64, centre: [f64; 2]| (x - centre[0]).abs().max((y - centre[1]).abs()) < SEMI_AXES[0];
        let value = |i: usize| {
            let (x, y) = ((i % SIZE[0]) as f64, (i / SIZE[0]) as f64);
            let mut light = GROUND;
            if boxed(x, y, [bx, by]) {
                light += spot(x, y, [bx, by], 1.0, self.height);
            }
            if boxed(x, y, self.decoy) {
                light += spot(x, y, self.decoy, decoy, decoy_height);
            }
            let scatter = self.scatter[(first + i) % self.scatter.len()];
            (covered(x, y).unwrap_or(light) + scatter).round().clamp(0.0, 255.0) as u8
        };
        let bytes = (0..SIZE[0] * SIZE[1]).map(value).collect();
        Frame::new(&SIZE, vec![Plane::owned(PixelFormat::U8, bytes, SIZE[0])]).unwrap().with_sequence(self.number)
    }
}

/// A run, and its statistics.
struct Trial {
    world: World,
    tracker: Tracker,
    kernels: Vec<Arc<Compiled>>,
    swaps: usize,
    gaps: usize,
    tracked: usize,
    frames: usize,
    /// Frames in which all of the target is visible, and those of them in which it was found.
    whole: usize,
    found: usize,
    /// Estimates of another object, by the last event.
    wrong: BTreeMap<&'static str, usize>,
    log: Vec<String>,
}

impl Trial {
    fn new(seed: u64, scene: Scene) -> Trial {
        let compiled = |text: &&str| {
            let model = Model::from_toml(text).unwrap_or_else(|d| panic!("{}", d[0].render("test")));
            Arc::new(Compiled::new(Arc::new(model), Precision::F32).unwrap())
        };
        let kernels: Vec<Arc<Compiled>> = DOCUMENTS.iter().map(compiled).collect();
        let tracker = Tracker::new(kernels[0].clone(), TrackerOptions::default()).unwrap();
        let (wrong, log) = (BTreeMap::new(), Vec::new());
        let (world, [swaps, gaps, tracked, frames, whole, found]) = (World::new(seed, scene), [0; 6]);
        Trial { world, tracker, kernels, swaps, gaps, tracked, frames, whole, found, wrong, log }
    }

    fn see(&mut self, why: &'static str) {
        self.world.number += 1;
        let estimate = self.tracker.track(&self.world.frame());
        self.frames += 1;
        self.whole += usize::from(self.world.is_whole());
        if estimate.state != TrackState::Tracking {
            return;
        }
        self.tracked += 1;
        let is_wrong = self.is_wrong(&estimate);
        self.found += usize::from(self.world.is_whole() && !is_wrong);
        if is_wrong {
            *self.wrong.entry(why).or_default() += 1;
            let (name, truth) = (self.tracker.compiled().model().name(), self.world.centre());
            let at: Vec<String> = estimate.parameters.iter().map(|value| format!("{value:.4}")).collect();
            let number = self.world.number;
            let cover = self.world.cover.map(|cover| cover.1);
            self.log.push(format!(
                "{why}: frame {number}, {name}, at {truth:?} (the other at {:?}), height {}, cover {cover:?}: {at:?}, confidence {:?}, {:?}, {:?}",
                self.world.decoy, self.world.height, estimate.confidence, estimate.reduced_chi_square, estimate.substitute
            ));
        }
    }

    fn is_wrong(&self, estimate: &Estimate) -> bool {
        let centre = &self.tracker.compiled().model().roles()[0].centre;
        let truth = self.world.centre();
        let off =
            (0..2).map(|axis| (estimate.parameters[centre[axis].index()] - truth[axis]).powi(2)).sum::<f64>().sqrt();
        let position = |axis: usize| estimate.order.iter().position(|parameter| *parameter == centre[axis]);
        let variance = |axis: usize| Some(estimate.covariance.as_ref()?[position(axis)?][position(axis)?]);
        let deviation = (0..2).filter_map(variance).sum::<f64>().sqrt();
        self.world.is_gone() || off > OFF_PX.max(OFF_DEVIATIONS * deviation)
    }

    fn swap(&mut self) {
        let next = self.world.count(0, DOCUMENTS.len() as u64 - 1) as usize;
        self.tracker.swap(self.kernels[next].clone(), TrackerOptions::default());
        self.swaps += 1;
    }

    fn gap(&mut self) {
        self.world.number += self.world.count(1, 60);
        self.gaps += 1;
    }

    /// The target disappears, is absent for some frames, with swaps and gaps, and reappears, possibly elsewhere.
    fn vanish(&mut self, why: &'static str, steps: u64, set: impl Fn(&mut World, f64)) {
        for step in 1..=steps {
            set(&mut self.world, step as f64 / steps as f64);
            self.see(why);
        }
        let away = self.world.count(0, 50);
        for _ in 0..away {
            match self.world.count(0, 39) {
                0 => self.swap(),
                1 => self.gap(),
                _ => {}
            }
            self.see(why);
        }
        if self.world.count(0, 1) == 0 {
            self.world.elsewhere();
        }
        let back = self.world.count(1, 10);
        for step in (0..back).rev() {
            set(&mut self.world, step as f64 / back as f64);
            self.see(why);
        }
        (self.world.height, self.world.cover) = (HEIGHT, None);
    }

    fn act(&mut self) {
        let why = match self.world.count(0, 29) {
            0..=13 => {
                self.swap();
                "swap"
            }
            14..=27 => {
                self.gap();
                "gap"
            }
            28 => {
                let steps = self.world.count(1, 20);
                self.vanish("fading", steps, |world, share| world.height = HEIGHT * (1.0 - share));
                "faded"
            }
            _ => {
                let (angle, radius) = (self.world.between(-PI, PI), self.world.between(30.0, 60.0));
                let value = [8.0, GROUND, 45.0][self.world.count(0, 2) as usize];
                let cover =
                    if self.world.count(0, 1) == 0 { Cover::HalfPlane(angle) } else { Cover::Disc(angle, radius) };
                let steps = self.world.count(1, 20);
                self.vanish("hiding", steps, |world, share| world.cover = Some((cover, share, value)));
                "hidden"
            }
        };
        for _ in 0..self.world.count(1, 6) {
            self.see(why);
        }
    }
}

#[test]
#[ignore = "long proof"]
fn identity_is_right_through_swaps_gaps_and_covers() {
    let number = |name: &str, otherwise: usize| {
        std::env::var(name).map_or(otherwise, |value| value.parse().unwrap_or_else(|_| panic!("{name} is a number")))
    };
    let (events, seed, scene) =
        (number("ISOPHOTE_EVENTS", 100), number("ISOPHOTE_SEED", 1), number("ISOPHOTE_SCENE", 0));
    let mut trial = Trial::new(0x9e37_79b9_7f4a_7c15 ^ seed as u64, SCENES[scene]);
    for _ in 0..8 {
        trial.see("start");
    }
    while trial.swaps.min(trial.gaps) < events {
        trial.act();
    }
    let Trial { swaps, gaps, frames, tracked, whole, found, wrong, log, .. } = &trial;
    let summary = format!(
        "scene {scene}, seed {seed}: {swaps} swaps, {gaps} gaps, {frames} frames, {tracked} tracked ({found} of {whole} with the whole target), of another thing: {wrong:?}"
    );
    println!("{summary}");
    assert!(log.is_empty(), "{summary}\n{}", log.join("\n"));
    assert!(2 * tracked > *frames, "{summary}");
}
