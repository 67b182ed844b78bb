//! Required sampling of pixels: moving spots of 2 to 100 px, on two cameras, tracked by `spot` as shipped (`quadrature
//! = "auto"`) and with fixed numbers of Gauss points.

use std::sync::Arc;

use isophote_symbolic::{Model, Precision};
use isophote_tracker::{Compiled, TrackState, Tracker, TrackerOptions};

use super::bound::variances_of;
use super::condition::{Condition, condition};
use super::light::PROFILE;
use super::run::each;
use super::scene::{Beside, Scene};
use super::sensor::{Random, SENSORS, Sensor};

/// Longer semi-axes, px; the shorter ones are 0.72 times these.
const SIZES_PX: [f64; 10] = [2.0, 3.0, 4.5, 7.0, 10.0, 20.0, 30.0, 40.0, 60.0, 100.0];
const ROUNDNESS: f64 = 0.72;
/// Frames of a sequence, and the first ones of them, which are not counted.
const LENGTH: usize = 20;
const SETTLING: usize = 4;
/// px a frame
const VELOCITY: [f64; 2] = [0.31, 0.17];
/// Sampling: `auto`, or points per side.
const WAYS: [&str; 4] = ["\"auto\"", "1", "2", "5"];

fn tracker_of(sensor: Sensor, compiled: &Arc<Compiled>) -> Tracker {
    let [k1, k2] = PROFILE;
    let start = [("k1", k1), ("k2", k2)].map(|(name, value)| (name.to_string(), value)).into();
    let options = TrackerOptions { start, camera: sensor.camera(), ..TrackerOptions::default() };
    Tracker::new(compiled.clone(), options).unwrap()
}

/// Result of one frame.
#[derive(Clone, Copy)]
struct Seen {
    /// Squared error, px², and eᵀC⁻¹e.
    square: f64,
    nees: f64,
    /// Relative error.
    brightness: f64,
    points: u32,
    slopes: u32,
    passes: u32,
}

/// The Markdown table, of that many sequences per size.
pub fn table(sequences: usize) -> String {
    let text = crate::text("spot");
    let documents = WAYS.map(|way| {
        let text = text.replace("quadrature = \"auto\"", &format!("quadrature = {way}"));
        assert!(way == WAYS[0] || text != crate::text("spot"));
        Arc::new(Compiled::new(Arc::new(Model::from_toml(&text).unwrap()), Precision::F32).unwrap())
    });
    let mut lines = String::new();
    for sensor in SENSORS {
        lines += &format!(
            "\n{}\n\n| semi-axes, px | chosen: points, slopes | passes | RMSE/CRLB: auto | 1 | 2 × 2 | 5 × 5 | auto by 5 × 5 | NEES: auto | 5 × 5 | brightness, %: auto | 1 |\n|---|---|---|---|---|---|---|---|---|---|---|---|\n",
            sensor.name
        );
        for size in SIZES_PX {
            let semi_axes_px = [size, ROUNDNESS * size];
            let side_px = (2.0 * (1.6 * size + 8.0 + LENGTH as f64 * VELOCITY[0])) as usize;
            let what = Condition { side_px, semi_axes_px, ..condition("S0") };
            let bounds = each(8, |number| {
                let scene = Scene::draw(what, &mut Random::of("sampling", number));
                let variances = variances_of(&scene, Beside::Even, &|light| sensor.variance(light));
                variances[0] + variances[1]
            });
            let bound = (bounds.iter().sum::<f64>() / bounds.len() as f64).sqrt();
            let seen: Vec<[Vec<Seen>; 4]> = each(sequences, |number| sequence(sensor, what, number, &documents));
            let all = |way: usize| seen.iter().flat_map(move |sequence| sequence[way].iter().copied());
            let count = |way: usize| all(way).count().max(1) as f64;
            let mean = |way: usize, value: fn(Seen) -> f64| all(way).map(value).sum::<f64>() / count(way);
            let rmse = |way: usize| mean(way, |seen| seen.square).sqrt();
            let mut chosen: Vec<(u32, u32)> = all(0).map(|seen| (seen.points, seen.slopes)).collect();
            chosen.sort_unstable();
            let (points, slopes) = chosen.get(chosen.len() / 2).copied().unwrap_or_default();
            lines += &format!(
                "| {} × {:.2} | {points}, {slopes} | {:.1} | {:.3} | {:.3} | {:.3} | {:.3} | {:.3} | {:.2} | {:.2} | {:+.2} | {:+.2} |\n",
                semi_axes_px[0],
                semi_axes_px[1],
                mean(0, |seen| f64::from(seen.passes)),
                rmse(0) / bound,
                rmse(1) / bound,
                rmse(2) / bound,
                rmse(3) / bound,
                rmse(0) / rmse(3),
                mean(0, |seen| seen.nees),
                mean(3, |seen| seen.nees),
                100.0 * mean(0, |seen| seen.brightness),
                100.0 * mean(1, |seen| seen.brightness),
            );
            let lost = (0..WAYS.len()).map(|way| sequences * (LENGTH - SETTLING) - all(way).count());
            let lost: Vec<usize> = lost.collect();
            if lost.iter().any(|lost| *lost > 0) {
                lines += &format!("\nNot tracked: {lost:?}\n");
            }
        }
    }
    lines
}

/// Tracks the same frames with each sampling.
fn sequence(sensor: Sensor, what: Condition, number: usize, documents: &[Arc<Compiled>; 4]) -> [Vec<Seen>; 4] {
    let mut random = Random::of("sampling", number);
    let mut scene = Scene::draw(what, &mut random);
    let start = [0, 1].map(|axis| scene.centre[axis] - VELOCITY[axis] * LENGTH as f64 / 2.0);
    let mut trackers = documents.each_ref().map(|document| tracker_of(sensor, document));
    let mut seen: [Vec<Seen>; 4] = Default::default();
    for frame in 0..LENGTH {
        scene.centre = [0, 1].map(|axis| start[axis] + VELOCITY[axis] * frame as f64);
        let values = sensor.values(&scene.light(&scene.unknowns(Beside::Even)), &mut random);
        let image = sensor.frame(&values, what.side_px);
        for (tracker, seen) in trackers.iter_mut().zip(&mut seen) {
            let estimate = tracker.track(&image);
            if frame < SETTLING || estimate.state != TrackState::Tracking {
                continue;
            }
            let error = [0, 1].map(|axis| estimate.parameters[axis] - scene.centre[axis]);
            let Some(covariance) = &estimate.covariance else { continue };
            let (xx, xy, yy) = (covariance[0][0], covariance[0][1], covariance[1][1]);
            let [x, y] = error;
            let sampled = estimate.sampled.unwrap_or(isophote_tracker::Sampled { points: 0, slopes: 0 });
            let brightness = estimate.parameters[8] / sensor.scale() / scene.brightness - 1.0;
            seen.push(Seen {
                square: x * x + y * y,
                nees: (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy),
                brightness,
                points: sampled.points,
                slopes: sampled.slopes,
                passes: estimate.stages.iter().map(|stage| stage.passes).sum(),
            });
        }
    }
    seen
}
