//! All frames of a row, on all processors, the same whatever their number.

use std::collections::BTreeMap;

use isophote_tracker::Frame;

use super::bound::variances;
use super::condition::{Glare, Task};
use super::document::{Document, frame};
use super::scene::{Beside, Scene};
use super::sensor::{FULL, Random};
use super::summary::Summary;
use super::trial::{Outcome, ask};

/// Frames of a condition whose bound is worked out; the others differ by phase and angle only.
const BOUNDS: usize = 100;

/// A task's results.
pub struct Measured {
    /// The task.
    pub task: Task,
    /// √ of the mean variance of a coordinate of the centre, px.
    pub bound_px: f64,
    /// From nothing.
    pub cold: Summary,
    /// From a start like that of the last frame.
    pub tracking: Summary,
}

/// Documents by name, compiled when first asked for.
#[derive(Default)]
pub struct Documents(BTreeMap<&'static str, Document>);

impl Documents {
    /// A shipped document.
    pub fn get(&mut self, name: &'static str) -> &Document {
        self.0.entry(name).or_insert_with(|| Document::shipped(name))
    }
}

/// `count` results in order, worked out by as many threads as there are processors.
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

/// What the bound knows nothing of beforehand.
fn beside(task: &Task) -> Beside {
    match (task.condition.glare, task.document) {
        (Glare::None, _) => Beside::Even,
        (Glare::Lobe { .. }, "spot-lobe") => Beside::Lobe,
        _ => Beside::Plane,
    }
}

/// One drawing, its frame and where its random numbers go on.
pub fn shot(task: &Task, number: usize) -> (Scene, Frame, Random) {
    let mut random = Random::of(task.condition.name, number);
    let scene = Scene::draw(task.condition, &mut random);
    let mut pixels = random.exposed(&scene.seen().0);
    if task.condition.hot > 0.0 {
        let mut hot = Random::of("hot pixels", number);
        pixels.iter_mut().filter(|_| hot.uniform(0.0, 1.0) < task.condition.hot).for_each(|pixel| *pixel = FULL as u8);
    }
    (scene, frame(pixels, task.condition.side_px), random)
}

/// A task over that many frames.
pub fn measure(task: &Task, document: &Document, frames: usize) -> Measured {
    let bounds = each(frames.min(BOUNDS), |number| {
        let scene = Scene::draw(task.condition, &mut Random::of(task.condition.name, number));
        let variances = variances(&scene, beside(task));
        (variances[0] + variances[1]) / 2.0
    });
    let outcomes: Vec<[Outcome; 2]> = each(frames, |number| {
        let (scene, image, mut random) = shot(task, number);
        let known = (task.known)(&scene);
        let prior = [scene.prior(&mut random), known.clone()].concat();
        [ask(document, &image, &scene, &known), ask(document, &image, &scene, &prior)]
    });
    let column = |start: usize| outcomes.iter().map(|both| both[start].clone()).collect::<Vec<Outcome>>();
    Measured {
        task: *task,
        bound_px: (bounds.iter().sum::<f64>() / bounds.len() as f64).sqrt(),
        cold: Summary::of(&column(0)),
        tracking: Summary::of(&column(1)),
    }
}
