//! Converts a session's document to tracker options.

use isophote_symbolic::Model;
use isophote_tracker::{MotionOptions, PredictOptions, Preparing, TrackerOptions, WORK_MAX};

use crate::document::{PredictDocument, SessionDocument, WindowDocument};

/// The options of a session for a model to which it is swapped. Constants and starting values that the model lacks are
/// dropped: they belong to the previous model, and come back with it.
pub fn options_known(document: &SessionDocument, model: &Model) -> TrackerOptions {
    let mut options = options(document);
    options.start.retain(|name, _| model.parameter(name).is_some());
    options.constants.retain(|name, _| model.constant(name).is_some());
    // A nameless model of one spot has no pose of several; the target comes back with a model that has.
    let is_nameless = model.roles().iter().all(|roles| roles.name.is_none() && roles.position.is_empty());
    options.target = options.target.filter(|target| !is_nameless || target.spots.len() == 1);
    options
}

/// The options of a session.
pub fn options(document: &SessionDocument) -> TrackerOptions {
    TrackerOptions {
        precision: document.options.precision,
        window: document.window.map(jit_window),
        start: document.start.clone(),
        constants: document.constants.clone(),
        camera: document.camera.clone(),
        target: document.target.clone(),
        targets: document.options.targets,
        motion: MotionOptions {
            acceleration_px_s2: document.options.motion.acceleration_px_s2,
            coast_s: document.options.motion.coast_s,
            ..MotionOptions::default()
        },
        confidence_min: document.options.confidence_min,
        snr_min: document.options.snr_min,
        sizes_px: document.options.sizes_px,
        exposure: Some(document.options.exposure.goal),
        preparing: Preparing::Beside,
        work_max: WORK_MAX,
        predict: document
            .options
            .predict
            .map(|PredictDocument { horizon_s, steps }| PredictOptions { horizon_s, steps }),
    }
}

fn jit_window(window: WindowDocument) -> isophote_jit::Window {
    let WindowDocument { x, y, width, height, z, depth, w, length } = window;
    // Unnamed axes are covered completely.
    let slices = isophote_jit::Slices {
        first: [z.unwrap_or(0), w.unwrap_or(0)],
        count: [depth.unwrap_or(usize::MAX), length.unwrap_or(usize::MAX)],
    };
    isophote_jit::Window { x, y, width, height, slices }
}
