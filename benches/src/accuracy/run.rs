//! Measures all frames of a row on all processors; results do not depend on their number.

use std::collections::BTreeMap;

use isophote_tracker::{Camera, DefectMap, Frame};

use super::bound::variances;
use super::condition::{Condition, Defects, Glare, RowNoise, Task};
use super::document::{Document, frame};
use super::scene::{Beside, Scene};
use super::sensor::{FULL, GAIN, Random};
use super::summary::Summary;
use super::trial::{Outcome, ask};

/// Frames of a condition with a computed bound; the others differ in phase and angle only.
const BOUNDS: usize = 100;

/// A task's results.
pub struct Measured {
    /// The task.
    pub task: Task,
    /// √ of the mean variance of a coordinate of the centre, px.
    pub bound_px: f64,
    /// Cold start.
    pub cold: Summary,
    /// Start from the last frame's answer.
    pub tracking: Summary,
}

/// Documents by name, compiled on first use.
#[derive(Default)]
pub struct Documents(BTreeMap<&'static str, Document>);

impl Documents {
    /// A shipped document.
    pub fn get(&mut self, name: &'static str) -> &Document {
        self.0.entry(name).or_insert_with(|| Document::shipped(name))
    }
}

/// `count` results in order, computed by one thread per processor.
pub fn each<T: Send>(count: usize, work: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(count.max(1));
    std::thread::scope(|scope| {
        let part = |thread: usize| {
            let work = &work;
            let numbers = (thread..count).step_by(threads);
            let named = std::thread::Builder::new().name(format!("accuracy {thread}"));
            named.spawn_scoped(scope, move || numbers.map(work).collect::<Vec<T>>()).unwrap()
        };
        let parts: Vec<_> = (0..threads).map(part).collect();
        let mut parts: Vec<_> = parts.into_iter().map(|part| part.join().unwrap().into_iter()).collect();
        (0..count).map(|number| parts[number % threads].next().unwrap()).collect()
    })
}

/// Nuisance parameters of the bound.
fn beside(task: &Task) -> Beside {
    match (task.condition.glare, task.document) {
        (Glare::None, _) => Beside::Even,
        (Glare::Lobe { .. }, "spot-lobe") => Beside::Lobe,
        _ => Beside::Plane,
    }
}

/// One drawing, its frame, the camera document, and the state of the random numbers.
pub fn shot(task: &Task, number: usize) -> (Scene, Frame, Camera, Random) {
    let mut random = Random::of(task.condition.name, number);
    let scene = Scene::draw(task.condition, &mut random);
    let Condition { hot, warm, defects, row_noise, rows, side_px, .. } = task.condition;
    let mut pixels = match row_noise > 0.0 {
        true => random.exposed_by_rows(&scene.seen().0, side_px, row_noise),
        false => random.exposed(&scene.seen().0),
    };
    let side = side_px as u32;
    let mut map = DefectMap { width: side, height: side, ..DefectMap::default() };
    if hot + warm > 0.0 {
        let mut random = Random::of("hot pixels", number);
        for (place, pixel) in pixels.iter_mut().enumerate() {
            let drawn = random.uniform(0.0, 1.0);
            if drawn >= hot + warm {
                continue;
            }
            let more = if drawn < hot { FULL } else { random.uniform(40.0, 200.0) };
            *pixel = (f64::from(*pixel) + more).min(FULL) as u8;
            map.pixels.push([place as u32 % side, place as u32 / side]);
        }
    }
    let defect_map = (defects == Defects::Mapped).then_some(map);
    let row_noise_e = (rows == RowNoise::Stated).then_some(row_noise / GAIN);
    (scene, frame(pixels, side_px), Camera { defect_map, row_noise_e, ..Camera::default() }, random)
}

/// Measures a task over that many frames.
pub fn measure(task: &Task, document: &Document, frames: usize) -> Measured {
    let bounds = each(frames.min(BOUNDS), |number| {
        let scene = Scene::draw(task.condition, &mut Random::of(task.condition.name, number));
        let variances = variances(&scene, beside(task));
        (variances[0] + variances[1]) / 2.0
    });
    let outcomes: Vec<[Outcome; 2]> = each(frames, |number| {
        let (scene, image, camera, mut random) = shot(task, number);
        let known = (task.known)(&scene);
        let prior = [scene.prior(&mut random), known.clone()].concat();
        [known, prior].map(|start| ask(document, (&image, camera.clone()), &scene, &start))
    });
    let column = |start: usize| outcomes.iter().map(|both| both[start].clone()).collect::<Vec<Outcome>>();
    Measured {
        task: *task,
        bound_px: (bounds.iter().sum::<f64>() / bounds.len() as f64).sqrt(),
        cold: Summary::of(&column(0)),
        tracking: Summary::of(&column(1)),
    }
}
