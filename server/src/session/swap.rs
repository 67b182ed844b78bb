//! A model on its way into a running session, and the answer when it is there.

use std::sync::Arc;

use isophote_jit::VectorWidth;
use isophote_symbolic::Model;
use isophote_tracker::{
    Carried, Compiled, MotionOptions, PredictOptions, Preparing, Tracker, TrackerOptions, WORK_MAX,
};
use isophote_wire::{PredictDocument, SessionDocument, WindowDocument};
use tokio::sync::oneshot;

use crate::registry::ModelEntry;

/// A model that fits, or will.
#[derive(Clone)]
pub struct Active {
    /// Its name in the registry.
    pub name: String,
    /// `name@sha256:…`, as estimates name it.
    pub id: Arc<str>,
    /// The checked document.
    pub model: Arc<Model>,
    /// The vectors of its kernels.
    pub width: VectorWidth,
}

impl Active {
    /// The model of a registry's entry.
    pub fn new(entry: &ModelEntry) -> Active {
        let (name, id, model) = (entry.name.to_string(), entry.id().into(), entry.model.clone());
        Active { name, id, model, width: entry.width() }
    }
}

/// Compiled and checked; waits for the boundary between two frames.
pub struct Swap {
    /// What will fit.
    pub active: Active,
    /// Its kernels, warm for the frames that the source delivers.
    pub compiled: Arc<Compiled>,
    /// The session's options as far as they apply to it.
    pub options: TrackerOptions,
    /// A tracker that has followed the target with it: that one goes on, with these parameters carried.
    pub warm: Option<Box<Tracker>>,
    /// See `warm`.
    pub carried: Carried,
    /// Told when the swap is done; dropped when the session ends before.
    pub reply: oneshot::Sender<Swapped>,
}

/// What became of a swap.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Swapped {
    /// Frames from this number on are fitted with it.
    pub active_since_frame: u64,
    /// Parameters that keep their values.
    pub carried: Vec<String>,
    /// Parameters that start anew.
    pub reset: Vec<String>,
}

/// The options of a session for a model to which it is swapped. Constants and starting values that the model does not know are
/// left out: they belong to the model that ran before, and come back with it.
pub fn options_known(document: &SessionDocument, model: &Model) -> TrackerOptions {
    let mut options = options(document);
    options.start.retain(|name, _| model.parameter(name).is_some());
    options.constants.retain(|name, _| model.constant(name).is_some());
    // A model of one spot without a name has no pose of several; the target comes back with the model that has.
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
    // What is not named is all there is.
    let slices = isophote_jit::Slices {
        first: [z.unwrap_or(0), w.unwrap_or(0)],
        count: [depth.unwrap_or(usize::MAX), length.unwrap_or(usize::MAX)],
    };
    isophote_jit::Window { x, y, width, height, slices }
}
