//! A trial: one frame, one answer, and its errors.

use std::time::Instant;

use isophote_tracker::{Camera, Frame};

use super::condition::Known;
use super::document::{Answer, Document, semi_axes};
use super::scene::Scene;

/// Answers off by more are failures, px.
pub const ASTRAY_PX: f64 = 2.0;

/// Errors of one answer.
#[derive(Clone, Debug)]
pub struct Trial {
    /// Estimate less truth, px.
    pub error: [f64; 2],
    /// Relative error of the longer semi-axis.
    pub size: f64,
    /// Relative error of the brightness.
    pub brightness: f64,
    /// eᵀC⁻¹e of the centre: 2 on average if the covariance is consistent.
    pub nees: Option<f64>,
    /// χ²/ν
    pub reduced: Option<f64>,
}

/// Result of one frame.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// `None`: no answer, or one more than [`ASTRAY_PX`] off.
    pub trial: Option<Trial>,
    /// Without any answer.
    pub silent: bool,
    /// Time of the call.
    pub time_us: f64,
}

/// Tracks one frame with a fresh tracker.
pub fn ask(document: &Document, (frame, camera): (&Frame, Camera), scene: &Scene, start: &Known) -> Outcome {
    let mut tracker = document.tracker(start, camera);
    let begin = Instant::now();
    let estimate = tracker.track(frame);
    let time_us = begin.elapsed().as_secs_f64() * 1e6;
    let answer = document.answer(&estimate);
    let silent = answer.is_none();
    let trial = answer.map(|answer| Trial::of(&answer, scene)).filter(|trial| {
        let [x, y] = trial.error;
        x.hypot(y) < ASTRAY_PX
    });
    Outcome { trial, silent, time_us }
}

impl Trial {
    /// Compares an answer with the truth.
    pub fn of(answer: &Answer, scene: &Scene) -> Trial {
        let error = [answer.centre[0] - scene.centre[0], answer.centre[1] - scene.centre[1]];
        let nees = answer.covariance.map(|[xx, xy, yy]| {
            let [x, y] = error;
            (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)
        });
        Trial {
            error,
            size: semi_axes(answer.shape)[0] / semi_axes(scene.shape)[0] - 1.0,
            brightness: answer.brightness / scene.brightness - 1.0,
            nees,
            reduced: answer.reduced,
        }
    }
}
