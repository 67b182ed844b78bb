//! A model swap into a running session, and its result.

use std::collections::BTreeMap;
use std::sync::Arc;

use isophote_jit::VectorWidth;
use isophote_symbolic::Model;
use isophote_tracker::{Carried, Compiled, Tracker, TrackerOptions};
pub use isophote_wire::{options, options_known};
use tokio::sync::oneshot;

use crate::registry::{Media, ModelEntry};

/// A model that is active or about to be.
#[derive(Clone)]
pub struct Active {
    /// Its name in the registry.
    pub name: String,
    /// `name@sha256:…`, as estimates name it.
    pub id: Arc<str>,
    /// The checked document.
    pub model: Arc<Model>,
    /// Media type of its document.
    pub media: Media,
    /// Its document as it was sent.
    pub text: Arc<str>,
    /// Vector width of its kernels.
    pub width: VectorWidth,
    /// Constants in addition to those of the session's document: those of a promoted shadow.
    pub constants: BTreeMap<String, f64>,
}

impl Active {
    /// The model of a registry entry, with additional constants.
    pub fn new(entry: &ModelEntry, constants: BTreeMap<String, f64>) -> Active {
        let (name, id, model) = (entry.name.to_string(), entry.id().into(), entry.model.clone());
        Active { name, id, model, media: entry.media, text: entry.text.clone(), width: entry.width(), constants }
    }
}

/// A compiled and checked model that waits for the boundary between two frames.
pub struct Swap {
    /// The new model.
    pub active: Active,
    /// Its kernels, compiled for the source's pixel format.
    pub compiled: Arc<Compiled>,
    /// The session's options, as far as they apply to it.
    pub options: TrackerOptions,
    /// A shadow's tracker that continues, with the parameters in `carried`.
    pub warm: Option<Box<Tracker>>,
    /// See `warm`.
    pub carried: Carried,
    /// Notified when the swap is done; dropped if the session ends first.
    pub reply: oneshot::Sender<Swapped>,
}

/// The result of a swap.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Swapped {
    /// The first frame fitted with it.
    pub active_since_frame: u64,
    /// Parameters that keep their values.
    pub carried: Vec<String>,
    /// Parameters that start anew.
    pub reset: Vec<String>,
}
