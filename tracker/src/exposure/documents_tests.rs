//! Every shipped document: advice converges or is refused; light that changes suddenly, and that flickers.
#![allow(clippy::unwrap_used)]

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;

use isophote_frame::{Frame, Plane};
use isophote_jit::{Kernel, KernelOptions, PixelFormat, VectorWidth, Window};
use isophote_symbolic::{Bindings, Model, Precision, Prediction, Summand};

use super::*;
use crate::picture::Noise;
use crate::report::points::{ModelPoint, Numbers, sizes};
use crate::solve::stage_kernels::{PixelHandling, lowering};
use crate::track::window::Reach;
use crate::{Compiled, Estimate, TrackState, Tracker, TrackerOptions};

/// Image size of poses, px: the lens is centred there.
const POSED_PX: [usize; 2] = [640, 480];
/// Margin around other targets, px.
const AROUND_PX: usize = 24;
/// Frames from setting an exposure to the first that has it.
const LATENCY: usize = 2;

/// A document with a target in front of a camera of 8 bits, 5,000 electrons.
struct Bench {
    compiled: Arc<Compiled>,
    parameters: Vec<f64>,
    sides: Vec<usize>,
    pictures: Vec<Kernel>,
    /// Noise of variance 1.
    scatter: Vec<f32>,
}

impl Bench {
    fn of(path: &Path) -> Bench {
        let model = Model::from_toml(&std::fs::read_to_string(path).unwrap());
        let model = Arc::new(model.unwrap_or_else(|faults| panic!("{}", faults[0].render("a shipped document"))));
        let compiled = Arc::new(Compiled::new(model.clone(), Precision::F32).unwrap());
        let constants: Vec<f64> = model.constants().iter().map(|constant| constant.value).collect();
        let reach = Reach::of(&model, &constants);
        let size = sizes(&model)[usize::from(model.coordinates().len() > 3)];
        let mut point = ModelPoint::made_up(&model, &constants, &reach, size, Numbers::AsStarted).unwrap();
        for roles in model.roles() {
            // A dark target must not be darker than nothing.
            if let (Some(ground), Some(height)) = (roles.background, roles.brightness) {
                let ground = ground.index();
                point.parameters[ground] = point.parameters[ground].max(-1.2 * point.parameters[height.index()]);
            }
        }
        let is_pose = model.roles().iter().any(|roles| !roles.position.is_empty());
        let (first, size, n) = (point.window.first(), point.window.size(), model.coordinates().len());
        let sides = match (is_pose, n) {
            (true, _) => POSED_PX.to_vec(),
            (_, 1) => vec![256],
            _ => (0..n).map(|axis| first[axis] + size[axis] + if axis < 2 { AROUND_PX } else { 2 }).collect(),
        };
        let options = KernelOptions {
            width: VectorWidth::Bits128,
            precision: Precision::F32,
            formats: vec![PixelFormat::F32; model.channels().len()],
            packed: true,
        };
        let entries = model.summands().into_iter().filter(|summand| !summand.is_clipped());
        let kernel = |summand: Summand| {
            let program = summand.prediction(Prediction::Unbounded, lowering(PixelHandling::All)).unwrap().unwrap();
            Kernel::compile(&program, &options).unwrap()
        };
        let pictures = entries.map(kernel).collect();
        let mut noise = Noise(11);
        let scatter = (0..1 << 16).map(|_| noise.normal() as f32).collect();
        Bench { compiled, parameters: point.parameters, sides, pictures, scatter }
    }

    fn model(&self) -> &Model {
        self.compiled.model()
    }

    fn tracker(&self, goal: ExposureGoal) -> Tracker {
        let options = TrackerOptions { exposure: Some(goal), ..TrackerOptions::default() };
        Tracker::new(self.compiled.clone(), options).unwrap()
    }

    /// A numbered frame with `light` times the light.
    fn frame(&self, number: u64, light: f64) -> Frame {
        let window = Window::of_size(std::array::from_fn(|axis| self.sides.get(axis).copied().unwrap_or(1)));
        let mut parameters = self.parameters.clone();
        let mut scaled: Vec<_> =
            self.model().roles().iter().flat_map(|r| r.brightness.into_iter().chain(r.background)).collect();
        scaled.sort();
        scaled.dedup();
        scaled.iter().for_each(|parameter| parameters[parameter.index()] *= light);
        let constants: Vec<f64> = self.model().constants().iter().map(|constant| constant.value).collect();
        let bindings = Bindings {
            parameters: &parameters,
            entry: &parameters,
            constants: &constants,
            saturation: &[f64::INFINITY],
            shift: &[0.0; 4],
        };
        let plane = |(channel, kernel): (usize, &Kernel)| {
            let mut pixels = vec![0f32; window.pixels()];
            kernel.render(&bindings, window, &mut pixels).unwrap();
            let first = (number as usize * 7919 + channel * 104_729) % self.scatter.len();
            let scatter = self.scatter.iter().cycle().skip(first);
            let bytes = pixels.iter().zip(scatter).map(|(value, scatter)| {
                let value = if value.is_nan() { 0.0 } else { *value };
                (value + (0.6 + 0.05 * value.max(0.0)).sqrt() * scatter).round().clamp(0.0, 255.0) as u8
            });
            Plane::owned(PixelFormat::U8, bytes.collect(), self.sides[0])
        };
        Frame::new(&self.sides, self.pictures.iter().enumerate().map(plane).collect()).unwrap().with_sequence(number)
    }

    /// Estimates under a controller for the light of each frame, with the exposure of that frame.
    fn run(&self, goal: ExposureGoal, light: &[f64]) -> Vec<(f64, Estimate)> {
        let mut tracker = self.tracker(goal);
        let mut controller = ExposureController::new(ControllerOptions::default());
        let mut pipeline: VecDeque<f64> = vec![1.0; LATENCY].into();
        let frame = |(number, light): (usize, &f64)| {
            let exposure = pipeline.pop_front().unwrap();
            let estimate = tracker.track(&self.frame(number as u64, light * exposure));
            controller.step(&estimate);
            pipeline.push_back(controller.factor());
            (exposure, estimate)
        };
        light.iter().enumerate().map(frame).collect()
    }
}

/// Advice this close to 1, in e-folds, counts as right.
const RIGHT: f64 = 0.15;
/// Frames until the exposure has recovered.
const RECOVERED: usize = 15;
/// Frames of each light.
const EACH: usize = 20;

/// The shipped documents that satisfy a condition.
fn shipped(is_asked: impl Fn(&str, &Bench) -> bool) -> Vec<(String, Bench)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models");
    let paths = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let documents = paths.filter(|path| path.extension().is_some_and(|end| end == "toml"));
    let named = documents.map(|path| (path.file_stem().unwrap().to_string_lossy().into_owned(), Bench::of(&path)));
    named.filter(|(name, bench)| is_asked(name, bench)).collect()
}

fn is_pose(bench: &Bench) -> bool {
    bench.model().roles().iter().any(|roles| !roles.position.is_empty())
}

#[test]
#[ignore = "long proof"]
fn followed_advice_is_right_and_unadvisable_models_are_refused() {
    let mut refused = Vec::new();
    for (name, bench) in shipped(|_, _| true) {
        for goal in [ExposureGoal::Centre, ExposureGoal::Brightness] {
            let mut tracker = bench.tracker(goal);
            if !tracker.advises_exposure() {
                assert_eq!(tracker.track(&bench.frame(1, 1.0)).exposure_advice, None, "{name}");
                refused.push(format!("{name} {}", goal.name()));
                continue;
            }
            let mut advised = |number: u64, factor: f64| {
                let estimate = tracker.track(&bench.frame(number, factor));
                assert_eq!(estimate.state, TrackState::Tracking, "{name}: {estimate:?}");
                let advice = estimate.exposure_advice.clone();
                advice.unwrap_or_else(|| panic!("{name}: no advice for the {}: {estimate:?}", goal.name())).factor
            };
            let factor = advised(1, 1.0);
            let then = advised(2, factor);
            assert!(then.ln().abs() < RIGHT, "{name}, {}: {factor}, and then {then}", goal.name());
        }
    }
    refused.sort();
    // The first has no centre along t, the second unmixes its channels.
    assert_eq!(refused, ["blob-4d centre", "three-spots brightness", "three-spots centre"]);
}

/// Ten times the light, and back: exposure is right again within 15 frames, and stays so.
fn recovers(name: &str, bench: &Bench, goal: ExposureGoal) {
    let light: Vec<f64> = (0..3 * EACH).map(|i| if (EACH..2 * EACH).contains(&i) { 10.0 } else { 1.0 }).collect();
    let run = bench.run(goal, &light);
    for (number, (exposure, estimate)) in run.iter().enumerate().filter(|(number, _)| number % EACH >= RECOVERED) {
        let advice = estimate.exposure_advice.as_ref().filter(|_| estimate.state == TrackState::Tracking);
        let is_right = advice.is_some_and(|advice| advice.factor.ln().abs() < RIGHT);
        assert!(is_right, "{name}, frame {number}, exposure {exposure}: {estimate:?}");
    }
}

#[test]
#[ignore = "long proof"]
fn exposure_recovers_from_tenfold_light_within_fifteen_frames() {
    for (name, bench) in shipped(|_, bench| !is_pose(bench) && bench.sides.len() < 4) {
        for goal in [ExposureGoal::Centre, ExposureGoal::Brightness] {
            if bench.tracker(goal).advises_exposure() {
                recovers(&name, &bench, goal);
            }
        }
    }
}

#[test]
#[ignore = "long proof"]
fn exposure_of_poses_recovers_from_tenfold_light() {
    for (name, bench) in shipped(|_, bench| is_pose(bench)) {
        recovers(&name, &bench, ExposureGoal::Brightness);
    }
}

#[test]
#[ignore = "long proof"]
fn flicker_is_not_amplified() {
    for (name, bench) in shipped(|name, _| ["spot", "spot-plane", "gaussian"].contains(&name)) {
        for (flicker_hz, rate_hz) in
            [3.0, 12.0].into_iter().flat_map(|flicker| [30.0, 60.0, 100.0].map(|rate| (flicker, rate)))
        {
            let light = |i: u32| 1.0 + 0.2 * (std::f64::consts::TAU * flicker_hz * f64::from(i) / rate_hz).sin();
            let light: Vec<f64> = (0..300).map(light).collect();
            let run = bench.run(ExposureGoal::Brightness, &light);
            let seen: Vec<f64> = run.iter().zip(&light).map(|((exposure, _), light)| exposure * light).collect();
            // Frames after the first changes and one mean.
            let [with, without] = [&seen[120..], &light[120..]].map(relative_rms);
            assert!(
                with <= without + 1e-12,
                "{name}, {flicker_hz} Hz in {rate_hz}: {with} with control, {without} without"
            );
            let off = run[120..].iter().map(|(exposure, _)| exposure).sum::<f64>() / run[120..].len() as f64;
            let steady = bench.run(ExposureGoal::Brightness, &[1.0; 20])[19].0;
            assert!((off / steady).ln().abs() < RIGHT, "{name}: {off} beside {steady} in steady light");
        }
    }
}

fn relative_rms(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (values.iter().map(|value| (value / mean - 1.0).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
}
