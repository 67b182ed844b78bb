//! A model on its way into a running session, and the answer when it is there.

use std::collections::BTreeMap;
use std::sync::Arc;

use isophote_jit::VectorWidth;
use isophote_symbolic::Model;
use isophote_tracker::{Carried, Compiled, Tracker, TrackerOptions};
pub use isophote_wire::{options, options_known};
use tokio::sync::oneshot;

use crate::registry::{Media, ModelEntry};

/// A model that fits, or will.
#[derive(Clone)]
pub struct Active {
    /// Its name in the registry.
    pub name: String,
    /// `name@sha256:…`, as estimates name it.
    pub id: Arc<str>,
    /// The checked document.
    pub model: Arc<Model>,
    /// How it was sent.
    pub media: Media,
    /// As it was sent.
    pub text: Arc<str>,
    /// The vectors of its kernels.
    pub width: VectorWidth,
    /// Its constants beside those of the session's document: those of a shadow that took over.
    pub constants: BTreeMap<String, f64>,
}

impl Active {
    /// The model of a registry's entry, with such constants of its own.
    pub fn new(entry: &ModelEntry, constants: BTreeMap<String, f64>) -> Active {
        let (name, id, model) = (entry.name.to_string(), entry.id().into(), entry.model.clone());
        Active { name, id, model, media: entry.media, text: entry.text.clone(), width: entry.width(), constants }
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
