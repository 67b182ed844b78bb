//! Reads and changes a running source's scene and playback through [`SceneInForce`] and [`Playback`].

use isophote_wire::{PlaybackDocument, PlaybackView, SceneDocument, SceneView, SourceDocument, SourceState};

use super::playback::Playback;
use super::scene::SceneInForce;
use super::{Source, SourceNow};
use crate::http::preconditions::{EntityTag, Preconditions};
use crate::problem::Problem;

impl Source {
    /// Playback state with its tag.
    ///
    /// # Errors
    /// 409 for a camera, and if clients push the frames.
    pub fn playback(&self) -> Result<(EntityTag, PlaybackView), Problem> {
        let state = self.shared.lock();
        let playback = self.playing(&state)?;
        Ok((playback.tag.clone(), playback.view()))
    }

    /// Pauses, seeks or resumes.
    ///
    /// # Errors
    /// 409 if that does not apply, 422 if a number is out of range. Then nothing has changed.
    pub fn set_playback(
        &self,
        document: &PlaybackDocument,
        preconditions: &Preconditions,
    ) -> Result<(EntityTag, PlaybackView), Problem> {
        let mut state = self.shared.lock();
        let tag = self.playing(&state)?.tag.clone();
        preconditions.check("the playback", &[tag])?;
        refuse_when_over(&state)?;
        let changed = match &mut state.playback {
            Some(playback) => playback.change(document).map(|()| (playback.tag.clone(), playback.view()))?,
            None => return Err(Problem::bug("there was a playback")),
        };
        drop(state);
        self.shared.changed.notify_all();
        Ok(changed)
    }

    fn playing<'a>(&self, state: &'a SourceNow) -> Result<&'a Playback, Problem> {
        let kind = self.document.kind();
        let absent = || {
            let detail = format!("a {kind} source has no playback: its frames come when they come");
            Problem::conflict("not-applicable", detail)
        };
        state.playback.as_ref().ok_or_else(absent)
    }

    /// Factor on its rate.
    pub fn speed(&self) -> f64 {
        self.shared.lock().playback.as_ref().map_or(1.0, |playback| playback.speed)
    }

    /// Whether it is paused.
    pub fn is_still(&self) -> bool {
        self.shared.lock().playback.as_ref().is_some_and(|playback| playback.is_paused)
    }

    /// Since when frames are due, ns: since the last change of the playback, if any. `None` if a gap between frames is no
    /// fault: clients push them, or the source is paused.
    pub fn steady_since_ns(&self) -> Option<u64> {
        if matches!(self.document, SourceDocument::Pushed(_)) {
            return None;
        }
        match &self.shared.lock().playback {
            Some(playback) => (!playback.is_paused).then_some(playback.changed_ns),
            None => Some(0),
        }
    }

    /// The scene, with its tag.
    ///
    /// # Errors
    /// 409 if the source is not synthetic.
    pub fn scene(&self) -> Result<(EntityTag, SceneView), Problem> {
        Ok(self.staged()?.view())
    }

    /// Changes the scene from the next rendered frame on; keeps what the document does not name.
    ///
    /// # Errors
    /// 409 if the source is not synthetic, 422 if the document is wrong. Then the scene is unchanged.
    pub fn set_scene(
        &self,
        scene: SceneDocument,
        preconditions: &Preconditions,
    ) -> Result<(EntityTag, SceneView), Problem> {
        let staged = self.staged()?;
        refuse_when_over(&self.shared.lock())?;
        staged.change(scene, preconditions)
    }

    /// Unique to this start of the source.
    pub fn id(&self) -> &EntityTag {
        &self.id
    }

    /// Its document with the current scene and loop setting.
    pub fn document_now(&self) -> SourceDocument {
        let mut document = self.scene.as_ref().map_or_else(|| self.document.clone(), SceneInForce::document);
        let repeat = self.playback().ok().and_then(|(_, view)| view.repeat);
        if let (SourceDocument::Recording(recording), Some(repeat)) = (&mut document, repeat) {
            recording.repeat = repeat;
        }
        document
    }

    fn staged(&self) -> Result<&SceneInForce, Problem> {
        let kind = self.document.kind();
        let absent = || {
            let detail =
                format!("a {kind} source has no scene that could be set: only synthetic ones make their frames");
            Problem::conflict("not-applicable", detail)
        };
        self.scene.as_ref().ok_or_else(absent)
    }
}

/// 409 if no more frames come.
fn refuse_when_over(state: &SourceNow) -> Result<(), Problem> {
    let (SourceState::Ended | SourceState::Failed) = state.state else { return Ok(()) };
    let reason = state.reason.as_deref().unwrap_or("it has ended");
    let detail = format!("{reason}; delete its sessions and put the source again to play it anew");
    Err(Problem::conflict("not-applicable", detail))
}
