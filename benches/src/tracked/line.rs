//! One line of the table: a subject on its course, alternating frames and passes.

use std::time::Instant;

use isophote_jit::VectorWidth;
use isophote_tracker::{Estimate, Frame, TrackState, Tracker};

use super::pass::Pass;
use super::subject::Subject;
use super::{SETTLING, quantile};
use crate::accuracy::sensor::Random;

/// Head of the table.
pub const HEAD: &str = "| document | target, px | jumps, px | bits | pixels | a pass, µs | a frame, µs | frame by pass | asked | passes | points, slopes | RMSE, px | frames |\n\
                        |---|---|---|---|---|---|---|---|---|---|---|---|---|";

/// A measurement.
pub struct Task<'a> {
    /// Name in the tables.
    pub document: &'a str,
    /// Error of predictions, px.
    pub jump_px: f64,
    /// Vector width of all kernels.
    pub width: VectorWidth,
    /// Number of frames.
    pub count: usize,
    /// Goal of frame/pass.
    pub asked: f64,
}

/// A frame that counts; not inlined, to be visible to profilers.
#[inline(never)]
fn settled(tracker: &mut Tracker, image: &Frame) -> Estimate {
    tracker.track(image)
}

/// Offset of the target in frame `number` of `count`, px.
pub fn offset(velocity: [f64; 2], number: usize, count: usize, jump_px: f64, random: &mut Random) -> [f64; 2] {
    let turn = random.uniform(0.0, std::f64::consts::TAU);
    let jump = [jump_px * turn.cos(), jump_px * turn.sin()];
    let time = number as f64 - count as f64 / 2.0;
    [0, 1].map(|axis| velocity[axis] * time + jump[axis])
}

/// Measures a line.
pub fn line(subject: &mut dyn Subject, task: &Task<'_>) -> String {
    let Task { document, jump_px, width, count, asked } = *task;
    let mut random = Random::of("jumps", 0);
    let (mut tracker, pass) = (subject.tracker(width), Pass::new(width));
    let (mut frames, mut passes, mut ratios, mut steps, mut squares) = (vec![], vec![], vec![], vec![], vec![]);
    let (mut sampled, mut pixels) = (None, 0);
    for number in 0..count {
        let image = subject.shot(offset(subject.velocity(), number, count, jump_px, &mut random));
        let begin = Instant::now();
        let estimate = if number < SETTLING { tracker.track(&image) } else { settled(&mut tracker, &image) };
        let frame_us = begin.elapsed().as_secs_f64() * 1e6;
        if number < SETTLING || estimate.state != TrackState::Tracking {
            continue;
        }
        // The first of three warms the caches.
        let of_pass = [(); 3].map(|()| pass.run(subject.covered(&estimate), &image));
        let pass_us = quantile(&of_pass.map(|(us, _)| us), 0.5);
        pixels = of_pass[0].1;
        frames.push(frame_us);
        passes.push(pass_us);
        ratios.push(frame_us / pass_us);
        steps.push(estimate.stages.iter().map(|stage| f64::from(stage.passes)).sum());
        squares.push(subject.error_px(&estimate).map(|error| error * error).iter().sum());
        sampled = estimate.sampled;
    }
    let sampled = sampled.map_or("–".to_string(), |sampled| format!("{}, {}", sampled.points, sampled.slopes));
    let rmse = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    let ratio = quantile(&ratios, 0.5);
    let shown = if ratio <= asked { format!("{ratio:.1}") } else { format!("**{ratio:.1}**") };
    format!(
        "| {document} | {} | {jump_px} | {} | {pixels} | {:.1} | {:.1} (p99 {:.1}) | {shown} (p99 {:.1}) | ≤ {asked} | {:.1} | {sampled} | {rmse:.4} | {} |",
        subject.size(),
        8 * width.bytes(),
        quantile(&passes, 0.5),
        quantile(&frames, 0.5),
        quantile(&frames, 0.99),
        quantile(&ratios, 0.99),
        quantile(&steps, 0.5),
        frames.len(),
    )
}
