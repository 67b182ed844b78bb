//! Cold starts in whole frames: how often the target is found, how long that takes, and whether the confidence is right.

pub mod faint;
pub mod scene;

use std::fmt::Write as _;
use std::sync::Arc;
use std::time::Instant;

use isophote_symbolic::{Model, Precision};
use isophote_tracker::{Compiled, Estimate, Evidence, TrackState, Tracker, TrackerOptions};

use scene::{Profile, Scene, Thing, height};

/// A fit that ends this near to the target's centre is right, px.
const RIGHT_PX: f64 = 2.0;
/// Things beside the target.
const CLUTTER: usize = 10;
/// Confidence from which on a careful session believes.
const CAREFUL: f64 = 0.5;
/// Limits of the classes of the reliability table.
const CLASSES: [f64; 7] = [0.0, 0.01, 0.1, 0.5, 0.9, 0.99, 1.0];

/// Name and height of the target in DN.
pub fn conditions() -> [(&'static str, f64); 5] {
    [("S0", height(0.0)), ("S10", height(0.1)), ("S30", height(0.3)), ("S60", height(0.6)), ("dark", 30.0)]
}

/// What became of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Counted {
    /// Frames.
    pub frames: usize,
    /// Tracking, at the target.
    pub right: usize,
    /// Tracking, elsewhere.
    pub wrong: usize,
    /// The same with `confidence_min` 0.5.
    pub right_careful: usize,
    /// The same with `confidence_min` 0.5.
    pub wrong_careful: usize,
}

/// What was seen in a frame, and whether it was the target.
pub type Labelled = (Evidence, bool);

/// One condition.
pub struct Row {
    /// E.g. `S30, 10 others`.
    pub name: String,
    /// How often.
    pub counted: Counted,
    /// Median of the time of a frame, ms.
    pub median_ms: f64,
    /// Everything that was fitted.
    pub labelled: Vec<Labelled>,
}

/// models/spot.toml.
pub fn compiled() -> Arc<Compiled> {
    Arc::new(Compiled::new(Arc::new(Model::from_toml(&crate::text("spot")).unwrap()), Precision::F32).unwrap())
}

fn is_at(parameters: &[f64], target: Option<&Thing>) -> bool {
    target.is_some_and(|target| (parameters[0] - target.centre[0]).hypot(parameters[1] - target.centre[1]) < RIGHT_PX)
}

/// Cold starts of a fresh tracker in seeded frames, on all processors.
pub fn measure(name: &str, compiled: &Arc<Compiled>, frames: usize, scene: impl Fn(u64) -> Scene + Sync) -> Row {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let part = |first: usize| -> Vec<Seen> {
        (first..frames).step_by(threads).map(|seed| look(compiled, &scene(seed as u64))).collect()
    };
    let parts: Vec<Vec<Seen>> = std::thread::scope(|scope| {
        let started: Vec<_> = (0..threads).map(|first| scope.spawn(move || part(first))).collect();
        started.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    let mut row = Row {
        name: name.to_string(),
        counted: Counted { frames, ..Counted::default() },
        median_ms: 0.0,
        labelled: Vec::new(),
    };
    let mut times = Vec::new();
    for seen in parts.into_iter().flatten() {
        times.push(seen.ms);
        let counted = &mut row.counted;
        counted.right += usize::from(seen.is_right == Some(true));
        counted.wrong += usize::from(seen.is_right == Some(false));
        counted.right_careful += usize::from(seen.is_right_careful == Some(true));
        counted.wrong_careful += usize::from(seen.is_right_careful == Some(false));
        row.labelled.extend(seen.labelled);
    }
    times.sort_by(f64::total_cmp);
    row.median_ms = times[times.len() / 2];
    row
}

/// What became of one frame; `None`: nothing was tracked.
struct Seen {
    ms: f64,
    is_right: Option<bool>,
    is_right_careful: Option<bool>,
    labelled: Vec<Labelled>,
}

fn look(compiled: &Arc<Compiled>, scene: &Scene) -> Seen {
    let frame = scene.frame();
    let mut tracker = Tracker::new(compiled.clone(), TrackerOptions::default()).unwrap();
    let start = Instant::now();
    let estimate = tracker.track(&frame);
    let ms = start.elapsed().as_secs_f64() * 1e3;
    let is_right = |parameters: &[f64]| is_at(parameters, scene.target.as_ref());
    let sightings = tracker.sightings(&frame);
    let options = TrackerOptions { confidence_min: CAREFUL, ..TrackerOptions::default() };
    let careful = Tracker::new(compiled.clone(), options).unwrap().track(&frame);
    let taken = |estimate: &Estimate| (estimate.state == TrackState::Tracking).then(|| is_right(&estimate.parameters));
    // A smaller spot of the same profile is what the model says: no evidence tells it from the target.
    let is_alike = |parameters: &[f64]| {
        let mut alike = scene.clutter.iter().filter(|thing| thing.profile == Profile::Spot);
        !is_right(parameters) && alike.any(|thing| is_at(parameters, Some(thing)))
    };
    let told = sightings.iter().filter(|one| !is_alike(&one.parameters));
    Seen {
        ms,
        is_right: taken(&estimate),
        is_right_careful: taken(&careful),
        labelled: told.filter_map(|one| Some((one.evidence?, is_right(&one.parameters)))).collect(),
    }
}

/// All conditions, alone, among others, and others alone.
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
        scene.clutter.retain(|thing| thing.profile != Profile::Spot);
        scene
    };
    rows.push(measure("no target, others of other shapes", compiled, frames, scene));
    rows
}

/// The table of how often and how long.
pub fn table(rows: &[Row]) -> String {
    let mut text =
        "| frame | frames | right | wrong | right, careful | wrong, careful | ms |\n|---|---|---|---|---|---|---|\n"
            .to_string();
    for Row { name, counted, median_ms, .. } in rows {
        let share = |count: usize| format!("{:.2} %", 100.0 * count as f64 / counted.frames as f64);
        let Counted { frames, right, wrong, right_careful, wrong_careful } = *counted;
        let shares = [right, wrong, right_careful, wrong_careful].map(share).join(" | ");
        writeln!(text, "| {name} | {frames} | {shares} | {median_ms:.2} |").unwrap();
    }
    text
}

/// Of the things to which a confidence was given, how many were the target.
pub fn reliability(rows: &[Row]) -> String {
    let all: Vec<Labelled> = rows.iter().flat_map(|row| row.labelled.iter().copied()).collect();
    let mut text = "| confidence | things | mean confidence | the target |\n|---|---|---|---|\n".to_string();
    for pair in CLASSES.windows(2) {
        let inside = |(evidence, _): &&Labelled| {
            let confidence = evidence.confidence();
            confidence >= pair[0] && (confidence < pair[1] || pair[1] == 1.0)
        };
        let members: Vec<&Labelled> = all.iter().filter(inside).collect();
        let n = members.len().max(1) as f64;
        let mean = members.iter().map(|(evidence, _)| evidence.confidence()).sum::<f64>() / n;
        let right = members.iter().filter(|(_, is_right)| *is_right).count() as f64 / n;
        writeln!(text, "| {}–{} | {} | {mean:.3} | {right:.3} |", pair[0], pair[1], members.len()).unwrap();
    }
    text
}

/// Weights of contrast and misfit, and the constant, by logistic regression (Newton's method) on what was labelled.
pub fn regression(rows: &[Row]) -> [f64; 3] {
    let all: Vec<([f64; 3], f64)> = rows
        .iter()
        .flat_map(|row| &row.labelled)
        .map(|(e, right)| ([e.contrast.min(Evidence::CONTRAST_MAX), e.misfit, 1.0], f64::from(u8::from(*right))))
        .collect();
    let mut weights = [0.0; 3];
    for _ in 0..30 {
        // A little ridge, so that classes that can be told apart completely do not send the weights to infinity.
        let mut hessian = [[0.0; 3]; 3];
        let mut gradient = weights.map(|w: f64| -1e-3 * w * all.len() as f64 / 1000.0);
        (0..3).for_each(|i| hessian[i][i] = 1e-3 * all.len() as f64 / 1000.0 + 1e-9);
        for (x, label) in &all {
            let odds: f64 = (0..3).map(|i| weights[i] * x[i]).sum();
            let p = 1.0 / (1.0 + (-odds).exp());
            for i in 0..3 {
                gradient[i] += (label - p) * x[i];
                (0..3).for_each(|j| hessian[i][j] += p * (1.0 - p) * x[i] * x[j]);
            }
        }
        let step = solved(hessian, gradient);
        (0..3).for_each(|i| weights[i] += step[i].clamp(-2.0, 2.0));
    }
    weights
}

/// Cramer's rule.
fn solved(m: [[f64; 3]; 3], right: [f64; 3]) -> [f64; 3] {
    let determinant = |m: [[f64; 3]; 3]| {
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
            + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    };
    let whole = determinant(m);
    std::array::from_fn(|column| {
        let mut replaced = m;
        (0..3).for_each(|row| replaced[row][column] = right[row]);
        determinant(replaced) / whole
    })
}

/// Median time of a tracked frame, µs: a spot of 20 × 14 px in 640 × 480, followed from frame to frame.
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
