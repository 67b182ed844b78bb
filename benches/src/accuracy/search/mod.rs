//! Cold starts in whole frames: detection rate and time.

pub mod faint;
pub mod scene;

use std::fmt::Write as _;
use std::sync::Arc;
use std::time::Instant;

use isophote_symbolic::{Model, Precision};
use isophote_tracker::{Compiled, TrackState, Tracker, TrackerOptions};

use super::shared_out;
use scene::{Profile, Scene, SceneObject, height};

/// Tolerance of a correct fit, px from the target's centre.
const RIGHT_PX: f64 = 2.0;
/// Objects beside the target.
const CLUTTER: usize = 10;

/// Name and height of the target, DN.
pub fn conditions() -> [(&'static str, f64); 5] {
    [("S0", height(0.0)), ("S10", height(0.1)), ("S30", height(0.3)), ("S60", height(0.6)), ("dark", 30.0)]
}

/// Counts of outcomes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Counts {
    /// Frames.
    pub frames: usize,
    /// Tracking, at the target.
    pub right: usize,
    /// Tracking, elsewhere.
    pub wrong: usize,
}

/// One condition.
pub struct Row {
    /// E.g. `S30, 10 others`.
    pub name: String,
    /// Outcomes.
    pub counts: Counts,
    /// Median time of a frame, ms.
    pub median_ms: f64,
}

/// models/spot.toml.
pub fn compiled() -> Arc<Compiled> {
    Arc::new(Compiled::new(Arc::new(Model::from_toml(&crate::text("spot")).unwrap()), Precision::F32).unwrap())
}

fn is_at(parameters: &[f64], target: Option<&SceneObject>) -> bool {
    target.is_some_and(|target| (parameters[0] - target.centre[0]).hypot(parameters[1] - target.centre[1]) < RIGHT_PX)
}

/// Cold starts of a fresh tracker in seeded frames, on all processors.
pub fn measure(name: &str, compiled: &Arc<Compiled>, frames: usize, scene: impl Fn(u64) -> Scene + Sync) -> Row {
    let parts = shared_out(frames, |seed| look(compiled, &scene(seed)));
    let mut row = Row { name: name.to_string(), counts: Counts { frames, ..Counts::default() }, median_ms: 0.0 };
    let mut times = Vec::new();
    for seen in parts.into_iter().flatten() {
        times.push(seen.ms);
        let counts = &mut row.counts;
        counts.right += usize::from(seen.is_right == Some(true));
        counts.wrong += usize::from(seen.is_right == Some(false));
    }
    times.sort_by(f64::total_cmp);
    row.median_ms = times[times.len() / 2];
    row
}

/// Result of one frame; `None`: nothing was tracked.
struct Seen {
    ms: f64,
    is_right: Option<bool>,
}

fn look(compiled: &Arc<Compiled>, scene: &Scene) -> Seen {
    let frame = scene.frame();
    let mut tracker = Tracker::new(compiled.clone(), TrackerOptions::default()).unwrap();
    let start = Instant::now();
    let estimate = tracker.track(&frame);
    let ms = start.elapsed().as_secs_f64() * 1e3;
    let is_tracking = estimate.state == TrackState::Tracking;
    Seen { ms, is_right: is_tracking.then(|| is_at(&estimate.parameters, scene.target.as_ref())) }
}

/// All conditions: the target alone, among other objects, and those alone.
pub fn rows(compiled: &Arc<Compiled>, frames: usize) -> Vec<Row> {
    let mut rows = Vec::new();
    for (name, height) in conditions() {
        rows.push(measure(&format!("{name}, alone"), compiled, frames, |seed| Scene::new(seed, height, 0)));
    }
    for (name, height) in conditions() {
        let scene = |seed: u64| Scene::new(seed + 1_000_000, height, CLUTTER);
        rows.push(measure(&format!("{name}, {CLUTTER} others"), compiled, frames, scene));
    }
    let scene = |seed: u64| Scene::new(seed + 2_000_000, 180.0, CLUTTER).without_target();
    let scene = move |seed: u64| {
        let mut scene = scene(seed);
        scene.clutter.retain(|object| object.profile != Profile::Spot);
        scene
    };
    rows.push(measure("no target, others of other shapes", compiled, frames, scene));
    rows
}

/// The table of rates and times.
pub fn table(rows: &[Row]) -> String {
    let mut text = "| frame | frames | right | wrong | ms |\n|---|---|---|---|---|\n".to_string();
    for Row { name, counts, median_ms, .. } in rows {
        let share = |count: usize| format!("{:.2} %", 100.0 * count as f64 / counts.frames as f64);
        let Counts { frames, right, wrong } = *counts;
        let shares = [right, wrong].map(share).join(" | ");
        writeln!(text, "| {name} | {frames} | {shares} | {median_ms:.2} |").unwrap();
    }
    text
}

/// Median time of a tracked frame, µs: a spot of 20 × 14 px in 640 × 480, tracked from frame to frame.
pub fn tracked_us(compiled: &Arc<Compiled>, height: f64) -> [f64; 3] {
    let frames: Vec<_> = (0..64)
        .map(|number| {
            let mut scene = Scene::new(7, height, 0);
            if let Some(target) = &mut scene.target {
                target.centre = [300.0 + 1.5 * number as f64, 200.0 + 0.5 * number as f64];
            }
            scene.seed = number;
            scene.frame().with_sequence(number)
        })
        .collect();
    let mut times = Vec::new();
    for _ in 0..8 {
        let mut tracker = Tracker::new(compiled.clone(), TrackerOptions::default()).unwrap();
        for (number, frame) in frames.iter().enumerate() {
            let start = Instant::now();
            let estimate = tracker.track(frame);
            let us = start.elapsed().as_secs_f64() * 1e6;
            assert_eq!(estimate.state, TrackState::Tracking, "{estimate:?}");
            if number > 2 {
                times.push(us);
            }
        }
    }
    times.sort_by(f64::total_cmp);
    [times[times.len() / 2], times[0], times[times.len() - 1]]
}
