//! What is taken for a target in frames that are full of other things, and what becomes of targets among them.

pub mod alike;
pub mod filtered;
pub mod scene;

use std::sync::Arc;
use std::time::Instant;

use isophote_symbolic::{Model, Precision};
use isophote_tracker::{Compiled, Frame, TrackState, Tracker, TrackerOptions};

use crate::accuracy::search::scene::Random;
use scene::{Edges, Kind, SIZE};

/// Documents that are tried.
pub const DOCUMENTS: [&str; 3] = ["spot", "spot-plane", "gaussian"];
/// Of [`lines`].
pub const HEAD: &str = "| document | frame | frames without a target, with one | no target: tracking | of these alike | no target: confidence ≥ 0.5 | a target: found | a target: something else | SNR ≥ 20: lost | ms |\n\
                        |---|---|---|---|---|---|---|---|---|---|\n";
/// A fit that ends this near to the target's centre is right, px.
const RIGHT_PX: f64 = 2.0;
/// What differs from the document's image by no more than this share of its height, before noise, is *alike*: photographs of laser
/// beams differ from a Gaussian by 1 to 2 %, noise included.
const ALIKE: f64 = 0.01;
/// A target that stands out of what its own image finds over the frame by so many standard deviations is not to be lost.
const CLEAR: f64 = 20.0;
/// Targets are so far from the frame's border, px.
const BORDER_PX: f64 = 45.0;
/// Half the longer axis of targets, px, and their height, DN.
const HALF_PX: [f64; 2] = [4.0, 20.0];
const HEIGHT: [f64; 2] = [60.0, 220.0];

/// What became of one frame.
struct Told {
    is_tracking: bool,
    is_right: bool,
    is_alike: bool,
    /// There is a target, and it stands out.
    is_clear: bool,
    confidence: f64,
    ms: f64,
}

/// The rows of a document: all kinds of clutter, sharp and blurred, so many frames without a target and with one. `first` is the
/// first seed.
pub fn lines(document: &str, [frames, targets]: [usize; 2], first: u64) -> impl Iterator<Item = String> {
    let model = Arc::new(Model::from_toml(&crate::text(document)).unwrap());
    let compiled = Arc::new(Compiled::new(model, Precision::F32).unwrap());
    let kinds = Kind::ALL.into_iter().flat_map(|kind| [Edges::Sharp, Edges::Blurred].map(|edges| (kind, edges)));
    kinds.map(move |(kind, edges)| {
        let [empty, full] = [(false, frames), (true, targets)].map(|(with_target, frames)| {
            let parts = shared_out(frames, |seed| one(document, &compiled, (kind, edges), with_target, first + seed));
            parts.into_iter().flatten().collect::<Vec<Told>>()
        });
        let share = |told: &[Told], is: &dyn Fn(&Told) -> bool| {
            format!("{:.1} %", 100.0 * told.iter().filter(|one| is(one)).count() as f64 / told.len() as f64)
        };
        let clear = full.iter().filter(|one| one.is_clear).count();
        let lost = full.iter().filter(|one| one.is_clear && !one.is_right).count();
        let mut ms: Vec<f64> = empty.iter().chain(&full).map(|one| one.ms).collect();
        ms.sort_by(f64::total_cmp);
        format!(
            "| `{document}` | {}, {} | {frames}, {targets} | {} | {} | {} | {} | {} | {lost} of {clear} | {:.0} |\n",
            kind.name(),
            edges.name(),
            share(&empty, &|one| one.is_tracking),
            share(&empty, &|one| one.is_tracking && one.is_alike),
            share(&empty, &|one| one.is_tracking && one.confidence >= 0.5),
            share(&full, &|one| one.is_right),
            share(&full, &|one| one.is_tracking && !one.is_right),
            ms[ms.len() / 2],
        )
    })
}

/// `work` for each frame, on all processors.
pub(super) fn shared_out<T: Send>(frames: usize, work: impl Fn(u64) -> T + Sync) -> Vec<Vec<T>> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let part = |first: usize| -> Vec<T> { (first..frames).step_by(threads).map(|seed| work(seed as u64)).collect() };
    std::thread::scope(|scope| {
        let started: Vec<_> = (0..threads).map(|first| scope.spawn(move || part(first))).collect();
        started.into_iter().map(|thread| thread.join().unwrap()).collect()
    })
}

/// A frame of that kind with or without a target, and where that is.
pub(super) fn picture(
    document: &str,
    clutter: (Kind, Edges),
    with_target: bool,
    seed: u64,
) -> (Frame, Option<[f64; 2]>) {
    let (light, seed, target) = lit(document, clutter, with_target, seed);
    (scene::frame(&light, seed), target)
}

/// The light of such a frame, the seed of its noise, and where the target is.
fn lit(document: &str, clutter: (Kind, Edges), with_target: bool, seed: u64) -> (Vec<f64>, u64, Option<[f64; 2]>) {
    let seed = seed + 10_000_019 * (clutter.0 as u64 + 1) + 500_000_003 * clutter.1 as u64;
    let mut light = scene::light(clutter.0, clutter.1, seed);
    let target = with_target.then(|| {
        let mut random = Random::new(seed ^ 0x7A26);
        let centre = SIZE.map(|side| random.within(BORDER_PX, side as f64 - BORDER_PX));
        let half = random.within(HALF_PX[0], HALF_PX[1]);
        let half = [half, half * random.within(0.6, 1.0)];
        let (angle, height) = (random.within(0.0, std::f64::consts::PI), random.within(HEIGHT[0], HEIGHT[1]));
        scene::add_target(&mut light, document, centre, half, angle, height);
        centre
    });
    (light, seed, target)
}

/// A cold start of a fresh tracker.
fn one(document: &str, compiled: &Arc<Compiled>, clutter: (Kind, Edges), with_target: bool, seed: u64) -> Told {
    let (light, noise, target) = lit(document, clutter, with_target, seed);
    let frame = scene::frame(&light, noise);
    let mut tracker = Tracker::new(compiled.clone(), TrackerOptions::default()).unwrap();
    let begin = Instant::now();
    let estimate = tracker.track(&frame);
    let ms = begin.elapsed().as_secs_f64() * 1e3;
    let is_tracking = estimate.state == TrackState::Tracking;
    let ratio = target.map_or(0.0, |centre| {
        let (without, noise, _) = lit(document, clutter, false, seed);
        let image: Vec<f64> = light.iter().zip(&without).map(|(with, without)| with - without).collect();
        filtered::ratio(&image, centre, &scene::frame(&without, noise))
    });
    let is_at = |at: [f64; 2]| (estimate.parameters[0] - at[0]).hypot(estimate.parameters[1] - at[1]) < RIGHT_PX;
    Told {
        is_tracking,
        is_alike: is_tracking && alike::unlike(document, &estimate.parameters, &light) <= ALIKE,
        is_right: is_tracking && target.is_some_and(is_at),
        is_clear: ratio >= CLEAR,
        confidence: estimate.confidence.unwrap_or(0.0),
        ms,
    }
}
