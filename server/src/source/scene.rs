//! `SceneInForce`: the scene of a synthetic source, and the frame since which it is shown.
//!
//! Partial documents are merged into the scene; the source's thread takes the newest between two frames. A wrong document
//! changes nothing.

use std::sync::{Mutex, MutexGuard, PoisonError};

use isophote_capture::{SceneKnob, SceneSpec, SyntheticError};
use isophote_wire::{SceneDocument, SceneView, SourceDocument, SyntheticDocument};

use crate::http::preconditions::{EntityTag, Preconditions};
use crate::problem::Problem;

/// The scene of one source.
pub struct SceneInForce {
    knob: SceneKnob,
    /// Serializes changes.
    order: Mutex<()>,
    now: Mutex<SceneNow>,
}

struct SceneNow {
    document: SyntheticDocument,
    since_frame: u64,
    /// New after each change.
    tag: EntityTag,
}

fn lock<T>(one: &Mutex<T>) -> MutexGuard<'_, T> {
    one.lock().unwrap_or_else(PoisonError::into_inner)
}

impl SceneInForce {
    /// The declared scene.
    pub fn new(knob: SceneKnob, document: &SyntheticDocument) -> SceneInForce {
        let now = SceneNow { document: document.clone(), since_frame: 0, tag: EntityTag::unique() };
        SceneInForce { knob, order: Mutex::new(()), now: Mutex::new(now) }
    }

    /// The source's document with the current scene.
    pub fn document(&self) -> SourceDocument {
        SourceDocument::Synthetic(lock(&self.now).document.clone())
    }

    /// The number of the next rendered frame.
    pub fn next_frame(&self) -> u64 {
        self.knob.next_frame()
    }

    /// The scene, with its tag.
    pub fn view(&self) -> (EntityTag, SceneView) {
        let now = lock(&self.now);
        let view = SceneView { scene: SceneDocument::of(&now.document), since_frame: now.since_frame };
        (now.tag.clone(), view)
    }

    /// Changes the scene; keeps what the document does not name.
    pub fn change(
        &self,
        scene: SceneDocument,
        preconditions: &Preconditions,
    ) -> Result<(EntityTag, SceneView), Problem> {
        let _order = lock(&self.order);
        preconditions.check("the scene", &[self.view().0])?;
        let document = scene.over(lock(&self.now).document.clone());
        let since_frame = self.knob.set(spec(&document)).map_err(|error| synthetic_problem(&error, &document, ""))?;
        *lock(&self.now) = SceneNow { document, since_frame, tag: EntityTag::unique() };
        Ok(self.view())
    }
}

fn spec(document: &SyntheticDocument) -> SceneSpec {
    SceneSpec {
        set: document.set.clone(),
        motion: document.motion.clone(),
        exposure: document.exposure.clone(),
        gain: document.gain.clone(),
        full_well_e: document.full_well_e,
        read_noise_e: document.read_noise_e,
        row_noise_e: document.row_noise_e,
        light: (*document.light).clone(),
    }
}

/// 422 at the wrong key.
pub fn synthetic_problem(error: &SyntheticError, document: &SyntheticDocument, prefix: &str) -> Problem {
    let key = match error {
        SyntheticError::Light { key, .. } => key.clone(),
        SyntheticError::Motion { name, .. } => format!("motion.{name}"),
        SyntheticError::UnknownName { name, .. } if document.set.contains_key(name) => format!("set.{name}"),
        SyntheticError::UnknownName { name, .. } => format!("motion.{name}"),
        // A value computed from several keys has no key of its own.
        SyntheticError::Range { name, .. } if !name.contains(' ') => name.to_string(),
        SyntheticError::Response(_) => "response".to_string(),
        SyntheticError::Range { .. } | SyntheticError::Unseen { .. } | SyntheticError::Model { .. } => String::new(),
    };
    Problem::wrong_key("wrong-source", format!("{prefix}{key}").trim_end_matches('.'), error.to_string())
}
