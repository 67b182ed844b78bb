//! The tracker with shipped documents, run as in a session.

use std::time::Instant;

use isophote_jit::VectorWidth;
use isophote_symbolic::Model;
use isophote_tracker::{TrackState, TrackerOptions};

use super::Answer;
use super::sequence::FrameSequence;
use crate::text;
use crate::tracked::subject::{camera, profile, tracker};

/// The documents used.
pub const DOCUMENTS: [&str; 4] = ["spot", "spot-plane", "gaussian", "thesis-spot"];

/// Answers of a fresh tracker.
pub fn answers(document: &str, width: VectorWidth, sequence: &FrameSequence) -> Vec<Answer> {
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
    sequence.frames.iter().map(|frame| answer(&frame.image)).collect()
}
