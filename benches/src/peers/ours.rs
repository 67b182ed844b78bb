//! The tracker with shipped documents, as a session runs it.

use std::time::Instant;

use isophote_jit::VectorWidth;
use isophote_symbolic::Model;
use isophote_tracker::{TrackState, TrackerOptions};

use super::Answer;
use super::course::Course;
use crate::text;
use crate::tracked::subject::{camera, profile, tracker};

/// The documents.
pub const DOCUMENTS: [&str; 4] = ["spot", "spot-plane", "gaussian", "thesis-spot"];

/// Answers of a tracker that has seen nothing before.
pub fn answers(document: &str, width: VectorWidth, course: &Course) -> Vec<Answer> {
    let model = Model::from_toml(&text(document)).unwrap();
    let start = profile().filter(|(name, _)| model.parameter(name).is_some()).collect();
    let mut tracker = tracker(document, width, TrackerOptions { start, camera: camera(), ..TrackerOptions::default() });
    let mut answer = |image| {
        let begin = Instant::now();
        let estimate = tracker.track(image);
        let took_us = begin.elapsed().as_secs_f64() * 1e6;
        let is_answer = estimate.state == TrackState::Tracking;
        let centre = [0, 1].map(|axis| if is_answer { estimate.parameters[axis] } else { f64::NAN });
        Answer { took_us, centre }
    };
    course.shots.iter().map(|shot| answer(&shot.image)).collect()
}
