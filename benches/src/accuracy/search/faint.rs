//! Faint stars in whole frames: detection rate, false detections of noise, and time of a search.
//!
//! Seeded frames of 1024 × 1024 px in electrons (16 bit, one DN each) hold at most one star at a random position. Its
//! signal-to-noise ratio is F/√(F + 4πσ²(sky + read²)), F being its electrons.

use std::sync::Arc;

use isophote_jit::PixelFormat;
use isophote_symbolic::{Model, Precision};
use isophote_tracker::{Compiled, TrackState, Tracker, TrackerOptions};
use isophote_tracker::{Frame, Plane};
use rand_distr::Poisson;

use super::scene::{Scene, height};
use crate::accuracy::sensor::Random;

/// Side of a frame, px.
pub const SIDE: usize = 1024;
/// Sky, electrons per pixel.
pub const SKY_E: f64 = 100.0;
/// Read noise, electrons.
pub const READ_E: f64 = 5.0;
/// Offset that keeps pixels above 0.
const PEDESTAL: f64 = 100.0;

/// Background of 8-bit frames, DN.
const GROUND: f64 = 100.0;
/// Noise of 8-bit frames, 1 σ, DN.
const NOISE: f64 = 2.0;

/// Results of the frames.
#[derive(Clone, Copy, Debug, Default)]
pub struct Found {
    /// Frames.
    pub frames: usize,
    /// Tracking, within two σ and half a pixel of the star.
    pub right: usize,
    /// Tracking, elsewhere.
    pub wrong: usize,
    /// Median processor time of a frame, ms.
    pub median_ms: f64,
}

/// Processor time of this thread, ms: unaffected by other programs.
fn cpu_ms() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    text.split_whitespace().next().unwrap().parse::<f64>().unwrap() * 1e-6
}

/// A compiled shipped document.
pub fn compiled(name: &str) -> Arc<Compiled> {
    Arc::new(Compiled::new(Arc::new(Model::from_toml(&crate::text(name)).unwrap()), Precision::F32).unwrap())
}

/// A frame with a star of σ px and that signal-to-noise ratio (none if 0), and its position.
pub fn frame(name: &str, number: usize, sigma: f64, ratio: f64) -> (Frame, [f64; 2]) {
    let mut random = Random::of(name, number);
    let area = 4.0 * std::f64::consts::PI * sigma * sigma;
    let squared = ratio * ratio;
    let flux = 0.5 * squared + (0.25 * squared * squared + squared * area * (SKY_E + READ_E * READ_E)).sqrt();
    let margin = 0.03 * SIDE as f64;
    let centre = [0, 1].map(|_| random.uniform(margin, SIDE as f64 - margin));
    // The share of a star's light between two pixel edges.
    let below = |edge: f64| 0.5 * libm::erfc(-edge / (sigma * std::f64::consts::SQRT_2));
    let share = |at: usize, centre: f64| below(at as f64 + 0.5 - centre) - below(at as f64 - 0.5 - centre);
    let shares = centre.map(|centre| (0..SIDE).map(|at| share(at, centre)).collect::<Vec<f64>>());
    let sky = Poisson::new(SKY_E).unwrap();
    let mut bytes = Vec::with_capacity(2 * SIDE * SIDE);
    for y in 0..SIDE {
        for x in 0..SIDE {
            let star = flux * shares[0][x] * shares[1][y];
            let photons = random.draw(&sky) + if star > 1e-6 { random.draw(&Poisson::new(star).unwrap()) } else { 0.0 };
            let value = (PEDESTAL + photons + READ_E * random.normal()).round().clamp(0.0, 65535.0);
            bytes.extend((value as u16).to_ne_bytes());
        }
    }
    (Frame::new(&[SIDE, SIDE], vec![Plane::owned(PixelFormat::U16, bytes, SIDE)]).unwrap(), centre)
}

/// Cold starts of a fresh tracker in that many frames.
pub fn measure(compiled: &Arc<Compiled>, name: &str, frames: usize, sigma: f64, ratio: f64) -> Found {
    let mut found = Found { frames, ..Found::default() };
    let mut times = Vec::with_capacity(frames);
    let mut tracker = Tracker::new(compiled.clone(), TrackerOptions::default()).unwrap();
    for number in 0..frames {
        let (frame, centre) = frame(name, number, sigma, ratio);
        let start = cpu_ms();
        let estimate = tracker.track(&frame);
        times.push(cpu_ms() - start);
        if estimate.state == TrackState::Tracking {
            let off = (estimate.parameters[0] - centre[0]).hypot(estimate.parameters[1] - centre[1]);
            let is_right = ratio > 0.0 && off < 2.0 * sigma + 0.5;
            found.right += usize::from(is_right);
            found.wrong += usize::from(!is_right);
            // The next frame is a cold start again.
            tracker = Tracker::new(compiled.clone(), TrackerOptions::default()).unwrap();
        }
    }
    times.sort_by(f64::total_cmp);
    found.median_ms = times[times.len() / 2];
    found
}

/// Times of cold starts in 8-bit frames of 1024 × 1024 px, ms: pure noise, and a disc of 24 × 16 px and that height,
/// which falls towards its rim. Median and maximum of each.
pub fn megapixel_ms(compiled: &Arc<Compiled>, frames: usize, height: f64) -> [[f64; 2]; 2] {
    [0.0, height].map(|height| {
        cold_ms(compiled, frames, |seed| {
            let mut random = Random::of("megapixel", seed);
            let centre = [0, 1].map(|_| random.uniform(100.0, SIDE as f64 - 100.0));
            let mut pixel = |i: usize| {
                let [x, y] = [(i % SIDE) as f64 - centre[0], (i / SIDE) as f64 - centre[1]];
                let light = height * (1.0 - (x / 12.0).powi(2) - (y / 8.0).powi(2)).max(0.0);
                (GROUND + light + NOISE * random.normal()).round().clamp(0.0, 255.0) as u8
            };
            let bytes: Vec<u8> = (0..SIDE * SIDE).map(&mut pixel).collect();
            Frame::new(&[SIDE, SIDE], vec![Plane::owned(PixelFormat::U8, bytes, SIDE)]).unwrap()
        })
    })
}

/// Times of a fresh tracker's first frame, ms: median and maximum.
fn cold_ms(compiled: &Arc<Compiled>, frames: usize, frame: impl Fn(usize) -> Frame) -> [f64; 2] {
    let cold = |seed: usize| {
        let frame = frame(seed);
        let mut tracker = Tracker::new(compiled.clone(), TrackerOptions::default()).unwrap();
        let start = cpu_ms();
        tracker.track(&frame);
        cpu_ms() - start
    };
    cold(0); // compiles kernels
    let mut times: Vec<f64> = (0..frames).map(cold).collect();
    times.sort_by(f64::total_cmp);
    [times[times.len() / 2], times[times.len() - 1]]
}

/// Times of cold starts in 640 × 480 px, ms: a spot alone, a spot among ten other objects, ten objects of other
/// shapes. Median and maximum of each.
pub fn times_ms(compiled: &Arc<Compiled>, frames: usize) -> [[f64; 2]; 3] {
    let scene = |seed: usize, clutter: usize| Scene::new(3_000_000 + seed as u64, height(0.0), clutter);
    let kinds: [&dyn Fn(usize) -> Scene; 3] =
        [&|seed| scene(seed, 0), &|seed| scene(seed, 10), &|seed| scene(seed, 10).without_target()];
    kinds.map(|scene| cold_ms(compiled, frames, |seed| scene(seed).frame()))
}

/// Times of frames of pure noise, 640 × 480 px, ms, for a session that tracked a spot and has lost it: median and
/// maximum.
pub fn blackout_ms(compiled: &Arc<Compiled>, frames: usize) -> [f64; 2] {
    let mut tracker = Tracker::new(compiled.clone(), TrackerOptions::default()).unwrap();
    let seen = Scene::new(7, height(0.0), 0).frame();
    for _ in 0..5 {
        tracker.track(&seen);
    }
    let mut times = Vec::new();
    for seed in 0..frames {
        let dark = Scene::new(100 + seed as u64, height(0.0), 0).without_target().frame();
        let start = cpu_ms();
        let estimate = tracker.track(&dark);
        times.push(cpu_ms() - start);
        assert_ne!(estimate.state, TrackState::Tracking);
    }
    times.sort_by(f64::total_cmp);
    [times[times.len() / 2], times[times.len() - 1]]
}
